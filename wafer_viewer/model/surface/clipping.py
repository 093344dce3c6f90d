"""Clipping of a displayed surface: by height, confidence, a box or a slab."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from wafer_viewer.model.region import Region

Box = tuple[float, float, float, float]
"""x low, y low, x high, y high in um."""
Span = tuple[float, float]
"""Lowest and highest height in um."""
BeforeSlab = Literal["show", "pale", "hide"]
LeftOut = Literal["height", "box", "confidence", "slab"]
LEFT_OUT: tuple[LeftOut, ...] = ("box", "height", "confidence", "slab")
"""Reasons for hiding a point, in order of precedence: a point counts once, for the first reason."""


@dataclass(frozen=True, slots=True)
class Slab:
    """A vertical slab along a line, `line.width_um` thick.

    before: display of the points on its near side, to the right of the direction from the line's first end to its
    second: as all others, pale, or hidden.
    """

    line: Region
    before: BeforeSlab = "pale"


@dataclass(frozen=True, slots=True)
class Clip:
    """Clipping of a point cloud; by default nothing is clipped.

    heights_um: over the current datum; least_confidence: 0 ... 1, points below it are hidden; box_um: in the plane of
    the stage. None clips nothing.
    """

    heights_um: Span | None = None
    least_confidence: float = 0.0
    box_um: Box | None = None
    slab: Slab | None = None

    @property
    def clips(self) -> bool:
        """True if any clipping is active."""
        return self != Clip()
