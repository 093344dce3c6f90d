"""Presentation of measured quantities: symbol, value with U and unit, answer card, uncertainty budget."""

from __future__ import annotations

import math
from dataclasses import dataclass

from wafer_viewer.draw.charts.defect_symbols import KINDS
from wafer_viewer.draw.colormaps import PROFILE_COLOURS
from wafer_viewer.draw.number_format import digits_of_u, number, value_and_u, with_unit
from wafer_viewer.gui.widgets import html
from wafer_viewer.model.findings import AnyResult
from wafer_viewer.model.gauge.gauge_check import GaugeCheck
from wafer_viewer.model.inspection.defect import Defect
from wafer_viewer.model.measurement.measurements import AreaVolume, Profile
from wafer_viewer.model.measurement.step import StepProfile
from wafer_viewer.model.quantity import Quantity

REGION_COLOUR = "#15202B"
OTHER_COLOUR = "#5B6B7A"
NO_U = {"not evaluated": "U not evaluated", "uncalibrated": "uncalibrated"}
_LETTERS = {
    "profile": "P",
    "point": "H",
    "distance": "L",
    "step_height": "S",
    "step_profile": "K",
    "angle": "A",
    "radius": "R",
    "volume": "V",
    "flatness": "F",
    "texture": "T",
    "roughness": "N",
    "kerf_width": "W",
    "die_size": "Z",
    "circle": "O",
    "chipping": "C",
    "coplanarity": "B",
    "site_range": "U",
    "gauge_check": "G",
    "defect": "D",
}
_MAIN = {
    "profile": "total height Pt",
    "point": "height",
    "distance": "in space",
    "angle": "between the faces",
    "radius": "of the sphere",
    "flatness": "FLTt",
    "texture": "Sa",
    "roughness": "Ra",
    "kerf_width": "mean width",
    "die_size": "width",
    "circle": "diameter",
    "chipping": "deepest",
    "coplanarity": "from lowest to highest top",
    "site_range": "largest, front surface, as mounted",
    "gauge_check": "error",
}
"""Label of a result's main quantity, if the name of its tool does not tell it."""
_SIGNED = ("point", "gauge_check", "defect")
UNIT_SIGNS = {"um": "µm", "um2": "µm²", "um3": "µm³", "deg": "°", "mrad": "mrad"}
_LARGER = {"um2": ((1e5, 1e-6, "mm²"),), "um3": ((1e5, 1e-6, "nl"), (0.0, 1e-3, "pl"))}
"""Display units by quantity unit: (smallest value, factor, unit sign), largest first."""


@dataclass(frozen=True, slots=True)
class ReadValue:
    """Display unit of a quantity: factor from the quantity's own unit, and unit sign."""

    factor: float
    unit: str


def display_unit(quantity: Quantity) -> ReadValue:
    """Return the display unit: nl or pl for volumes, mm² for large areas, else the unit of measurement."""
    for least, factor, unit in _LARGER.get(quantity.unit, ()):
        if abs(quantity.value) >= least:
            return ReadValue(factor, unit)
    return ReadValue(1.0, UNIT_SIGNS[quantity.unit])


def value_texts(quantity: Quantity, *, signed: bool = False) -> tuple[str, str, str]:
    """Return value, U to two significant digits (a dash if there is none) and unit, as texts."""
    read = display_unit(quantity)
    expanded = None if quantity.expanded is None else quantity.expanded * read.factor
    digits = _plain_digits(quantity) if read.factor == 1 else _digits(quantity.value * read.factor)
    value, u = value_and_u(quantity.value * read.factor, expanded, digits, signed=signed)
    return value, u, read.unit


def format_quantity(quantity: Quantity, *, signed: bool = False) -> str:
    """Format value, U and unit in one line: ``11.86 ± 0.31 µm``."""
    value, u, unit = value_texts(quantity, signed=signed)
    return with_unit_sign(f"{value} ± {u}" if quantity.expanded is not None else value, unit)


def with_unit_sign(text: str, unit: str) -> str:
    """Join a number and its unit, without a space before the degree sign."""
    return f"{text}{unit}" if unit == "°" else f"{text}\u202f{unit}"


