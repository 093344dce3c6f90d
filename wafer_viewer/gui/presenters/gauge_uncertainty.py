"""HTML of a gauge check's uncertainty budget, capability and z scale. Pure functions."""

from __future__ import annotations

import math
from collections.abc import Sequence

from wafer_viewer.draw.number_format import number, with_unit
from wafer_viewer.gui.widgets import html
from wafer_viewer.model.gauge.gauge_check import GaugeCheck, GaugeLine, Role, ScaleCorrection
from wafer_viewer.model.gauge.run_chart import Capability

_OF: dict[Role, str] = {
    "scale": "Of the measured step alone",
    "measurement": "Of the measured step and of the error",
    "reference": "Of the certified step",
}
"""Headings of the budget's parts, in display order."""
_DIGITS = 4


def budget(check: GaugeCheck) -> str:
    """Return the contributions grouped by role, and the three expanded uncertainties; empty without a budget."""
    if not check.budget:
        return ""
    rows = [row for role in _OF for row in _part(role, [line for line in check.budget if line.of == role])]
    sums = (("U measured", check.height), ("U certificate", check.reference), ("U error", check.deviation))
    rows += [
        html.row([html.safe(name), number(length.expanded_um, _DIGITS - 1)], " n", look="strong")
        for name, length in sums
        if length.expanded_um is not None
    ]
    return html.head("Uncertainty", "µm · lines k = 1, sums k = 2") + html.table([], rows, " n")


def not_evaluated(check: GaugeCheck) -> str:
    """Return the list of contributions that U does not contain; empty if there are none."""
    if not check.not_evaluated:
        return ""
    items = "".join(f"<li>{html.safe(html.with_micro_sign(item))}</li>" for item in check.not_evaluated)
    return html.head("Not evaluated") + f'<ul class="wv-left-out">{items}</ul>'


def capability(found: Capability | None) -> str:
    """Return Cg and Cgk, or the reason why there are none."""
    if found is None:
        return ""
    pairs = [("Repeats", number(found.n, 0)), ("Tolerance of the product", with_unit(found.tolerance_um, 2))]
    if found.cg is not None and found.cgk is not None:
        word = "" if found.capable is None else " · capable" if found.capable else " · not capable"
        pairs.append(("Cg · Cgk", f"{number(found.cg, 2)} · {number(found.cgk, 2)}{word}"))
    words = " ".join(part for part in (found.why, found.variant) if part)
    below = (
        f'<div class="wv-lab" style="margin-top:4px">{html.safe(html.with_micro_sign(words))}</div>' if words else ""
    )
    return html.head("Capability", "both 1.33 or more, over 25 scans") + html.pairs(pairs) + below


def correction(offered: ScaleCorrection | None) -> str:
    """Return the suggested z scale factor with advice; empty without a suggestion."""
    if offered is None:
        return ""
    by = with_unit(offered.changes_um, 3, signed=True)
    pairs = [("Certified over measured", number(offered.factor, 6)), ("The checked step would change by", by)]
    advice = f'<div class="wv-lab" style="margin:4px 0 6px">{html.safe(html.with_micro_sign(offered.advice))}</div>'
    return html.head("z scale", "nothing changes automatically") + html.pairs(pairs) + advice


def _part(role: Role, lines: Sequence[GaugeLine]) -> list[str]:
    if not lines:
        return []
    together = math.sqrt(sum(line.u_um**2 for line in lines))
    head = html.row([f"<b>{_OF[role]}</b>", f"<b>{number(together, _DIGITS)}</b>"], " n")
    return [head, *(html.row([_name(line.name), number(line.u_um, _DIGITS)], " n") for line in lines)]


def _name(name: str) -> str:
    titled = name if name.startswith("z ") else name[:1].upper() + name[1:]
    return f'<span class="wv-under">{html.safe(html.with_micro_sign(titled))}</span>'
