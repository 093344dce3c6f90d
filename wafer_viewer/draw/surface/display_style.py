"""How a surface is to look: what the page chooses, light enough to be imported where nothing is painted."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.focus_stack import Image

Quantity = Literal["height", "confidence", "slope", "deviation", "form", "overlap", "grey", "origin", "difference"]
Plane = tuple[float, float, float]
Form = tuple[float, ...]
"""Middle x, middle y and half the width in um, then the factors of 1, u, v, u², uv, v²; u and v are -1 ... 1."""

QUANTITIES: dict[Quantity, tuple[str, str]] = {
    "height": ("Height", "µm"),
    "confidence": ("Confidence", ""),
    "slope": ("Slope", "°"),
    "deviation": ("Deviation", "µm"),
    "form": ("Deviation", "µm"),
    "overlap": ("Difference", "µm"),
    "grey": ("Grey", ""),
    "origin": ("Origin", ""),
    "difference": ("Second − first", "µm"),
}
"""Title of the colour bar and unit of each quantity a surface can be coloured by."""


@dataclass(frozen=True, slots=True)
class DisplayStyle:
    """What the operator chose: the quantity, its colour map and range, the strengths of light and image (0 ... 1).

    depth_shade: strength of the shade that hollows get in a point cloud, 0 ... 1; brush_um: heights that light up.
    """

    colour_by: Quantity = "height"
    colours: str = "mako"
    low: float = 0.0
    high: float = 1.0
    hillshade: float = 0.8
    all_in_focus: float = 0.0
    depth_shade: float = 0.0
    brush_um: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True)
class Light:
    """What the light takes from the whole surface, so that its tiles are lit alike: see `shade`."""

    gain: float = 1.0
    span_um: float = 1.0
    plane: Plane = (0.0, 0.0, 0.0)
    """z = a x + b y + c through the surface, x and y in um: what `deviation` is measured from."""
    form: Form = ()
    """The bowl or dome through the surface: what ``form`` is measured from; none is 0."""


def eight_bit(image: Image) -> NDArray[np.uint8]:
    """A frame as the screen can show it."""
    return (image >> 8).astype(np.uint8) if image.dtype == np.uint16 else np.asarray(image, np.uint8)
