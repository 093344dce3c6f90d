"""A number that may be left empty: a text field, since viser's number fields cannot be."""

from __future__ import annotations

import math
from typing import Any

from wafer_viewer.gui.kit import Gui
from wafer_viewer.model.errors import WaferViewerError

OPTIONAL_LABELS = (
    *("Repeats s, µm", "Drift u, µm", "Sample, °C"),
    *("S-filter, µm", "L-filter, µm", "λc, µm", "λs, µm"),
    *("Chip over, µm", "Site width, µm", "Site height, µm"),
    *("Limit, ± µm", "Blocks, °C", "Tolerance, µm", "Next in, days", "Tolerance"),
    *("Step, µm", "U (k = 2), µm", "Nominal, µm"),
    *("Pixel, µm", "z step, µm"),
)
"""Labels of the fields that may be left empty: names.js writes "not given" in them, in grey."""


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
        if label not in OPTIONAL_LABELS:
            raise ValueError(f"The label {label!r} is missing in OPTIONAL_LABELS: the page would not say 'not given'.")
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
