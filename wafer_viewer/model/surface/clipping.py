"""Which points of a surface are drawn: clipped by height, confidence, a box, or cut away before a slab."""

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
"""Why a point is not drawn, in the order in which it is asked: a point counts once, for the first reason."""


@dataclass(frozen=True, slots=True)
class Slab:
    """A vertical slab along a line, `line.width_um` thick.

    before: what becomes of the points on its near side, the right-hand side of the way from the line's first end to
    its second. They are drawn like all others, pale, or not at all.
    """

    line: Region
    before: BeforeSlab = "pale"


@dataclass(frozen=True, slots=True)
class Clip:
    """What is drawn of a point cloud; by default all of it.

    heights_um: over the datum on show; least_confidence: 0 ... 1, points below it are left out; box_um: in the plane of
    the stage. None clips nothing.
    """

    heights_um: Span | None = None
    least_confidence: float = 0.0
    box_um: Box | None = None
    slab: Slab | None = None

    @property
    def clips(self) -> bool:
        """Whether anything can be left out."""
        return self != Clip()
