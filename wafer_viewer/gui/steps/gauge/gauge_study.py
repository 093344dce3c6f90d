"""Gauge R&R studies in the gauge check: the dialog that reads one, and its result by the AIAG rules."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import viser
from markupsafe import Markup

from wafer_viewer.draw.charts.study_charts import study_charts_html
from wafer_viewer.draw.number_format import NOTHING, number, share
from wafer_viewer.draw.quantities import UNIT_SIGNS
from wafer_viewer.gui.dialogs.dialog import Confirm
from wafer_viewer.gui.dialogs.file_dialog import FileDialog
from wafer_viewer.gui.elements.elements import Dropdown, Elements, NumberOrEmpty
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.html import Tone
from wafer_viewer.model.gauge import GaugeRR, GaugeWord, Interval, Method
from wafer_viewer.model.quantity import Unit
from wafer_viewer.session.gauge.repeat_scans import Studied

STUDY_FAILED = "The study was not read"
_LOOKS: dict[GaugeWord | None, tuple[Tone, str]] = {
    "acceptable": ("good", "Acceptable"),
    "acceptable for some uses": ("attention", "Acceptable for some uses"),
    "not acceptable": ("fault", "Not acceptable"),
    None: ("busy", "Nothing varies"),
}
METHODS: dict[Method, str] = {"anova": "analysis of variance", "range": "average and range"}
METHOD_OF: dict[str, Method] = {word.capitalize(): method for method, word in METHODS.items()}


METHOD_HINT = "How the study is evaluated, both by AIAG"


@dataclass(frozen=True, slots=True)
class _Study:
    method: str = next(iter(METHOD_OF))
    tolerance: float | None = None


def study_dialog(page: Page, take: Callable[[Markup], None]) -> None:
    """Open the dialog that reads a study with a method and a tolerance; `take` gets its result."""
    below = "A CSV with the columns part, appraiser or operator, and value; or a folder of repeat scans with a job."
    tolerance_hint = "Upper limit less lower, in the unit of the values; empty: that of the job, if any"

    def contents(here: FileDialog[_Study]) -> Elements:
        method = Dropdown("Method", here.own.method, partial(here.put, "method"), METHOD_HINT, options=tuple(METHOD_OF))
        put = partial(here.put, "tolerance")
        tolerance = NumberOrEmpty("Tolerance", here.own.tolerance, put, tolerance_hint, over=0)
        return [*here.files(), here.upload("text/csv"), method, tolerance]

    def read(here: FileDialog[_Study]) -> None:
        made = page.session.studies.gauge_rr(here.path(), METHOD_OF[here.own.method], here.own.tolerance)
        take(Markup("").join(map(study, made)))

    answer = Confirm("Read the study", viser.Icon.TABLE_IMPORT, read, STUDY_FAILED, commands=False)
    FileDialog(page, "Gauge R&R study", below, answer, "study", _Study(), contents, rows=6)


def study(studied: Studied) -> Markup:
    """Return study size, verdict, every standard deviation with its limits and share, charts, and the analysis."""
    found = studied.found
    by = f"{studied.name} · {METHODS[found.method]}{' · SIMULATED' if studied.simulated else ''}"
    notes = Markup("").join(html.remark(text, "margin-top:4px") for text in found.notes)
    parts = (
        Markup('<div class="wv-lab" title="{by}">{by}</div>').format(by=by),
        _study_size(found),
        html.note(*_LOOKS[found.word], html.typeset(found.why)),
        _table(found, studied.unit),
        _rest(found),
        notes,
        study_charts_html(studied.values, UNIT_SIGNS[studied.unit] if studied.unit else ""),
        _analysis(found),
    )
    return Markup("").join(parts)


def _study_size(study: GaugeRR) -> Markup:
    counts = ((study.parts, "part"), (study.appraisers, "appraiser"), (study.trials, "trial"))
    words = Markup(" · ").join(Markup("<b>{}</b> {}{}").format(n, word, "" if n == 1 else "s") for n, word in counts)
    return Markup('<div style="margin:3px 0 4px">{}</div>').format(words)


def _table(study: GaugeRR, unit: Unit | None) -> Markup:
    lines = [_variation_line(study, *deviation) for deviation in study.deviations]
    return html.table(["", f"s, {UNIT_SIGNS[unit]}" if unit else "s", "of total", ""], lines, " nn")


def _variation_line(study: GaugeRR, title: str, s: float, limits: Interval | None) -> Markup:
    part = s / study.total_variation if study.total_variation else math.nan
    width = 0.0 if math.isnan(part) else 100 * min(part, 1.0)
    bar = Markup('<div class="wv-rr"><i style="width:{:.1f}%"></i></div>').format(width)
    hint = f"95 % limits {number(limits.low, 4)} to {number(limits.high, 4)}" if limits is not None else ""
    value = Markup('<span title="{}">{}</span>').format(hint, number(s, 4))
    look = "strong" if title in ("Gauge R&R", "Total variation, TV") else ""
    return html.row([title, value, share(part), bar], " nn", look=look)


def _rest(study: GaugeRR) -> Markup:
    of_tolerance, q_mp, limits = study.share_of_tolerance, study.q_mp, study.gauge_rr_limits
    pairs = [
        ("Distinct categories", number(study.distinct_categories, 0)),
        ("6 s of the gauge, of the tolerance", NOTHING if of_tolerance is None else share(of_tolerance)),
    ]
    if q_mp is not None:
        pairs.append(("Q_MP of VDA 5", share(q_mp)))
    if limits is not None:
        pairs.append(("Gauge R&R, 95 % limits", f"{number(limits.low, 4)} to {number(limits.high, 4)}"))
    if study.interaction_p is not None:
        pairs.append(("p of parts with appraisers", number(study.interaction_p, 3)))
    return Markup('<div style="height:4px"></div>{}').format(html.pairs(pairs)) + html.remark(
        "Shares are of standard deviations: they do not add up to 100 %.", "margin-top:4px"
    )


def _analysis(study: GaugeRR) -> Markup:
    if not study.anova:
        return Markup()
    rows = [
        html.row(
            [
                row.effect.replace(" x ", " × ").capitalize(),
                number(row.freedom, 0),
                f"{row.mean_square:.4g}",
                NOTHING if row.f is None else number(row.f, 2),
                NOTHING if row.p is None else number(row.p, 3),
            ],
            " nnnn",
        )
        for row in study.anova
    ]
    return html.head("Analysis of variance") + html.table(["", "ν", "Mean square", "F", "p"], rows, " nnnn")
