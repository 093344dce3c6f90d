"""Gradients of a pattern, saturated so that noise and strong edges count alike, and the rotation of its edges. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from wafer_viewer.model.errors import DiesNotFound
from wafer_viewer.numerics.jit import Bools, Float32s


@dataclass(frozen=True, slots=True)
class GradientParameters:
    """Limits of the gradients of a pattern, and of its rotation.

    Parameters
    ----------
    blur_px : float, px
        Standard deviation of the blur before gradients are taken.
    least_known : float
        Smallest known fraction under the blur for a known pixel, and of a layer that is compared.
    flat_percentile : float
        Percentile of the absolute gradient that is due to noise.
    edge_percentile : float
        Percentile of the absolute gradient at which the contrast saturates.
    edge_sigmas : float
        Smallest such gradient, in standard deviations of the noise.
    active : float
        Smallest saturated gradient of an edge.
    active_px : int, px
        Distance from edges, relative to the shorter side, within which pixels are compared.
    least_active_px : int, px
        Smallest such distance.
    searched_deg : float, deg
        Largest rotation that is searched.
    limit_deg : float, deg
        Largest rotation of dies against the stage axes; beyond it rows and columns are confused.
    projection_px : float, px
        Standard deviation of the blur of a projection; it makes the sampling at all angles alike.
    """

    blur_px: float = 1.0
    least_known: float = 0.3
    flat_percentile: float = 30
    edge_percentile: float = 97
    edge_sigmas: float = 3.0
    active: float = 0.25
    active_px: float = 0.04
    least_active_px: int = 8
    searched_deg: float = 15.0
    limit_deg: float = 5.0
    projection_px: float = 2.0


GRADIENTS = GradientParameters()
MEND = "give pitch, origin and size of the dies instead"
FLAT_PERCENTILE_SIGMAS = 0.385
"""The 30th percentile of the absolute value of a normal variable, in standard deviations."""


@dataclass(frozen=True, slots=True, eq=False)
class Gradients:
    """Saturated gradients of one layer to the right and downwards, its known pixels, and the variance of noise."""

    right: Float32s
    down: Float32s
    known: Bools
    noise: float

    @property
    def transposed(self) -> Gradients:
        """The same with rows and columns exchanged."""
        return Gradients(self.down.T, self.right.T, self.known.T, self.noise)

    def every(self, step: int) -> Gradients:
        """Return every n-th pixel along both axes."""
        some = slice(None, None, step), slice(None, None, step)
        return Gradients(self.right[some], self.down[some], self.known[some], self.noise)


def gradients_of(layers: Sequence[Float32s]) -> list[Gradients]:
    """Return the gradients of the layers that show any contrast. Raises DiesNotFound where none does."""
    found = [one for layer in layers if (one := gradients(layer)) is not None]
    if not found:
        raise DiesNotFound(f"The surface shows no contrast that dies could be found by: {MEND}.")
    return found


def gradients(layer: Float32s) -> Gradients | None:
    """Return the saturated gradients of a layer; None where hardly anything is known or nothing has contrast."""
    soft = _blurred(layer)
    right, down = np.full(soft.shape, np.nan, np.float32), np.full(soft.shape, np.nan, np.float32)
    right[:, 1:-1], down[1:-1] = (soft[:, 2:] - soft[:, :-2]) / 2, (soft[2:] - soft[:-2]) / 2
    known = np.isfinite(right) & np.isfinite(down)
    if known.mean() < GRADIENTS.least_known / 6:
        return None
    size = np.abs(np.concatenate([right[known][::3], down[known][::3]]))
    flat, edge = np.percentile(size, [GRADIENTS.flat_percentile, GRADIENTS.edge_percentile]).tolist()
    sigma = flat / FLAT_PERCENTILE_SIGMAS
    strong = max(edge, GRADIENTS.edge_sigmas * sigma)
    if strong == 0:
        return None
    return Gradients(_saturated(right, known, strong), _saturated(down, known, strong), known, (sigma / strong) ** 2)


def _blurred(layer: Float32s) -> Float32s:
    from scipy.ndimage import gaussian_filter

    known = np.isfinite(layer)
    middle = np.float32(np.median(layer[known])) if known.any() else np.float32(0)
    share: Any = gaussian_filter(known.astype(np.float32), GRADIENTS.blur_px)
    total: Any = gaussian_filter(np.where(known, layer - middle, np.float32(0)), GRADIENTS.blur_px)
    enough = share > GRADIENTS.least_known
    return np.divide(total, share, out=np.full(layer.shape, np.nan, np.float32), where=enough)


def _saturated(gradient: Float32s, known: Bools, strong: float) -> Float32s:
    relative = np.where(known, gradient, np.float32(0)) / np.float32(strong)
    return (relative / np.sqrt(1 + relative**2)).astype(np.float32)


def active_pixels(seen: Sequence[Gradients]) -> Bools:
    """Return the pixels near edges: beyond a rim and on missing dies there is nothing to compare."""
    from scipy.ndimage import maximum_filter, uniform_filter

    edges = np.zeros(seen[0].right.shape, bool)
    for one in seen:
        noise = 16 * one.noise
        edges |= np.hypot(one.right, one.down) > max(GRADIENTS.active, math.sqrt(noise / (1 + noise)))
    dense = np.asarray(uniform_filter(edges.astype(np.float32), 5)) > 0.25
    reach = max(GRADIENTS.least_active_px, round(GRADIENTS.active_px * min(dense.shape)))
    return np.asarray(maximum_filter(dense, 2 * reach + 1), bool)


# ------------------------------------------------------------------------------------------------------------- rotation


def rotation_of(seen: Sequence[Gradients]) -> float:
    """Return the rotation in degrees at which edges along both axes project to the sharpest lines."""
    angle = max(np.arange(-GRADIENTS.searched_deg, GRADIENTS.searched_deg + 0.1, 0.5), key=_sharpness(seen, 4))
    for step, every in ((0.2, 2), (0.05, 2), (0.02, 1)):
        angles = angle + step * np.arange(-3, 4)
        sharp = list(map(_sharpness(seen, every), angles))
        top = int(np.argmax(sharp))
        angle = float(angles[top])
        if 0 < top < len(angles) - 1:
            angle += step * vertex(*sharp[top - 1 : top + 2])
    return float(angle)


def _sharpness(seen: Sequence[Gradients], every: int) -> Any:
    some = [one.every(every) for one in seen]
    planes = [(one.right, 1.0) for one in some] + [(one.down.T, -1.0) for one in some]
    blur_px = GRADIENTS.projection_px / math.sqrt(every)

    def sharpness(angle_deg: float) -> float:
        slope = math.tan(math.radians(angle_deg))
        return sum(_projected(plane, sign * slope, blur_px) for plane, sign in planes)

    return sharpness


def _projected(plane: Float32s, slope: float, blur_px: float) -> float:
    """Return the mean square of the projection of a plane along lines inclined to its columns."""
    from scipy.ndimage import gaussian_filter1d

    rows, cols = plane.shape
    at = np.arange(cols)[None, :] - ((np.arange(rows) - rows / 2) * slope)[:, None] + rows
    low = np.floor(at).astype(np.int32)
    part, index, values, n = (at - low).ravel(), low.ravel(), plane.ravel(), cols + 2 * rows + 2
    total = np.bincount(index, values * (1 - part), n) + np.bincount(index + 1, values * part, n)
    lines = np.maximum(np.bincount(index, minlength=n), rows / 8)
    return float(np.sum(np.asarray(gaussian_filter1d(total, blur_px)) ** 2 / lines))


def turned(layer: Float32s, angle_rad: float) -> Float32s:
    """Return a layer in the axes of dies that are rotated anticlockwise, about its centre; NaN beyond its border."""
    from scipy.ndimage import map_coordinates

    (rows, cols), c, s = layer.shape, math.cos(angle_rad), math.sin(angle_rad)
    height, width = math.ceil(rows * c + cols * abs(s)), math.ceil(cols * c + rows * abs(s))
    down, right = np.meshgrid(np.arange(height) - (height - 1) / 2, np.arange(width) - (width - 1) / 2, indexing="ij")
    places = [(rows - 1) / 2 - s * right + c * down, (cols - 1) / 2 + c * right + s * down]
    values: Any = map_coordinates(layer, places, order=1, mode="constant", cval=np.nan)
    return np.asarray(values, np.float32)


def turned_too_far(angle_deg: float) -> DiesNotFound:
    """Return the error for a wafer that is rotated too far."""
    return DiesNotFound(
        f"The dies are turned by {angle_deg:.1f} degrees and at most {GRADIENTS.limit_deg:g} can be found: turn the "
        f"wafer, or {MEND}."
    )


def vertex(before: float, middle: float, after: float) -> float:
    """Return the vertex of a parabola through three values, relative to the middle one."""
    bend = before - 2 * middle + after
    return float(np.clip((before - after) / (2 * bend), -0.5, 0.5)) if bend < 0 else 0.0
