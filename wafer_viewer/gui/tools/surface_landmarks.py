"""Landmarks on the coarse heights of a surface: informative rows, levels, flat faces and bumps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.gui.scene.heightfield import Floats, HeightField, Place

PATCH_SHARES = (1 / 6, 1 / 9, 1 / 12, 1 / 18, 1 / 30)
"""Sides of the squares used to search for faces, largest first, as fractions of the shorter side."""
_BUMP_SHARES = (1 / 3, 1 / 4, 1 / 6, 1 / 9, 1 / 14, 1 / 22)
_LEAST_PATCH_PX, _ROOM_ROUND_BUMP, _STANDS_OUT = 4, 1.25, 1.5
_FLAT, _LEAST_FLAT, SAME_LEVEL, _APART = 0.04, 0.002, 0.12, 0.25
"""Thresholds as fractions of the height range: flat patch (upper and lower bound), equal levels, distinct levels."""


@dataclass(frozen=True, slots=True, eq=False)
class Patches:
    """Fully measured squares of a surface.

    places: centres in um [n, 2].
    level: mean height.
    spread: standard deviation of the heights.
    rough: standard deviation after removal of the tilt.
    tilt: slope in um per um.
    """

    side_um: float
    places: Floats
    level: Floats
    spread: Floats
    rough: Floats
    tilt: Floats

    def only(self, good: NDArray[np.bool_]) -> Patches:
        """Return the patches selected by a mask."""
        columns = (values[good] for values in (self.places, self.level, self.spread, self.rough, self.tilt))
        return Patches(self.side_um, *columns)

    def nearest(self, to: Place) -> int:
        """Return the index of the patch nearest to a position."""
        return int(np.argmin(np.hypot(self.places[:, 0] - to[0], self.places[:, 1] - to[1])))

    def middle(self, number: int) -> Place:
        """Return the centre of a patch."""
        x, y = self.places[number]
        return float(x), float(y)

    def __len__(self) -> int:
        return len(self.places)


def patches(height_field: HeightField, share: float) -> Patches:
    """Return squares with a side of `share` of the surface's shorter side, half a side apart."""
    rows, cols = height_field.heights.shape
    side = max(_LEAST_PATCH_PX, round(min(rows, cols) * share) // 2 * 2)
    step, half = side // 2, side // 2
    z = height_field.heights - height_field.on_show.z0_um
    n, total, squares = (
        _box_sums(layer, (side, side), step) for layer in (height_field.measured_mask.astype(float), z, z * z)
    )
    left, top = _box_sums(z, (side, half), step), _box_sums(z, (half, side), step)
    row, col = np.nonzero(n > 0.98 * side * side)
    mean = total[row, col] / side**2
    variance = np.maximum(squares[row, col] / side**2 - mean**2, 0)
    # Half a square's mean differs from the other half's by the tilt times half a side.
    across = [2 * (total[row, col] - 2 * part[row, col]) / side**2 for part in (left, top)]
    tilted = (across[0] ** 2 + across[1] ** 2) / 3
    x, y = height_field.place(row * step + (side - 1) / 2, col * step + (side - 1) / 2)
    return Patches(
        side_um=side * height_field.pixel_um,
        places=np.stack([x, y], axis=1),
        level=mean,
        spread=np.sqrt(variance),
        rough=np.sqrt(np.maximum(variance - tilted, 0)),
        tilt=np.hypot(*across) / (half * height_field.pixel_um),
    )


def first_line(height_field: HeightField, near: Place) -> tuple[Place, Place]:
    """Return an initial profile: along x, near the point looked at, at the most informative row."""
    x0, y0, x1, y1 = height_field.bounds_um
    x, y = height_field.inner(near)
    half = 0.32 * (x1 - x0)
    x = min(max(x, x0 + half * 1.1), x1 - half * 1.1)
    t = np.linspace(x - half, x + half, 200)
    rows = y + np.linspace(0, 0.3, 13)[:, None] * np.array([1.0, -1.0]) * (y1 - y0)
    best = max(rows.ravel().tolist(), key=lambda row: _row_score(height_field, t, row))
    return height_field.clamped((x - half, best)), height_field.clamped((x + half, best))


def _row_score(height_field: HeightField, x_um: Floats, y_um: float) -> float:
    """Return the score of a row: its measured fraction, weighted by its height range, rounded to one decimal."""
    y = np.full_like(x_um, y_um)
    measured = height_field.measured(x_um, y)
    if not measured.any():
        return 0.0
    climb = float(np.ptp(height_field.z_um(x_um, y)[measured])) / max(span_um(height_field), 1e-9)
    return round(float(measured.mean()) * (1 + min(climb, 1.5)), 1)


def plateaus(height_field: HeightField, near: Place) -> tuple[Place, Place, float]:
    """Return centres of an upper and a lower plateau near a position, and the side of squares that fit on both.

    The plateaus are on the two most frequent levels of the surface, so that a bump on the upper one is not selected.
    """
    for share in PATCH_SHARES:
        candidates = patches(height_field, share)
        flat = candidates.only(_small(candidates.spread, height_field))
        levels = _two_levels(flat.level, span_um(height_field))
        if levels is None:
            continue
        low, high = (
            flat.only(np.abs(flat.level - level) <= SAME_LEVEL / 2 * span_um(height_field)) for level in levels
        )
        upper = high.middle(high.nearest(height_field.inner(near)))
        return upper, low.middle(low.nearest(upper)), flat.side_um
    (x, y), side_um = height_field.inner(near), _least_side(height_field)
    return (x, y + 2 * side_um), (x, y - 2 * side_um), side_um


def _small(spread: Floats, height_field: HeightField) -> NDArray[np.bool_]:
    """Return the mask of flat patches, whose spread is close to the noise level (10th percentile)."""
    if len(spread) == 0:
        return np.zeros(0, bool)
    noise, span = float(np.percentile(spread, 10)), span_um(height_field)
    return spread <= min(_FLAT * span, max(2 * noise, _LEAST_FLAT * span))


def _two_levels(levels: Floats, span: float) -> tuple[float, float] | None:
    """Return the two most frequent levels that are well apart, lower first; None if there are no two."""
    if len(levels) < 2:
        return None
    full = np.count_nonzero(np.abs(levels[:, None] - levels[None, :]) <= SAME_LEVEL / 2 * span, axis=1)
    first = float(levels[np.argmax(full)])
    apart = np.abs(levels - first) >= _APART * span
    if not apart.any():
        return None
    second = float(levels[np.argmax(np.where(apart, full, 0))])
    return min(first, second), max(first, second)


def face(height_field: HeightField, near: Place) -> tuple[Place, float]:
    """Return the centre of a flat face near a position, and the side of a square that fits on it."""
    for share in PATCH_SHARES:
        candidates = patches(height_field, share)
        flat = candidates.only(_small(candidates.rough, height_field))
        if len(flat):
            return flat.middle(flat.nearest(height_field.inner(near))), flat.side_um
    return height_field.inner(near), _least_side(height_field)


def two_faces(height_field: HeightField, near: Place) -> tuple[Place, Place, float]:
    """Return centres of the steepest plane face and a nearby face of low tilt, and the side of the squares."""
    for share in PATCH_SHARES[1:]:
        candidates = patches(height_field, share)
        even = candidates.only(_small(candidates.rough, height_field))
        if len(even) < 2:
            continue
        steep = even.middle(int(np.argmax(even.tilt)))
        apart = np.hypot(even.places[:, 0] - steep[0], even.places[:, 1] - steep[1]) >= even.side_um
        rest = even.only(apart)
        if len(rest):
            level = rest.only(rest.tilt <= np.percentile(rest.tilt, 30))
            return steep, level.middle(level.nearest(steep)), even.side_um
    (x, y), side_um = height_field.inner(near), _least_side(height_field)
    return (x - side_um, y), (x + side_um, y), side_um


def bump(height_field: HeightField, near: Place) -> tuple[Place, float]:
    """Return centre and radius of the most prominent feature, up or down, on level surroundings.

    If there is none, as with adjacent bumps, return a small high feature near a position.
    """
    rows, cols = height_field.heights.shape
    best, middle, radius_um = _STANDS_OUT, None, 0.0
    for share in _BUMP_SHARES:
        side = max(_LEAST_PATCH_PX, round(min(rows, cols) * share))
        bump = _standing_out(height_field, side)
        if bump is not None and bump[0] > best:
            best, middle, radius_um = *bump, 0.5 * _ROOM_ROUND_BUMP * side * height_field.pixel_um
    return (
        (middle, radius_um)
        if middle is not None
        else (_high(height_field, near), 1.5 * _LEAST_PATCH_PX * height_field.pixel_um)
    )


def _high(height_field: HeightField, near: Place) -> Place:
    """Return a high position near another."""
    side = _LEAST_PATCH_PX
    levels = _box_sums(height_field.heights - height_field.on_show.z0_um, (side, side), 1)
    row, col = np.nonzero(levels >= np.percentile(levels, 98))
    x, y = height_field.place(row + (side - 1) / 2, col + (side - 1) / 2)
    away = np.hypot(x - height_field.inner(near)[0], y - height_field.inner(near)[1])
    # The top of the nearest: of the high places about as near the highest.
    reach = away <= away.min() + 4 * side * height_field.pixel_um
    best = int(np.argmax(np.where(reach, levels[row, col], -np.inf)))
    return float(x[best]), float(y[best])


def _standing_out(height_field: HeightField, side: int) -> tuple[float, Place] | None:
    """Return the highest prominence of a square of `side` pixels, and its centre; None if the surface is too small.

    Prominence: height difference from the surrounding ring, divided by the spread of the ring.
    """
    z, wide, step = height_field.heights - height_field.on_show.z0_um, 2 * side, max(1, side // 4)
    if min(z.shape) < wide:
        return None
    measured = _box_sums(height_field.measured_mask.astype(float), (wide, wide), step)
    total, squares = (_box_sums(layer, (wide, wide), step) for layer in (z, z * z))
    edge = side // 2
    inner = z[edge : z.shape[0] - (wide - side - edge), edge : z.shape[1] - (wide - side - edge)]
    mine, mine2 = (
        _box_sums(layer, (side, side), step)[: measured.shape[0], : measured.shape[1]] for layer in (inner, inner**2)
    )
    n = wide**2 - side**2
    ring = (total - mine) / n
    spread = np.sqrt(np.maximum((squares - mine2) / n - ring**2, 0))
    out = np.abs(mine / side**2 - ring) / (spread + 0.02 * span_um(height_field))
    out[measured < 0.98 * wide**2] = 0
    row, col = np.unravel_index(int(np.argmax(out)), out.shape)
    middle = height_field.place(float(row * step + wide / 2), float(col * step + wide / 2))
    return float(out[row, col]), middle


def span_um(height_field: HeightField) -> float:
    """Return the range of heights without outliers."""
    return height_field.on_show.facts.high_um - height_field.on_show.facts.low_um


def _least_side(height_field: HeightField) -> float:
    return max(_LEAST_PATCH_PX, min(height_field.heights.shape) * PATCH_SHARES[-1]) * height_field.pixel_um


def _box_sums(layer: Floats, sides: tuple[int, int], step: int) -> Floats:
    """Return sums over boxes of `sides` (rows, cols) pixels that start every `step` pixels."""
    rows, cols = sides
    sums = np.pad(layer, ((1, 0), (1, 0))).cumsum(axis=0).cumsum(axis=1)
    boxes = sums[rows:, cols:] - sums[:-rows, cols:] - sums[rows:, :-cols] + sums[:-rows, :-cols]
    return boxes[::step, ::step]
