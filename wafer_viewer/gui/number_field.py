"""Numbers, and pairs of them, that may be left empty: text fields, since viser's number fields cannot be."""

from __future__ import annotations

import math
import re
from typing import Any

from wafer_viewer.gui.kit import Gui
from wafer_viewer.model.errors import WaferViewerError

Pair = tuple[float, float]
SIDES, PLACE = " × ", ", "
"""Between two numbers: sides of something, or a place."""
_BETWEEN = (r"\s*[×xX*]\s*", r"\s*;\s*", r"\s*,\s+", r"\s+", r",")
NOT_GIVEN, NOT_KNOWN, NO_FILTER, NO_LIMIT = "not given", "not known", "no filter", "no limit"
EMPTY: dict[str, str] = {
    **dict.fromkeys(("Repeats s, µm", "Drift u, µm", "Sample, °C"), NOT_KNOWN),
    **dict.fromkeys(("S-filter, µm", "L-filter, µm", "λc, µm", "λs, µm"), NO_FILTER),
    "Chip over, µm": "4 σ of the edge",
    "Site width, µm": "a quarter",
    "Site height, µm": "a quarter",
    **dict.fromkeys(("Limit, ± µm", "Blocks, °C", "Tolerance, µm", "Next in, days", "Tolerance"), NOT_GIVEN),
    **dict.fromkeys(("Step, µm", "U (k = 2), µm", "Nominal, µm"), NOT_GIVEN),
    **dict.fromkeys(("Pixel, µm", "z step, µm"), NOT_GIVEN),
    "NA": NOT_KNOWN,
    "Light, µm": "0.55",
    "Size, mm": "not given: width × height",
    "Lower limit": NO_LIMIT,
    "Upper limit": NO_LIMIT,
    "Pitch, µm": "not given: x × y",
    "Die, µm": "as the pitch",
    "Corner, µm": "not given: x, y",
    **dict.fromkeys(("From, µm", "To, µm"), "none: x, y"),
}
"""Fields that may be left empty, by their labels, and what they say in grey then: what happens without a number."""


class OptionalNumber:
    """A field whose value is a number, or None where it is left empty.

    Parameters
    ----------
    gui : viser.GuiApi
        Where it is made.
    label : str
        Its name with the unit, ``Pixel, µm``; errors name the field by it.
    value : float or None
        The number to begin with.
    over, least, most : float or None
        Limits: greater than `over`, from `least` to `most`.
    whole : bool
        Whether only whole numbers are taken.
    hint : str or None
        More of it, and what happens where it is empty.
    """

    def __init__(
        self,
        gui: Gui,
        label: str,
        value: float | None = None,
        *,
        over: float | None = None,
        least: float | None = None,
        most: float | None = None,
        whole: bool = False,
        hint: str | None = None,
    ) -> None:
        self._label = label
        self._limits: dict[str, Any] = {"over": over, "least": least, "most": most, "whole": whole}
        _require_known(label)
        self.handle = gui.add_text(label, text_of(value), hint=hint)

    @property
    def value(self) -> float | None:
        """The number, None where nothing is typed. Raises WaferViewerError for other text and out of limits."""
        return self.read(self.handle.value)

    @value.setter
    def value(self, value: float | None) -> None:
        self.handle.value = text_of(value)

    def read(self, text: str) -> float | None:
        """Return the number that a text in this field stands for; raises as `value` does."""
        return number_of(text, self._label, **self._limits)


class OptionalPair:
    """A field whose value is two numbers, or None where it is left empty.

    Parameters
    ----------
    gui : viser.GuiApi
        Where it is made.
    label : str
        Its name with the unit, ``Size, mm``; errors name the field by it.
    value : tuple of float or None
        The numbers to begin with.
    over : float or None
        Both are greater than this.
    between : str
        Stands between the numbers: ``" × "`` of sides, ``", "`` of a place.
    hint : str or None
        More of it, and what happens where it is empty.
    """

    def __init__(
        self,
        gui: Gui,
        label: str,
        value: Pair | None = None,
        *,
        over: float | None = None,
        between: str = SIDES,
        hint: str | None = None,
    ) -> None:
        _require_known(label)
        self._label, self._over, self._between = label, over, between
        self.handle = gui.add_text(label, pair_text(value, between), hint=hint)

    @property
    def value(self) -> Pair | None:
        """The numbers, None where nothing is typed. Raises WaferViewerError for what is no pair, or not over `over`."""
        return self.read(self.handle.value)

    @value.setter
    def value(self, value: Pair | None) -> None:
        self.handle.value = pair_text(value, self._between)

    def read(self, text: str) -> Pair | None:
        """Return the numbers that a text in this field stands for; raises as `value` does."""
        return pair_of(text, self._label, over=self._over)


def pair_of(text: str, name: str, *, over: float | None = None) -> Pair | None:
    """Return the two numbers that were typed, None where nothing was.

    Between them stands ×, x, a semicolon, a comma or a blank. Raises WaferViewerError with a sentence that names the
    field, the text and the limit.
    """
    bare = text.strip()
    if not bare:
        return None
    parts = next((found for by in _BETWEEN if len(found := re.split(by, bare)) == 2), [])
    values = [number_of(part, name, over=over) for part in parts]
    if len(values) != 2 or values[0] is None or values[1] is None:
        raise WaferViewerError(f"{name}: {bare!r} are no two numbers. Type two, such as 12.5 × 8, or leave it empty.")
    return values[0], values[1]


def pair_text(value: Pair | None, between: str = SIDES) -> str:
    """Return two numbers as they stand in a field, empty for None."""
    return "" if value is None else between.join(text_of(number) for number in value)


def _require_known(label: str) -> None:
    if label not in EMPTY:
        raise ValueError(f"The label {label!r} is missing in EMPTY: the page would not say what happens without it.")


def number_of(
    text: str,
    name: str,
    *,
    over: float | None = None,
    least: float | None = None,
    most: float | None = None,
    whole: bool = False,
) -> float | None:
    """Return the number that was typed, None where nothing was. A comma is a decimal point.

    Raises WaferViewerError with a sentence that names the field, the text and the limit.
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
    if whole and not value.is_integer():
        raise WaferViewerError(f"{name} is {value:g}: it must be a whole number, or empty.")
    if over is not None and value <= over:
        raise WaferViewerError(f"{name} is {value:g}: it must be over {over:g}, or empty.")
    if least is not None and value < least:
        raise WaferViewerError(f"{name} is {value:g}: it must be at least {least:g}, or empty.")
    if most is not None and value > most:
        raise WaferViewerError(f"{name} is {value:g}: it must be at most {most:g}, or empty.")
    return value


def text_of(value: float | None) -> str:
    """Return a number as it stands in a field, empty for None."""
    if value is None:
        return ""
    return f"{int(value)}" if float(value).is_integer() and abs(value) < 1e15 else repr(float(value))
