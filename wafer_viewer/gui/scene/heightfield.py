"""Coarse height field of the displayed surface, and picking at full resolution."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.gui.scene.scene_contents import DisplayedSurface
from wafer_viewer.model.errors import WaferViewerError
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.height_map import HeightMap, Mosaic
from wafer_viewer.session.rendering.render_request import CoarseHeightField

Floats = NDArray[np.float64]
Place = tuple[float, float]
"""Stage x, y in um."""
Box = tuple[float, float, float, float]
"""x low, y low, x high, y high in um."""
LEAST_IN_SIGHT_PX = 40
"""A visible part with fewer coarse heights across is too small to search for regions in."""

_RAY_STEPS = 1500
_HALVINGS = 14
_ROUND_PIECES = 160


class HeightField:
    """Heights of one surface and their display. Positions are stage um, rays are scene mm.

    holes: True if the ground is visible where nothing is measured.
    """

    def __init__(self, relief: CoarseHeightField, on_show: DisplayedSurface, holes: bool = True) -> None:
        self._relief, self.on_show, self._holes = relief, on_show, holes
        shape = (relief.rows, relief.cols)
        self._z_um = np.frombuffer(relief.z_um, "<f4").reshape(shape)
        self._measured = np.frombuffer(relief.measured, bool).reshape(shape)

    @property
    def bounds_um(self) -> tuple[float, float, float, float]:
        """Extent as (x low, y low, x high, y high)."""
        r = self._relief
        return r.x0_um, r.y0_um - (r.rows - 1) * r.pixel_um, r.x0_um + (r.cols - 1) * r.pixel_um, r.y0_um

    @property
    def holes(self) -> bool:
        """True if the ground is visible where nothing is measured."""
        return self._holes

    @property
    def pixel_um(self) -> float:
        """Spacing of the coarse heights."""
        return self._relief.pixel_um

    @property
    def heights(self) -> Floats:
        """Coarse heights [row, col] in um; gaps are filled from their nearest neighbour."""
        return self._z_um.astype(float)

    @property
    def measured_mask(self) -> NDArray[np.bool_]:
        """Mask of the measured pixels."""
        return self._measured

    def place(self, row: Any, col: Any) -> tuple[Any, Any]:
        """Return x, y in um of coarse pixels: scalars for scalars, arrays for arrays."""
        return self._relief.x0_um + col * self.pixel_um, self._relief.y0_um - row * self.pixel_um

    def within(self, box: Box) -> HeightField:
        """Return the part of the surface within a box (um); the entire surface if it is too small or unmeasured."""
        r, (x0, y0, x1, y1) = self._relief, box
        left, right = (round((x - r.x0_um) / r.pixel_um) for x in (x0, x1))
        top, foot = (round((r.y0_um - y) / r.pixel_um) for y in (y1, y0))
        rows, cols = slice(max(0, top), max(0, foot + 1)), slice(max(0, left), max(0, right + 1))
        z, mask = self._z_um[rows, cols], self._measured[rows, cols]
        if min(z.shape) < LEAST_IN_SIGHT_PX or not mask.any():
            return self
        x, y = self.place(rows.start, cols.start)
        part = CoarseHeightField(z.shape[0], z.shape[1], r.pixel_um, x, y, z.tobytes(), mask.tobytes())
        return HeightField(part, self.on_show, self._holes)

    def clamped(self, place: Place) -> Place:
        """Return the position clamped to the surface, rounded to 0.01 um."""
        x0, y0, x1, y1 = self.bounds_um
        return round(min(max(place[0], x0), x1), 2), round(min(max(place[1], y0), y1), 2)

    def z_um(self, x_um: Floats, y_um: Floats) -> Floats:
        """Return bilinearly interpolated heights; outside of the surface those of the edge."""
        r = self._relief
        col = np.clip((np.asarray(x_um) - r.x0_um) / r.pixel_um, 0, r.cols - 1.001)
        row = np.clip((r.y0_um - np.asarray(y_um)) / r.pixel_um, 0, r.rows - 1.001)
        c, f = np.floor(col).astype(int), np.floor(row).astype(int)
        u, v, z = col - c, row - f, self._z_um
        return (z[f, c] * (1 - u) + z[f, c + 1] * u) * (1 - v) + (z[f + 1, c] * (1 - u) + z[f + 1, c + 1] * u) * v

    def measured(self, x_um: Floats, y_um: Floats) -> NDArray[np.bool_]:
        """Return whether the nearest pixel of each position has a height."""
        r = self._relief
        col = np.clip(np.round((np.asarray(x_um) - r.x0_um) / r.pixel_um), 0, r.cols - 1).astype(int)
        row = np.clip(np.round((r.y0_um - np.asarray(y_um)) / r.pixel_um), 0, r.rows - 1).astype(int)
        return self._measured[row, col]

    def nearest_measured(self, place: Place) -> Place:
        """Return the position, or the nearest one that has a height."""
        x, y = self.clamped(place)
        if self.measured(np.array([x]), np.array([y]))[0] or not self._measured.any():
            return x, y
        row, col = np.nonzero(self._measured)
        xs, ys = self.place(row.astype(float), col.astype(float))
        best = int(np.argmin(np.hypot(xs - x, ys - y)))
        return self.clamped((float(xs[best]), float(ys[best])))

    def visible_z_um(self, x_um: Floats, y_um: Floats) -> Floats:
        """Return the visible heights: the surface, or the ground through a hole."""
        z = self.z_um(x_um, y_um)
        return np.where(self.measured(x_um, y_um), z, self.on_show.z0_um) if self._holes else z

    def visible_z_mm(self, x_mm: Floats, y_mm: Floats) -> Floats:
        """Return scene z of the visible heights: the surface; in holes and outside of it the ground."""
        z_mm = (self.visible_z_um(x_mm * 1e3, y_mm * 1e3) - self.on_show.z0_um) * 1e-3 * self.on_show.stretch
        return np.where(self._inside(x_mm, y_mm), z_mm, 0.0)

    def scene_points(self, x_um: Floats, y_um: Floats, lift_mm: float = 0.0) -> NDArray[np.float32]:
        """Return positions on the displayed surface as scene points, float32 [n, 3]."""
        z = (self.z_um(x_um, y_um) - self.on_show.z0_um) * 1e-3 * self.on_show.stretch + lift_mm
        return np.stack([np.asarray(x_um) * 1e-3, np.asarray(y_um) * 1e-3, z], axis=1).astype(np.float32)

    def visible_points(self, x_um: Floats, y_um: Floats, lift_mm: float) -> NDArray[np.float32]:
        """Return positions at their visible heights (in a hole the ground) as scene points, float32 [n, 3]."""
        z = (self.visible_z_um(x_um, y_um) - self.on_show.z0_um) * 1e-3 * self.on_show.stretch + lift_mm
        return np.stack([np.asarray(x_um) * 1e-3, np.asarray(y_um) * 1e-3, z], axis=1).astype(np.float32)

    def drape_line(self, a: Place, b: Place, lift_mm: float) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        """Return a line from a to b draped on the surface, as points [n, 3] and the mask of measured pieces [n - 1]."""
        t = np.linspace(0, 1, 480)
        x, y = a[0] + (b[0] - a[0]) * t, a[1] + (b[1] - a[1]) * t
        ends_measured = self.measured(x, y)
        return self.drape(x, y, lift_mm), ends_measured[:-1] & ends_measured[1:]

    def drape(self, x_um: Floats, y_um: Floats, lift_mm: float) -> NDArray[np.float32]:
        """Return a path draped on the surface as points [n, 3]; it passes over narrow pits."""
        points = self.scene_points(x_um, y_um, lift_mm)
        padded = np.pad(points[:, 2], 2, mode="edge")
        points[:, 2] = np.max([padded[k : k + len(points)] for k in range(5)], axis=0)
        return points

    def drape_outline(self, corners_um: Floats, lift_mm: float) -> NDArray[np.float32]:
        """Return the closed outline through corners [n, 2] draped on the surface, as segments [m, 2, 3]."""
        ends = np.roll(corners_um, -1, axis=0)
        t = np.linspace(0, 1, max(1, _ROUND_PIECES // len(corners_um)), endpoint=False)[:, None]
        path = np.concatenate([a + (b - a) * t for a, b in zip(corners_um, ends, strict=True)])
        points = self.drape(path[:, 0], path[:, 1], lift_mm)
        return np.stack([points, np.roll(points, -1, axis=0)], axis=1)

    def hit(self, origin: Floats, direction: Floats) -> Place | None:
        """Return the first intersection of a ray with the surface, or with the ground in a hole; None if it misses."""
        share = self.reached(origin, direction)
        if share is None:
            return None
        x, y, _ = origin + direction * share
        return self.clamped((float(x) * 1e3, float(y) * 1e3))

    def reached(self, origin: Floats, direction: Floats) -> float | None:
        """Return the ray parameter, in units of `direction`, of the first visible intersection; None if it misses."""
        span = self._crossing(origin, direction)
        if span is None:
            return None
        t = np.linspace(*span, _RAY_STEPS)
        below = np.flatnonzero(self._depth(origin, direction, t) <= 0)
        if below.size == 0:
            return None
        low, high = float(t[max(0, below[0] - 1)]), float(t[below[0]])
        for _ in range(_HALVINGS):
            middle = (low + high) / 2
            low, high = (low, middle) if self._depth(origin, direction, np.array([middle]))[0] <= 0 else (middle, high)
        x, y, _ = origin + direction * high
        return high if self._inside(np.array([x]), np.array([y]))[0] else None

    def _crossing(self, origin: Floats, direction: Floats) -> tuple[float, float] | None:
        """Return the ray interval between the highest displayed height and the ground."""
        if abs(direction[2]) < 1e-9:
            return None
        top, foot = (
            self.on_show.scene_z(float(self._z_um.max())),
            min(0.0, self.on_show.scene_z(float(self._z_um.min()))),
        )
        ends = sorted(((top - origin[2]) / direction[2], (foot - origin[2]) / direction[2]))
        return (max(0.0, float(ends[0])), float(ends[1]) * (1 + 1e-9) + 1e-9) if ends[1] > 0 else None

    def _depth(self, origin: Floats, direction: Floats, t: Floats) -> Floats:
        """Return the heights of ray points above the surface, in um; infinite outside of the surface."""
        x, y, z = (origin[k] + direction[k] * t for k in range(3))
        over = z * 1e3 / self.on_show.stretch + self.on_show.z0_um - self.visible_z_um(x * 1e3, y * 1e3)
        return np.where(self._inside(x, y), over, np.inf)

    def _inside(self, x_mm: Floats, y_mm: Floats) -> NDArray[np.bool_]:
        x0, y0, x1, y1 = (v * 1e-3 for v in self.bounds_um)
        return (x_mm >= x0) & (x_mm <= x1) & (y_mm >= y0) & (y_mm <= y1)

    def inner(self, near: Place) -> Place:
        """Return the position clamped to the central half of the surface."""
        x0, y0, x1, y1 = self.bounds_um
        x = min(max(near[0], x0 + 0.25 * (x1 - x0)), x1 - 0.25 * (x1 - x0))
        return x, min(max(near[1], y0 + 0.25 * (y1 - y0)), y1 - 0.25 * (y1 - y0))


Read = Callable[[int], Mosaic]
"""Returns the surface with a number; 0 is the stitched one."""
_REACH_PX, _MOST_PX = 4, 512
"""Margin around the ray's footprint in coarse pixels, and the most fine pixels per direction."""