def symbol(finding: AnyResult) -> str:
    """Return the symbol of a result: P1, S2."""
    return f"{_LETTERS[_tag(finding)]}{finding.number or ''}"


def sign_colour(finding: AnyResult) -> str:
    """Return the colour of a result's symbol, the same in list, curve and scene."""
    if isinstance(finding, Profile):
        return PROFILE_COLOURS[0]
    if isinstance(finding, Defect):
        return KINDS[finding.seen_as].colour
    return OTHER_COLOUR if isinstance(finding, GaugeCheck) else REGION_COLOUR


def main_label(finding: AnyResult) -> str:
    """Return the label of a result's main quantity; empty if the tool's name tells it."""
    if isinstance(finding, AreaVolume):
        return "below" if finding.main == finding.volume_below else "above"
    return _MAIN.get(_tag(finding), "")


def list_text(finding: AnyResult) -> str:
    """Return value, uncertainty and unit for the list, as HTML."""
    value, u, unit = value_texts(finding.main, signed=_tag(finding) in _SIGNED)
    beside = f"± {u}" if finding.main.expanded is not None else NO_U.get(finding.main.status, "")
    return f"<b>{value}</b>{with_unit_sign('', unit)}<small>{html.safe(beside)}</small>"


def answer(name: str, quantity: Quantity, signed: bool = False) -> str:
    """Return the card with a quantity in large type."""
    value, u, unit = value_texts(quantity, signed=signed)
    if quantity.expanded is not None:
        told = html.safe(with_unit_sign(f"± {u}", unit))
        below = f'{told} <span class="dim" style="font-size:13px">expanded, k = 2</span>'
    else:
        below = f'<span style="color:var(--attention)">{NO_U.get(quantity.status, "U not evaluated")}</span>'
    return (
        f'<div class="wv-answer"><div class="wv-lab">{html.safe(name)}</div>'
        f'<div class="wv-big" style="font-size:40px">{value}<span class="wv-unit"> {unit}</span></div>'
        f'<div style="font-size:17px;color:var(--ink2);font-weight:500">{below}</div></div>'
    )


def card(finding: AnyResult, name: str) -> str:
    """Return the card with a result's main quantity."""
    named = " · ".join(part for part in (name, main_label(finding)) if part)
    return answer(named, finding.main, _tag(finding) in _SIGNED)


def budget(quantity: Quantity) -> str:
    """Return the uncertainty budget: contributions, then combined and expanded uncertainty."""
    if not quantity.budget or quantity.expanded is None:
        why = "A calibration of the rig gives it one." if quantity.status == "uncalibrated" else ""
        word = NO_U.get(quantity.status, "U not evaluated")
        return html.head("Uncertainty") + html.empty(f"{word[0].upper()}{word[1:]}.", why)
    read = display_unit(quantity)
    digits = max(3, digits_of_u(quantity.expanded * read.factor) + 1)
    lines = [(line.name[:1].upper() + line.name[1:], line.u * read.factor) for line in quantity.budget]
    rows = [html.row([html.safe(name), number(u, digits)], " n") for name, u in lines]
    combined = math.sqrt(sum(u**2 for _, u in lines))
    total = f"{number(combined, digits)} · {number(2 * combined, digits)}"
    rows.append(html.row(["Combined · expanded, k = 2", total], " n", look="strong"))
    return html.head("Uncertainty", f"{read.unit}, k = 1") + html.table([], rows, " n")


def averaging(profile: Profile | StepProfile) -> str:
    """Format the averaging width across the line."""
    return with_unit(profile.line.width_um, 1) if profile.line.width_um else "one pixel"


def _plain_digits(quantity: Quantity) -> int:
    """Return the decimals of a value in its own unit: 2, or up to 4 (three digits) for lengths under 1 µm."""
    small = quantity.unit == "um" and 0 < abs(quantity.value) < 1
    return min(4, max(2, _digits(quantity.value) - 1)) if small else 2


def _digits(value: float) -> int:
    """Return the decimals that show a value without U to four digits."""
    return max(0, 3 - math.floor(math.log10(abs(value)))) if value else 2


def _tag(finding: AnyResult) -> str:
    return str(finding.__struct_config__.tag)
