"""What a scene holds: its items, how heights are drawn, and what the camera should take in."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass, field

import numpy as np

from wafer_viewer.gui.camera import Clear, Vector
from wafer_viewer.gui.shapes import Box
from wafer_viewer.gui.stage import Item
from wafer_viewer.session.paint_request import Facts, Scale, Source


@dataclass(frozen=True, slots=True)
class OnShow:
    """The surface in the scene, and how its heights become scene z: (z_um - z0_um) * stretch / 1000."""

    source: Source
    facts: Facts
    scale: Scale
    z0_um: float
    stretch: float

    def scene_z(self, z_um: float) -> float:
        """Scene z in mm of a height."""
        return (z_um - self.z0_um) * 1e-3 * self.stretch


@dataclass(frozen=True, slots=True, eq=False)
class Contents:
    """Everything to be drawn. `rough` is shown first when nothing of the same kind is drawn yet.

    `awaits_more`: what else there is to draw is known only when the painter has answered.
    place: the camera goes to `preset` when this changes; corners_mm [n, 3]: what it takes in.
    """

    items: tuple[Item, ...]
    corners_mm: Vector
    place: Hashable
    preset: str = "iso"
    stretch: float = 1.0
    rough: tuple[Item, ...] = ()
    on_show: OnShow | None = None
    awaits_more: bool = False
    clear: Clear = field(default_factory=Clear)


def corners_of(box: Box, low_mm: float, high_mm: float) -> Vector:
    """The eight corners of a block, [8, 3]."""
    x0, y0, x1, y1 = box
    return np.array([(x, y, z) for x in (x0, x1) for y in (y0, y1) for z in (low_mm, high_mm)], float)
