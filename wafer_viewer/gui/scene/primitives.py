"""Factories for scene nodes: lines, labels, images in the sample plane, and lines draped over a surface."""

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
from wafer_viewer.draw.surface.mesh import painted
from wafer_viewer.gui.scene.reconciler import Handle
from wafer_viewer.session.rendering.render_request import CoarseHeightField

Segments = NDArray[np.float32]
Box = tuple[float, float, float, float]
"""(x low, y low, x high, y high) in mm."""


class Group:
    """Nodes that are scaled and removed together."""

    def __init__(self, *handles: Handle) -> None:
        self._handles = handles
        self._scale = (1.0, 1.0, 1.0)

    @property
    def scale(self) -> tuple[float, float, float]:
        """Common scale of all nodes."""
        return self._scale

    @scale.setter
    def scale(self, scale: tuple[float, float, float]) -> None:
        self._scale = scale
        for handle in self._handles:
            handle.scale = scale

    def remove(self) -> None:
        """Remove all nodes."""
        for handle in self._handles:
            handle.remove()


@dataclass(frozen=True, slots=True)
class Layer:
    """A node with a screen-space offset above the surface.

    It is visible if `length_mm` spans at least `least_px` pixels.
    """

    handle: Handle
    up_px: float
    length_mm: float = math.inf
    least_px: float = 0.0

    def settle(self, mm_per_pixel: float) -> None:
        """Update the offset and the visibility for a pixel size."""
        self.handle.position = (0.0, 0.0, self.up_px * mm_per_pixel)
        self.handle.visible = self.length_mm >= self.least_px * mm_per_pixel


class Layers(Group):
    """Stacked layers that keep their distances on the screen at any zoom."""

    def __init__(self, layers: Sequence[Layer], mm_per_pixel: float) -> None:
        super().__init__(*(layer.handle for layer in layers))
        self._layers, self._mm_per_pixel = layers, 0.0
        self.settle(mm_per_pixel)

    def settle(self, mm_per_pixel: float) -> None:
        """Update all layers if the pixel size has changed by more than 10 %."""
        if abs(mm_per_pixel - self._mm_per_pixel) <= 0.1 * self._mm_per_pixel:
            return
        self._mm_per_pixel = mm_per_pixel
        for layer in self._layers:
            layer.settle(mm_per_pixel)


def rectangle(box: Box, z: float) -> Segments:
    """Return the four sides of an axis-aligned rectangle, [4, 2, 3]."""
    x0, y0, x1, y1 = box
    return closed([(x0, y0), (x1, y0), (x1, y1), (x0, y1)], z)


def closed(corners: Sequence[tuple[float, float]], z: float) -> Segments:
    """Return the sides of a polygon at one height, [n, 2, 3]."""
    points = np.array([(x, y, z) for x, y in corners], np.float32)
    return np.stack([points, np.roll(points, -1, axis=0)], axis=1)


def polyline_segments(points: NDArray[np.float32]) -> Segments:
    """Return the segments of an open polyline through points [n, 3]."""
    return np.stack([points[:-1], points[1:]], axis=1)


def dashed(segments: Segments, dash_mm: float, share: float = 0.55) -> Segments:
    """Return the segments in dashes. Each is divided into full periods, so that a dash begins at every corner."""
    out: list[Segments] = []
    for a, b in segments:
        n = max(1, round(float(np.linalg.norm(b - a)) / dash_mm))
        starts = np.arange(n, dtype=np.float32)[:, None] / n
        out.append(np.stack([a + (b - a) * starts, a + (b - a) * (starts + share / n)], axis=1))
    return np.concatenate(out).astype(np.float32)


def lines(scene: viser.SceneApi, name: str, segments: Segments, colour: Rgb, width_px: float) -> Handle:
    """Add lines of a constant width on the screen."""
    return scene.add_line_segments(name, segments, colour, thickness=width_px, thickness_units="screen")


def cased(
    scene: viser.SceneApi, name: str, segments: Segments, colour: Rgb, width_px: float, lift_mm: float, casing: Rgb
) -> Group:
    """Add lines over a wider casing, lifted `lift_mm` above it to avoid z-fighting."""
    raised = segments + np.array([0, 0, lift_mm], np.float32)
    return Group(
        lines(scene, f"{name}/casing", segments, casing, width_px + 3.1),
        lines(scene, f"{name}/line", raised, colour, width_px),
    )


def add_image_plane(
    scene: viser.SceneApi, name: str, picture: NDArray[np.uint8], box: Box, z: float, *, blend: bool = True
) -> Handle:
    """Add an image in the plane of the sample, its top edge at the larger y.

    With `blend`, partial alpha is translucent. Without it the alpha is a cutout, and content on top is reliably drawn
    over the image; the browser cannot guarantee this order for two translucent images.
    """
    return add_glb(scene, name, image_plane(picture, box, z, blend=blend))


def image_plane(picture: NDArray[np.uint8], box: Box, z: float, *, blend: bool = True) -> bytes:
    """Return the GLB of an image in the plane of the sample; see `add_image_plane`."""
    return painted(mesh.flat(*box, z), picture, blend=blend)


