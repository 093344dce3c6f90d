"""Half the resolution of a height map, again and again, without inventing heights and without losing defects.

A mean over 2 x 2 pixels leaves out what is unmeasured; the least and the greatest height are kept beside it, so that a
defect of a few pixels is not averaged away on the way up.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.surface import HeightMap, Origin

_LAYERS = ("z_um", "z_raw_um", "confidence", "all_in_focus", "origin")


@dataclass(frozen=True, slots=True, eq=False)
class Tier:
    """One level of a pyramid: the map, and the extremes of the level 0 pixels below each of its pixels."""

    height: HeightMap
    z_min_um: NDArray[np.float32]
    z_max_um: NDArray[np.float32]

    @classmethod
    def base(cls, height: HeightMap) -> Tier:
        """Level 0: a pixel is its own least and greatest height."""
        return cls(height, height.z_um, height.z_um)

    def halve(self) -> Tier:
        """The next level up."""
        with np.errstate(invalid="ignore"):
            return Tier(
                halved(self.height),
                np.fmin.reduce(_quarters(self.z_min_um, np.nan)),
                np.fmax.reduce(_quarters(self.z_max_um, np.nan)),
            )


def halved(height: HeightMap) -> HeightMap:
    """The means over 2 x 2 pixels of what is measured; the best origin of the four. An odd last line stands alone."""
    grey, covered = height.all_in_focus, height.origin != Origin.NOT_COVERED
    return dataclasses.replace(
        height,
        z_um=_mean(height.z_um),
        z_raw_um=_mean(height.z_raw_um),
        confidence=_mean(height.confidence),
        all_in_focus=np.nan_to_num(np.rint(_mean(np.where(covered, grey, np.float32(np.nan))))).astype(grey.dtype),
        origin=np.minimum.reduce(_quarters(height.origin, 255)),
        pixel_um=2 * height.pixel_um,
        x0_um=height.x0_um + 0.5 * height.pixel_um,
        y0_um=height.y0_um - 0.5 * height.pixel_um,
    )


def joined(bands: Sequence[HeightMap]) -> HeightMap:
    """Maps that lie below one another as one, at the position of the first."""
    if len(bands) == 1:
        return bands[0]
    layers = {name: np.concatenate([getattr(b, name) for b in bands]) for name in _LAYERS}
    return dataclasses.replace(bands[0], **layers)


def _quarters(values: NDArray[Any], beyond: float) -> list[NDArray[Any]]:
    """The four pixels below each pixel of the next level; `beyond` stands in past an odd border."""
    rows, cols = values.shape
    even = np.pad(values, ((0, rows % 2), (0, cols % 2)), constant_values=beyond) if rows % 2 or cols % 2 else values
    return [even[r::2, c::2] for r in (0, 1) for c in (0, 1)]


def _mean(values: NDArray[np.float32]) -> NDArray[np.float32]:
    quarters = _quarters(values, np.nan)
    total, count = np.zeros(quarters[0].shape, np.float32), np.zeros(quarters[0].shape, np.float32)
    for quarter in quarters:
        measured = np.isfinite(quarter)
        total += np.where(measured, quarter, np.float32(0))
        count += measured
    return np.divide(total, count, out=np.full(total.shape, np.nan, np.float32), where=count > 0)
