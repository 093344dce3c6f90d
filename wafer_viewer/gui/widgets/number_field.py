"""Texts of optional numbers and pairs of numbers, because viser's number fields cannot be empty."""

from __future__ import annotations

import math
import re

from wafer_viewer.model.acquisition.characteristics import FOCUS_RANGE_UM, KINDS, CalibrationOption
from wafer_viewer.model.acquisition.image_source import ImageOptions
from wafer_viewer.model.acquisition.positioners import ROLES, RoleOfPositioner
from wafer_viewer.model.errors import WaferViewerError
from wafer_viewer.model.measurement.feature import Feature
from wafer_viewer.model.spec import settings_of

Pair = tuple[float, float]
SIDES, PLACE = " × ", ", "
"""Separator of two numbers: side lengths, or a position."""
_BETWEEN = (r"\s*[×xX*]\s*", r"\s*;\s*", r"\s*,\s+", r"\s+", r",")
NOT_GIVEN, NOT_KNOWN, NO_FILTER = "not given", "not known", "no filter"


def option_label(option: CalibrationOption) -> str:
    """Return the label of an option of a calibration: its title with the unit."""
    unit = re.sub(r"\bu([ms])\b", "µ\\1", option.unit)
    return f"{option.title}, {unit}" if unit else option.title


def role_label(role: RoleOfPositioner) -> str:
    """Return the label of the position of a positioner: the title of its role with the unit."""
    return f"{role.title}, {role.unit}"


EMPTY: dict[str, str] = {
    **{
        option_label(option): NOT_GIVEN if option.default is None else "the default"
        for kind in KINDS.values()
        for option in kind.options
    },
    **{role_label(role): "not homed" for role in ROLES.values()},
    "z range, µm": f"{FOCUS_RANGE_UM:g}",
    "Exposure, µs": "found by itself",
    "Reason": NOT_GIVEN,
    **dict.fromkeys(("Repeats s, µm", "Drift u, µm", "Sample, °C"), NOT_KNOWN),
    "Noise, µm": "not known: no U",
    **dict.fromkeys(("S-filter, µm", "L-filter, µm", "λc, µm", "λs, µm"), NO_FILTER),
    "Chip over, µm": "4 σ of the edge",
    "Over the plane, µm": "6 σ of the face",
    "Least diameter, µm": "focus window",
    **dict.fromkeys(("c of Smr(c), µm", "Ratio of Smc, %"), "not evaluated"),
    "Site width, µm": "a quarter",
    "Site height, µm": "a quarter",
    **dict.fromkeys(("Limit, ± µm", "Blocks, °C", "Tolerance, µm", "Next in, days", "Tolerance"), NOT_GIVEN),
    **{
        one.setting.title: one.setting.empty
        for kind in (Feature, ImageOptions)
        for one in settings_of(kind).values()
        if one.setting.empty
    },
    **dict.fromkeys(("Step, µm", "U (k = 2), µm"), NOT_GIVEN),
    "Size, mm": "not given: width × height",
    "Below, above focus, µm": "whole range",
    "Pitch, µm": "not given: x × y",
    "Die, µm": "as the pitch",
    "Corner, µm": "not given: x, y",
    **dict.fromkeys(("From, µm", "To, µm"), "none: x, y"),
}
"""Placeholder texts of optional fields by label: the effect of an empty field."""


def pair_of(text: str, name: str, *, over: float | None = None) -> Pair | None:
    """Return the two entered numbers, None for empty text.

    They are separated by ×, x, a semicolon, a comma or a blank. Raises WaferViewerError with a message that names the
    field, the text and the limit.
    """
    bare = text.strip()
    if not bare:
        return None
    parts = next((pieces for by in _BETWEEN if len(pieces := re.split(by, bare)) == 2), [])
    values = [number_of(part, name, over=over) for part in parts]
    if len(values) != 2 or values[0] is None or values[1] is None:
        raise WaferViewerError(f"{name}: {bare!r} is not a pair of numbers. Type two, such as 12.5 × 8, or none.")
    return values[0], values[1]


def pair_text(value: Pair | None, between: str = SIDES) -> str:
    """Return two numbers as the text of a field, empty for None."""
    return "" if value is None else between.join(text_of(number) for number in value)


def number_of(
    text: str,
    name: str,
    *,
    over: float | None = None,
    least: float | None = None,
    most: float | None = None,
    integer: bool = False,
) -> float | None:
    """Return the entered number, None for empty text. A comma is a decimal point.

    Raises WaferViewerError with a message that names the field, the text and the limit.
    """
    bare = "".join(text.split()).replace(",", ".").replace("\u2212", "-")
    if not bare:
        return None
    try:
        value = float(bare)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise WaferViewerError(f"{name}: {text.strip()!r} is not a number. Type one, or leave the field empty.")
    if integer and not value.is_integer():
        raise WaferViewerError(f"{name} is {value:g}: it must be a whole number, or empty.")
    if over is not None and value <= over:
        raise WaferViewerError(f"{name} is {value:g}: it must be over {over:g}, or empty.")
    if least is not None and value < least:
        raise WaferViewerError(f"{name} is {value:g}: it must be at least {least:g}, or empty.")
    if most is not None and value > most:
        raise WaferViewerError(f"{name} is {value:g}: it must be at most {most:g}, or empty.")
    return value


def text_of(value: float | None) -> str:
    """Return a number as the text of a field, empty for None."""
    if value is None:
        return ""
    return f"{int(value)}" if float(value).is_integer() and abs(value) < 1e15 else repr(float(value))
