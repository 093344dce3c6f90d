"""Small makers of scene nodes: lines with a casing, dashes, tags, pictures that lie in the plane of the sample."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import viser
from numpy.typing import NDArray

from wafer_viewer.draw.colormaps import Rgb
from wafer_viewer.draw.raster_text import tag
from wafer_viewer.draw.surface import mesh
from wafer_viewer.draw.surface.glb import painted
from wafer_viewer.gui.scene.reconciler import Handle

Segments = NDArray[np.float32]
Box = tuple[float, float, float, float]
"""(x low, y low, x high, y high) in mm."""


class Group:
    """Nodes that come and go together."""

    def __init__(self, *handles: Handle) -> None:
        self._handles = handles
        self._scale = (1.0, 1.0, 1.0)

    @property
    def scale(self) -> tuple[float, float, float]:
        """How they are stretched, all alike."""
        return self._scale

    @scale.setter
    def scale(self, scale: tuple[float, float, float]) -> None:
        self._scale = scale
        for handle in self._handles:
            handle.scale = scale

    def remove(self) -> None:
        """Remove them all."""
        for handle in self._handles:
            handle.remove()


@dataclass(frozen=True, slots=True)
class Layer:
    """A node that lies so many pixels over the surface, and is seen where a length of its own has enough pixels."""

    handle: Handle
    up_px: float
    length_mm: float = math.inf
    least_px: float = 0.0

    def settle(self, mm_per_pixel: float) -> None:
        """Lie and be seen as is right for a pixel of this size."""
        self.handle.position = (0.0, 0.0, self.up_px * mm_per_pixel)
        self.handle.visible = self.length_mm >= self.least_px * mm_per_pixel


class Layers(Group):
    """Layers over one another, which keep their distances on the screen however near one looks."""

    def __init__(self, layers: Sequence[Layer], mm_per_pixel: float) -> None:
        super().__init__(*(layer.handle for layer in layers))
        self._layers, self._mm_per_pixel = layers, 0.0
        self.settle(mm_per_pixel)

    def settle(self, mm_per_pixel: float) -> None:
        """Lie as is right for a pixel of this size, where that has changed enough to be seen."""
        if abs(mm_per_pixel - self._mm_per_pixel) <= 0.1 * self._mm_per_pixel:
            return
        self._mm_per_pixel = mm_per_pixel
        for layer in self._layers:
            layer.settle(mm_per_pixel)


def rectangle(box: Box, z: float) -> Segments:
    """The four sides of an upright rectangle, [4, 2, 3]."""
    x0, y0, x1, y1 = box
    return closed([(x0, y0), (x1, y0), (x1, y1), (x0, y1)], z)


def closed(corners: Sequence[tuple[float, float]], z: float) -> Segments:
    """The sides of a polygon at one height, [n, 2, 3]."""
    points = np.array([(x, y, z) for x, y in corners], np.float32)
    return np.stack([points, np.roll(points, -1, axis=0)], axis=1)


def way(points: NDArray[np.float32]) -> Segments:
    """The pieces of an open line through points [n, 3]."""
    return np.stack([points[:-1], points[1:]], axis=1)


def dashed(segments: Segments, dash_mm: float, share: float = 0.55) -> Segments:
    """The segments in dashes: each is cut into whole periods, so that a dash begins at every corner."""
    out: list[Segments] = []
    for a, b in segments:
        n = max(1, round(float(np.linalg.norm(b - a)) / dash_mm))
        starts = np.arange(n, dtype=np.float32)[:, None] / n
        out.append(np.stack([a + (b - a) * starts, a + (b - a) * (starts + share / n)], axis=1))
    return np.concatenate(out).astype(np.float32)


def lines(scene: viser.SceneApi, name: str, segments: Segments, colour: Rgb, width_px: float) -> Handle:
    """Lines of a constant width on the screen."""
    return scene.add_line_segments(name, segments, colour, thickness=width_px, thickness_units="screen")


def cased(
    scene: viser.SceneApi, name: str, segments: Segments, colour: Rgb, width_px: float, lift_mm: float, casing: Rgb
) -> Group:
    """Lines over a wider casing, lifted above it by so much that they do not flicker."""
    raised = segments + np.array([0, 0, lift_mm], np.float32)
    return Group(
        lines(scene, f"{name}/casing", segments, casing, width_px + 3.1),
        lines(scene, f"{name}/line", raised, colour, width_px),
    )


def lying(
    scene: viser.SceneApi, name: str, picture: NDArray[np.uint8], box: Box, z: float, *, blend: bool = True
) -> Handle:
    """A picture in the plane of the sample, its top edge at the larger y.

    Where its alpha is between, it is translucent; without `blend` it is cut out, and what lies on it is sure to be
    drawn over it, which the browser cannot promise for two translucent pictures.
    """
    data = painted(mesh.flat(*box, z), picture, blend=blend)
    return scene.add_glb(name, data, cast_shadow=False, receive_shadow=False)


def word(
    scene: viser.SceneApi,
    name: str,
    text: str,
    at_mm: tuple[float, float, float],
    height_mm: float,
    colour: Rgb,
    pill: Rgb | None = None,
    anchor: tuple[float, float] = (0.5, 0.5),
) -> Handle:
    """A word in the plane of the sample; `anchor` is the share of its width and height (from its foot) at the place."""
    picture = tag(text, colour, pill)
    width_mm = height_mm * picture.shape[1] / picture.shape[0]
    x, y = at_mm[0] - anchor[0] * width_mm, at_mm[1] - anchor[1] * height_mm
    return lying(scene, name, picture, (x, y, x + width_mm, y + height_mm), at_mm[2], blend=pill is None)
