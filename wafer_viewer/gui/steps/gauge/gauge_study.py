"""Gauge R&R studies in the gauge check: the dialog that reads one, and its result by the AIAG rules."""

from __future__ import annotations

import math
from collections.abc import Callable

import viser
from markupsafe import Markup

from wafer_viewer.draw.number_format import NOTHING, number, share
from wafer_viewer.draw.quantities import UNIT_SIGNS
from wafer_viewer.gui.page.dialogs import Dialog
from wafer_viewer.gui.page.file_dialog import FileList
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.number_field import OptionalNumber
from wafer_viewer.model.gauge import GaugeRR, Method
from wafer_viewer.model.quantity import Unit
from wafer_viewer.session.gauge.repeat_scans import Studied

STUDY_FAILED = "The study was not read"
GOOD, MARGINAL, LEAST_CATEGORIES = 0.10, 0.30, 5
"""AIAG limits: %GRR of an acceptable and of a marginal gauge, and the least number of distinct categories."""
METHODS: dict[Method, str] = {"anova": "analysis of variance", "range": "average and range"}
METHOD_OF: dict[str, Method] = {word.capitalize(): method for method, word in METHODS.items()}


def study_dialog(page: Page, take: Callable[[Markup], None]) -> None:
    """Open the dialog that reads a study with a method and a tolerance; `take` gets its result."""
    below = "A CSV with the columns part, appraiser and value, or a folder of repeat scans of wafers with a job."
    dialog = Dialog(page, "Gauge R&R study", below)
    with dialog.modal:
        files = FileList(dialog, "study", rows=6)
        files.add_upload("text/csv")
        method = page.gui.add_dropdown("Method", tuple(METHOD_OF))
        tolerance = OptionalNumber(page.gui, "Tolerance", over=0)

    def read() -> None:
        made = page.session.studies.gauge_rr(files.path(), METHOD_OF[method.value], tolerance.value)
        take(Markup("").join(map(study, made)))

    dialog.answers("Read the study", viser.Icon.TABLE_IMPORT, read, STUDY_FAILED, needs_control=False)


def study(studied: Studied) -> Markup:
    """Return study size, verdict by the AIAG rule, and every standard deviation with its share."""
    study = studied.found
    by = f"{studied.name} · {METHODS[study.method]}{' · SIMULATED' if studied.simulated else ''}"
    notes = Markup("").join(_small(text) for text in study.notes)
    return Markup('<div class="wv-lab" title="{by}">{by}</div>{study_size}{word}{table}{rest}{notes}').format(
        by=by,
        study_size=_study_size(study),
        word=_word(study),
        table=_table(study, studied.unit),
        rest=_rest(study),
        notes=notes,
    )


def _study_size(study: GaugeRR) -> Markup:
    counts = ((study.parts, "part"), (study.appraisers, "appraiser"), (study.trials, "trial"))
    words = Markup(" · ").join(Markup("<b>{}</b> {}{}").format(n, word, "" if n == 1 else "s") for n, word in counts)
    return Markup('<div style="margin:3px 0 4px">{}</div>').format(words)


def _word(study: GaugeRR) -> Markup:
    grr = study.share_of_variation
    if math.isnan(grr):
        return html.note("busy", "Nothing varies", "All values are the same: there is nothing to compare.")
    text = f"Gauge R&R is {share(grr)} of the total variation; {study.distinct_categories} distinct categories."
    if grr <= GOOD and study.distinct_categories >= LEAST_CATEGORIES:
        return html.note("good", "Acceptable", text)
    if grr <= MARGINAL:
        return html.note("attention", "Acceptable for some uses", text)
    return html.note("fault", "Not acceptable", text)


def _table(study: GaugeRR, unit: Unit | None) -> Markup:
    rows = (
        ("Repeatability, EV", study.repeatability, ""),
        ("Reproducibility, AV", study.reproducibility, ""),
        ("of it parts with appraisers, INT", study.interaction_variation, ""),
        ("Gauge R&R", study.gauge_rr, "strong"),
        ("Part variation, PV", study.part_variation, ""),
        ("Total variation, TV", study.total_variation, "strong"),
    )
    lines = [_variation_line(name, s, study.total_variation, look) for name, s, look in rows if s is not None]
    return html.table(["", f"s, {UNIT_SIGNS[unit]}" if unit else "s", "of total", ""], lines, " nn")


def _variation_line(name: str, s: float, total: float, look: str) -> Markup:
    part = s / total if total else math.nan
    width = 0.0 if math.isnan(part) else 100 * min(part, 1.0)
    bar = Markup('<div class="wv-rr"><i style="width:{:.1f}%"></i></div>').format(width)
    return html.row([name, number(s, 4), share(part), bar], " nn", look=look)


def _rest(study: GaugeRR) -> Markup:
    of_tolerance = study.share_of_tolerance
    pairs = [
        ("Distinct categories", number(study.distinct_categories, 0)),
        ("6 s of the gauge, of the tolerance", NOTHING if of_tolerance is None else share(of_tolerance)),
    ]
    if study.interaction_p is not None:
        pairs.append(("p of parts with appraisers", number(study.interaction_p, 3)))
    return Markup('<div style="height:4px"></div>{}').format(html.pairs(pairs)) + _small(
        "Shares are of deviations, and do not sum up to 100 %."
    )


def _small(text: str) -> Markup:
    return Markup('<div class="wv-lab" style="margin-top:4px">{}</div>').format(html.with_micro_sign(text))
