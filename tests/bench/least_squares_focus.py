"""Plain depth from focus by weighted least squares: a peer for relief without walls, written from the textbook.

The modified Laplacian of the blurred image, averaged over a window (Nayar and Nakagawa 1994), and for each pixel the
Gaussian that fits the focus of the frames about the sharpest one: a parabola through the logarithms by least squares,
each weighted by the focus raised to a power, as the noise of a logarithm asks for. Every pixel has a height; nothing is
gated. The settings have the least error of those tried on tests/truth/relief.py, seeds 0 to 28: blur 0, 1, 1.5 px,
window 5 to 17 px, power 1, 2, 4, share .3, .5, .7, smoothing 0 to 3 px; absolute derivatives and squared ones.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, uniform_filter

from wafer_viewer.model.acquisition.focus_stack import FieldStack

Floats = NDArray[np.float64]
FLOOR_PERCENTILE = 20
"""Percentile of the focus of a pixel over the frames that counts as its floor."""


@dataclass(frozen=True)
class LeastSquares:
    """window: of the focus measure, px; share: of the peak, down to which frames are fitted; power: of the focus in the
    weights; smoothing_px: sigma of a Gaussian over the heights; blur_px: sigma of a Gaussian over each image.
    """

    window: int = 9
    blur_px: float = 1.0
    share: float = 0.3
    power: float = 2.0
    smoothing_px: float = 0.0

    def heights_um(self, stack: FieldStack) -> Floats:
        """Heights of a stack with even steps, [row, col]."""
        z_um = np.asarray(stack.z_um, np.float64)
        height_um = z_um[0] + (z_um[1] - z_um[0]) * self.frames(
            modified_laplacian(stack.images, self.window, self.blur_px)
        )
        return gaussian_filter(height_um, self.smoothing_px) if self.smoothing_px else height_um

    def frames(self, focus: Floats) -> Floats:
        """The frame of each peak, with its fraction, from the focus [k, row, col]."""
        over_floor = focus - np.percentile(focus, FLOOR_PERCENTILE, axis=0)
        top = over_floor.max(axis=0)
        relative = np.clip(over_floor / top, 1e-3, None)
        best = relative.argmax(axis=0)
        u = np.arange(len(focus), dtype=np.float64)[:, None, None] - best
        weight = np.where(_about_the_peak(relative > self.share, u), relative**self.power, 0)
        return best + np.clip(_vertex(u, np.log(relative), weight), -1, 1)


PLAIN, SMOOTHED = LeastSquares(), LeastSquares(window=7, smoothing_px=2.0)


def modified_laplacian(images: NDArray, window: int, blur_px: float) -> Floats:
    """Mean of |second derivative along rows| + |along columns| of the blurred images over a window, [k, row, col]."""
    found = np.empty(images.shape)
    for k, image in enumerate(images):
        grey = np.pad(gaussian_filter(image.astype(np.float64), blur_px), 1, mode="edge")
        middle = 2 * grey[1:-1, 1:-1]
        along = np.abs(middle - grey[1:-1, :-2] - grey[1:-1, 2:])
        down = np.abs(middle - grey[:-2, 1:-1] - grey[2:, 1:-1])
        found[k] = uniform_filter(along + down, window)
    return found


def _about_the_peak(high: NDArray[np.bool_], u: Floats) -> NDArray[np.bool_]:
    """The run of high frames about the peak, and at least one frame on each side of it."""
    n = len(high)
    above = np.where(~high & (u > 0), u, n).min(axis=0)
    below = np.where(~high & (u < 0), u, -n).max(axis=0)
    return (u > np.minimum(below, -2)) & (u < np.maximum(above, 2))


def _vertex(u: Floats, value: Floats, weight: Floats) -> Floats:
    """The vertex of the weighted parabola through values over u; 0 where it does not open downwards."""
    s = [(weight * u**n).sum(axis=0) for n in range(5)]
    t = [(weight * value * u**n).sum(axis=0) for n in range(3)]
    a, b, c = s[2] * s[4] - s[3] ** 2, s[1] * s[4] - s[2] * s[3], s[1] * s[3] - s[2] ** 2
    bend = c * t[0] + (s[1] * s[2] - s[0] * s[3]) * t[1] + (s[0] * s[2] - s[1] ** 2) * t[2]
    slope = -b * t[0] + (s[0] * s[4] - s[2] ** 2) * t[1] + (s[1] * s[2] - s[0] * s[3]) * t[2]
    opens = (bend < 0) & (s[0] * a - s[1] * b + s[2] * c > 0)
    return np.where(opens, -slope / (2 * np.where(opens, bend, -1)), 0)
