"""Display style of a surface, as chosen on the page; a light import without rendering code."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.focus_stack import Image

Quantity = Literal[
    "height", "confidence", "uncertainty", "slope", "deviation", "form", "overlap", "grey", "origin", "difference"
]
Plane = tuple[float, float, float]
Form = tuple[float, ...]
"""Centre x, centre y and half width in um, then the coefficients of 1, u, v, u², uv, v²; u and v are -1 ... 1."""

QUANTITIES: dict[Quantity, tuple[str, str]] = {
    "height": ("Height", "µm"),
    "confidence": ("Confidence", ""),
    "uncertainty": ("U, k = 2", "µm"),
    "slope": ("Slope", "°"),
    "deviation": ("Deviation", "µm"),
    "form": ("Deviation", "µm"),
    "overlap": ("Difference", "µm"),
    "grey": ("Grey", ""),
    "origin": ("Origin", ""),
    "difference": ("Second − first", "µm"),
}
"""Colour bar title and unit of each quantity that a surface can be coloured by."""


@dataclass(frozen=True, slots=True)
class DisplayStyle:
    """Chosen quantity, colour map and range, and strengths of hillshade and image (0 ... 1).

    depth_shade: strength of the depth shading of a point cloud, 0 ... 1; brush_um: highlighted height range.
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
    """Lighting parameters from the entire surface, so that all tiles are lit alike: see `shade`."""

    gain: float = 1.0
    span_um: float = 1.0
    plane: Plane = (0.0, 0.0, 0.0)
    """z = a x + b y + c through the surface, x and y in um: reference of `deviation`."""
    form: Form = ()
    """Second-order form of the surface: reference of ``form``; an empty form is 0."""


def eight_bit(image: Image) -> NDArray[np.uint8]:
    """Return a frame as 8 bits for display."""
    return (image >> 8).astype(np.uint8) if image.dtype == np.uint16 else np.asarray(image, np.uint8)