def refine_height_field(read: Read, height_field: HeightField, origin: Floats, direction: Floats) -> HeightField:
    """Return the heights under a ray at the surface's resolution; the coarse heights if no finer ones can be read."""
    show, box = height_field.on_show.source.show, _ray_footprint(height_field, origin, direction)
    if show < 0:  # two surfaces compared are as coarse as they are drawn
        return height_field
    try:
        surface = read(show)
        if surface.pixel_um >= height_field.pixel_um:
            return height_field
        side_px = max(box[2] - box[0], box[3] - box[1]) / surface.pixel_um
        level = max(0, math.ceil(math.log2(max(1.0, side_px / _MOST_PX))))
        part = surface.window(Region.rectangle(*box), min(level, surface.levels - 1))
    except WaferViewerError:
        return height_field
    return HeightField(_relief(part, height_field), height_field.on_show, height_field.holes)


def _ray_footprint(height_field: HeightField, origin: Floats, direction: Floats) -> Box:
    """Return the footprint of a ray between the highest height and the ground, in um, with a margin."""
    on_show, reach_um = height_field.on_show, _REACH_PX * height_field.pixel_um
    levels = on_show.scene_z(on_show.facts.highest_um), 0.0
    ends = [1e3 * (origin + direction * ((z - origin[2]) / direction[2])) for z in levels]
    x, y = ([float(end[k]) for end in ends] for k in range(2))
    low, high = (
        height_field.clamped((min(x) - reach_um, min(y) - reach_um)),
        height_field.clamped((max(x) + reach_um, max(y) + reach_um)),
    )
    return *low, *high


def _relief(part: HeightMap, height_field: HeightField) -> CoarseHeightField:
    """Return a part of a surface relative to the displayed datum, with gaps filled from the coarse heights."""
    x_um, y_um = (np.asarray(a, np.float64) for a in np.meshgrid(part.x_um, part.y_um))
    datum = height_field.on_show.datum
    z_um = part.z_um - (datum.at(x_um, y_um) if datum is not None else 0.0)
    finite = np.isfinite(z_um)
    z_um = np.where(finite, z_um, height_field.z_um(x_um, y_um))
    return CoarseHeightField(
        *part.shape, part.pixel_um, part.x0_um, part.y0_um, z_um.astype("<f4").tobytes(), finite.tobytes()
    )
