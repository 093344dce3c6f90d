"""HTML of a gauge R&R study: shares of the total variation as a table with bars. Pure functions."""

from __future__ import annotations

import math

from wafer_viewer.draw.number_format import NOTHING, number, share
from wafer_viewer.gui.presenters.measurement import UNIT_SIGNS
from wafer_viewer.gui.widgets import html
from wafer_viewer.model.gauge.gauge_rr import GaugeRR, Method
from wafer_viewer.model.quantity import Unit
from wafer_viewer.session.gauge.study_commands import Studied

GOOD, MARGINAL, LEAST_CATEGORIES = 0.10, 0.30, 5
"""AIAG limits: %GRR of an acceptable and of a marginal gauge, and the least number of distinct categories."""
METHODS: dict[Method, str] = {"anova": "analysis of variance", "range": "average and range"}


def study(studied: Studied) -> str:
    """Return study size, verdict by the AIAG rule, and every standard deviation with its share."""
    found = studied.found
    by = f"{studied.name} · {METHODS[found.method]}{' · SIMULATED' if studied.simulated else ''}"
    notes = "".join(_small(text) for text in found.notes)
    return (
        f'<div class="wv-lab" title="{html.safe(by)}">{html.safe(by)}</div>{_size(found)}{_word(found)}'
        f"{_table(found, studied.unit)}{_rest(found)}{notes}"
    )


def _size(found: GaugeRR) -> str:
    told = ((found.parts, "part"), (found.appraisers, "appraiser"), (found.trials, "trial"))
    words = " · ".join(f"<b>{n}</b> {word}{'' if n == 1 else 's'}" for n, word in told)
    return f'<div style="margin:3px 0 4px">{words}</div>'


def _word(found: GaugeRR) -> str:
    grr = found.share_of_variation
    if math.isnan(grr):
        return html.note("busy", "Nothing varies", "All values are the same: there is nothing to compare.")
    told = f"Gauge R&R is {share(grr)} of the total variation; {found.distinct_categories} distinct categories."
    if grr <= GOOD and found.distinct_categories >= LEAST_CATEGORIES:
        return html.note("good", "Acceptable", told)
    if grr <= MARGINAL:
        return html.note("attention", "Acceptable for some uses", told)
    return html.note("fault", "Not acceptable", told)


def _table(found: GaugeRR, unit: Unit | None) -> str:
    rows = (
        ("Repeatability, EV", found.repeatability, ""),
        ("Reproducibility, AV", found.reproducibility, ""),
        ("Gauge R&R", found.gauge_rr, "strong"),
        ("Part variation, PV", found.part_variation, ""),
        ("Total variation, TV", found.total_variation, "strong"),
    )
    lines = [_line(name, s, found.total_variation, look) for name, s, look in rows]
    return html.table(["", f"s, {UNIT_SIGNS[unit]}" if unit else "s", "of total", ""], lines, " nn")


def _line(name: str, s: float, total: float, look: str) -> str:
    part = s / total if total else math.nan
    width = 0.0 if math.isnan(part) else 100 * min(part, 1.0)
    bar = f'<div class="wv-rr"><i style="width:{width:.1f}%"></i></div>'
    return html.row([html.safe(name), number(s, 4), share(part), bar], " nn", look=look)


def _rest(found: GaugeRR) -> str:
    of_tolerance = found.share_of_tolerance
    pairs = [
        ("Distinct categories", number(found.distinct_categories, 0)),
        ("6 s of the gauge, of the tolerance", NOTHING if of_tolerance is None else share(of_tolerance)),
    ]
    if found.interaction is not None:
        pairs.append(("Parts with appraisers, p", number(found.interaction, 3)))
    return f'<div style="height:4px"></div>{html.pairs(pairs)}' + _small(
        "Shares are of deviations, and do not sum up to 100 %."
    )


def _small(text: str) -> str:
    return f'<div class="wv-lab" style="margin-top:4px">{html.safe(html.with_micro_sign(text))}</div>'