def add_glb(scene: viser.SceneApi, name: str, data: bytes) -> Handle:
    """Add an unlit mesh without shadows, because lighting is baked into its texture."""
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
    """Add text in the plane of the sample.

    anchor: point of the text at `at_mm`, as fractions of its width and of its height from below.
    """
    picture = tag(text, colour, pill)
    width_mm = height_mm * picture.shape[1] / picture.shape[0]
    x, y = at_mm[0] - anchor[0] * width_mm, at_mm[1] - anchor[1] * height_mm
    return add_image_plane(scene, name, picture, (x, y, x + width_mm, y + height_mm), at_mm[2], blend=pill is None)


Floats = NDArray[np.float64]
_FINE = 4
"""Height samples between two vertices of a line, so that the line passes over the heights between them."""
_MOST_SEGMENTS = 60_000


class DrapedLines:
    """Draping of lines on heights relative to `z0_um`, in mm; flat if there is no relief.

    span_um: length of a straight piece. Lines pass straight over narrower structures.
    """

    def __init__(self, relief: CoarseHeightField | None, z0_um: float, span_um: float) -> None:
        self._relief, self._z0_um, self._span_um = relief, z0_um, span_um
        if relief is not None:
            self._z_um = np.frombuffer(relief.z_um, "<f4").reshape(relief.rows, relief.cols)

    def z_mm(self, x_um: Floats, y_um: Floats) -> Floats:
        """Return the height of the nearest pixel at each position; outside of the surface that of the edge."""
        relief = self._relief
        if relief is None:
            return np.zeros(np.shape(x_um))
        col = np.clip(np.rint((x_um - relief.x0_um) / relief.pixel_um), 0, relief.cols - 1).astype(np.intp)
        row = np.clip(np.rint((relief.y0_um - y_um) / relief.pixel_um), 0, relief.rows - 1).astype(np.intp)
        return (self._z_um[row, col].astype(np.float64) - self._z0_um) * 1e-3

    def highest_mm(self, boxes_um: Floats) -> Floats:
        """Return a robust maximum height (97th percentile) within each box [n, 4]."""
        share = np.linspace(0, 1, 12)
        x = boxes_um[:, 0, None] + (boxes_um[:, 2] - boxes_um[:, 0])[:, None] * share
        y = boxes_um[:, 1, None] + (boxes_um[:, 3] - boxes_um[:, 1])[:, None] * share
        z = self.z_mm(*np.broadcast_arrays(x[:, None, :], y[:, :, None]))
        return np.percentile(z.reshape(len(boxes_um), -1), 97, axis=1) if len(boxes_um) else np.zeros(0)

    def segments(self, pieces_um: Floats) -> NDArray[np.float32]:
        """Return straight pieces [n, 2, 2] as segments that follow the surface, float32 [m, 2, 3] in mm."""
        if not len(pieces_um):
            return np.zeros((0, 2, 3), np.float32)
        m = self._corners(pieces_um)
        share = np.linspace(0, 1, m * _FINE + 1)[:, None]
        places = pieces_um[:, None, 0] + (pieces_um[:, 1] - pieces_um[:, 0])[:, None] * share
        z = self.z_mm(places[..., 0], places[..., 1])
        around = np.pad(z, ((0, 0), (_FINE, _FINE)), mode="edge")
        highest = np.lib.stride_tricks.sliding_window_view(around, 2 * _FINE + 1, axis=1).max(axis=2)
        points = np.concatenate([places * 1e-3, highest[..., None]], axis=2)[:, ::_FINE]
        return np.stack([points[:, :-1], points[:, 1:]], axis=2).reshape(-1, 2, 3).astype(np.float32)

    def level(self, figures_um: Floats) -> NDArray[np.float32]:
        """Return figures of straight pieces [n, m, 2, 2] as segments, each figure level above the heights it covers."""
        if not len(figures_um):
            return np.zeros((0, 2, 3), np.float32)
        share = np.linspace(0, 1, 4 * _FINE)[:, None]
        shafts = figures_um[:, :, None, 0] + (figures_um[:, :, 1] - figures_um[:, :, 0])[:, :, None] * share
        highest = self.z_mm(shafts[..., 0], shafts[..., 1]).max(axis=(1, 2))
        z = np.broadcast_to(highest[:, None, None, None], (*figures_um.shape[:3], 1))
        return np.concatenate([figures_um * 1e-3, z], axis=3).reshape(-1, 2, 3).astype(np.float32)

    def _corners(self, pieces_um: Floats) -> int:
        """Return the number of parts per piece: one per span, limited by `_MOST_SEGMENTS`."""
        if self._relief is None:
            return 1
        longest = float(np.hypot(*(pieces_um[:, 1] - pieces_um[:, 0]).T).max())
        wanted = round(longest / self._span_um)
        return int(np.clip(wanted, 1, max(1, _MOST_SEGMENTS // len(pieces_um))))
