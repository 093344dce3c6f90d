"""Flat field of the camera: relative sensitivity and dark level over the image, as means over blocks."""

from __future__ import annotations

import dataclasses
import hashlib
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.errors import RigError, WaferViewerError
from wafer_viewer.model.spec import Count, Spec, encode

Blocks = tuple[tuple[float, ...], ...]
"""Values over blocks of the image, [row][col]."""


@dataclass(frozen=True, slots=True, eq=False)
class ImageShading:
    """Shading of every pixel, float32 [row, col]: sensitivity, 1 on average, and dark level in counts."""

    sensitivity: NDArray[np.float32]
    dark_counts: NDArray[np.float32]

    def part(self, rows: slice, cols: slice) -> ImageShading:
        """Return the pixels [rows, cols]."""
        return dataclasses.replace(
            self, sensitivity=self.sensitivity[rows, cols], dark_counts=self.dark_counts[rows, cols]
        )


class FlatField(Spec, frozen=True, kw_only=True):
    """Relative sensitivity and dark level over blocks of the image, with standard uncertainties (k = 1).

    Parameters
    ----------
    rows, cols : pixels of the image that the blocks divide evenly.
    sensitivity : counts above dark over their mean, [row][col] of the blocks.
    u_sensitivity : its standard uncertainty.
    dark_counts : counts without light.
    u_dark_counts : its standard uncertainty.
    """

    error: ClassVar[type[WaferViewerError]] = RigError
    rows: Count
    cols: Count
    sensitivity: Blocks
    u_sensitivity: Blocks
    dark_counts: Blocks
    u_dark_counts: Blocks

    def __post_init__(self) -> None:
        super().__post_init__()
        shapes = {
            (len(blocks), *{len(row) for row in blocks})
            for blocks in (self.sensitivity, self.u_sensitivity, self.dark_counts, self.u_dark_counts)
        }
        if len(shapes) != 1 or len(next(iter(shapes))) != 2 or 0 in next(iter(shapes)):
            self.refuse("sensitivity", "a table with as many rows and columns as those of the uncertainties and dark")
        if not min(value for row in self.sensitivity for value in row) > 0:
            self.refuse("sensitivity", "over 0 everywhere")

    @property
    def digest(self) -> str:
        """SHA-256 of the content, which a calibration names."""
        return hashlib.sha256(encode(self, "json").encode()).hexdigest()

    def shading(self) -> ImageShading:
        """Return the shading of every pixel, linear between the centres of the blocks and beyond the outer ones."""
        sensitivity, dark_counts = (np.asarray(blocks, np.float64) for blocks in (self.sensitivity, self.dark_counts))
        down, right = (_linear(n, of) for n, of in zip((self.rows, self.cols), sensitivity.shape, strict=True))
        return ImageShading(*((down @ blocks @ right.T).astype(np.float32) for blocks in (sensitivity, dark_counts)))


def _linear(n_pixels: int, n_blocks: int) -> NDArray[np.float64]:
    """Return the weights [pixel, block] of a linear interpolation between the centres of equal blocks."""
    if n_blocks == 1:
        return np.ones((n_pixels, 1))
    at = (np.arange(n_pixels) + 0.5) * n_blocks / n_pixels - 0.5
    lower = np.clip(np.floor(at).astype(int), 0, n_blocks - 2)
    out = np.zeros((n_pixels, n_blocks))
    pixel = np.arange(n_pixels)
    out[pixel, lower], out[pixel, lower + 1] = 1 - (at - lower), at - lower
    return out
