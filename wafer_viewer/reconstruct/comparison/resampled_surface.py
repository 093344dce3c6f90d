"""Second of two surfaces resampled to the lattice of the first, window by window, or shown side by side."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.comparison import Registration
from wafer_viewer.model.surface.height_map import AsArray, HeightMap, Mosaic, Origin, Outline, Provenance, pixel_window

if TYPE_CHECKING:
    from wafer_viewer.numerics.grids.resampling import ResampledLayers


Affine = NDArray[np.float64]
"""[2, 3]: the images of (1, a, b)."""
_MARGIN_PX = 2
"""Margin around the part of the second that is read, in pixels of its level."""
_FINER = 1.42
"""The pixels of the level read may be larger than those requested by this factor: half an octave."""


@dataclass(frozen=True, slots=True)
class SampleGrid:
    """Positions of sampled pixels, as a standalone `Outline`."""

    pixel_um: float
    x0_um: float
    y0_um: float
    shape: tuple[int, int]

    @classmethod
    def of(cls, surface: Outline, region: Region | None, level: int) -> SampleGrid:
        """Return the part of a level of a surface that holds a region, or the entire level without one."""
        scale = 2**level
        rows, cols = (slice(0, -(-n // scale)) for n in surface.shape)
        if region is not None:
            rows, cols = pixel_window(surface, region, level)  # pyright: ignore[reportArgumentType]
        pixel, shift = surface.pixel_um * scale, (scale - 1) / 2 * surface.pixel_um
        x0, y0 = surface.x0_um + shift + cols.start * pixel, surface.y0_um - shift - rows.start * pixel
        return cls(pixel, x0, y0, (rows.stop - rows.start, cols.stop - cols.start))

    @property
    def bounds_um(self) -> tuple[float, float, float, float]:
        """(x low, y low, x high, y high) of the pixel centres."""
        rows, cols = self.shape
        return self.x0_um, self.y0_um - (rows - 1) * self.pixel_um, self.x0_um + (cols - 1) * self.pixel_um, self.y0_um

    @property
    def region(self) -> Region:
        """Rectangle through its outermost pixels."""
        return Region.rectangle(*self.bounds_um)


@dataclass(frozen=True, eq=False)
class ResampledMosaic(AsArray):
    """A `Mosaic`: `second` transformed by a registration, on the lattice of `first`.

    Heights are transformed by the registration as well. A window needs twice its own memory.
    """

    first: Mosaic
    second: Mosaic
    registration: Registration

    @property
    def pixel_um(self) -> float:
        """Pixel size of level 0."""
        return self.first.pixel_um

    @property
    def x0_um(self) -> float:
        """Stage x of pixel (0, 0) of level 0."""
        return self.first.x0_um

    @property
    def y0_um(self) -> float:
        """Stage y of pixel (0, 0) of level 0."""
        return self.first.y0_um

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols) of level 0."""
        return self.first.shape

    @property
    def levels(self) -> int:
        """Number of levels available in both."""
        finer = math.log2(self.first.pixel_um / self.second.pixel_um)
        return max(1, min(self.first.levels, self.second.levels - math.ceil(finer - 0.5)))

    @property
    def provenance(self) -> Provenance:
        """Provenance of the second surface, whose heights were moved from their places between frames."""
        return replace(self.second.provenance, even_step_um=0.0)

    def window(self, region: Region | None = None, level: int = 0) -> HeightMap:
        """Return the part of a level of the first's lattice that holds a region.

        Raises MeasureError when the region is outside.
        """
        return self.on(SampleGrid.of(self.first, region, level))

    def on(self, lattice: SampleGrid) -> HeightMap:
        """Return the second surface on any lattice in the first's stage coordinates."""
        from wafer_viewer.numerics.grids.resampling import resample_affine

        part = self._beneath(lattice)
        grey = np.uint8 if part is None else part.all_in_focus.dtype
        out = _not_covered(lattice.shape, grey)
        if part is not None:
            resample_affine(_layers_of(part), self._motion(lattice, part), out)
            self._move_heights(out.z, lattice)
            self._move_heights(out.raw, lattice)
        return HeightMap(
            out.z, out.raw, out.confidence, out.grey, out.origin,
            lattice.pixel_um, lattice.x0_um, lattice.y0_um, self.provenance,
        )  # fmt: skip

    def to_second(self, x_um: NDArray[np.float64], y_um: NDArray[np.float64]) -> tuple[Affine, Affine]:
        """Transform positions on the first surface to the second."""
        r = self.registration
        cos, sin = self._turn
        dx, dy = x_um - r.about_x_um - r.x_um, y_um - r.about_y_um - r.y_um
        return r.about_x_um + cos * dx + sin * dy, r.about_y_um - sin * dx + cos * dy

    @cached_property
    def _turn(self) -> tuple[float, float]:
        turn = self.registration.turn_mrad * 1e-3
        return math.cos(turn), math.sin(turn)

    def _beneath(self, lattice: SampleGrid) -> HeightMap | None:
        """Return the part of the second under a lattice, at the level of similar pixel size; None if there is none."""
        xa, ya, xb, yb = lattice.bounds_um
        x, y = self.to_second(np.array([xa, xa, xb, xb]), np.array([ya, yb, ya, yb]))
        finest = math.log2(max(1.0, _FINER * lattice.pixel_um / self.second.pixel_um))
        level = min(int(finest), self.second.levels - 1)
        spare = _MARGIN_PX * self.second.pixel_um * 2**level
        region = Region.rectangle(x.min() - spare, y.min() - spare, x.max() + spare, y.max() + spare)
        try:
            return self.second.window(region, level)
        except MeasureError:
            return None

    def _motion(self, lattice: SampleGrid, part: HeightMap) -> Affine:
        """Return (row, col) of the part as an affine function of those of the lattice."""
        cols, rows = np.array([0.0, 0.0, 1.0]), np.array([0.0, 1.0, 0.0])
        x, y = self.to_second(lattice.x0_um + cols * lattice.pixel_um, lattice.y0_um - rows * lattice.pixel_um)
        row, col = (part.y0_um - y) / part.pixel_um, (x - part.x0_um) / part.pixel_um
        return np.array([[v[0], v[1] - v[0], v[2] - v[0]] for v in (row, col)])

    def _move_heights(self, z_um: NDArray[np.float32], lattice: SampleGrid) -> None:
        r = self.registration
        if not (r.z_um or r.tilt_x_mrad or r.tilt_y_mrad):
            return
        x = lattice.x0_um + np.arange(lattice.shape[1]) * lattice.pixel_um - r.about_x_um
        y = lattice.y0_um - np.arange(lattice.shape[0]) * lattice.pixel_um - r.about_y_um
        z_um += (r.z_um + r.tilt_x_mrad * 1e-3 * x).astype(np.float32)[None, :]
        z_um += (r.tilt_y_mrad * 1e-3 * y).astype(np.float32)[:, None]


def _layers_of(part: HeightMap) -> ResampledLayers:
    from wafer_viewer.numerics.grids.resampling import ResampledLayers

    layers: tuple[Any, ...] = part.z_um, part.z_raw_um, part.confidence, part.all_in_focus, part.origin
    return ResampledLayers(*(np.ascontiguousarray(layer) for layer in layers))


def _not_covered(shape: tuple[int, int], grey: Any) -> ResampledLayers:
    from wafer_viewer.numerics.grids.resampling import ResampledLayers

    return ResampledLayers(
        np.full(shape, np.nan, np.float32),
        np.full(shape, np.nan, np.float32),
        np.zeros(shape, np.float32),
        np.zeros(shape, grey),
        np.full(shape, Origin.NOT_COVERED, np.uint8),
    )


GAP = 0.06
"""Gap between the surfaces, as a fraction of the width of one."""


class OnResampled:
    """Place of a `Mosaic` on the lattice of a resampled one."""

    resampled: ResampledMosaic

    @property
    def pixel_um(self) -> float:
        """Pixel size of level 0."""
        return self.resampled.pixel_um

    @property
    def x0_um(self) -> float:
        """Stage x of pixel (0, 0) of level 0, of the first."""
        return self.resampled.x0_um

    @property
    def y0_um(self) -> float:
        """Stage y of pixel (0, 0) of level 0."""
        return self.resampled.y0_um


@dataclass(frozen=True, eq=False)
class SideBySideMosaic(OnResampled):
    """A `Mosaic` of the first surface and the one aligned to it, which is `offset` columns further right."""

    resampled: ResampledMosaic

    @property
    def offset(self) -> int:
        """Columns of level 0 between a position on the first and on the second; a multiple of every level's pixel."""
        multiple = 2 ** (self.levels - 1)
        return -(-round((1 + GAP) * self.resampled.shape[1]) // multiple) * multiple

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols) of level 0."""
        return self.resampled.shape[0], self.offset + self.resampled.shape[1]

    @property
    def levels(self) -> int:
        """Number of levels available in both."""
        return self.resampled.levels

    @property
    def provenance(self) -> Provenance:
        """Provenance of the first surface."""
        return self.resampled.first.provenance

    def window(self, region: Region | None = None, level: int = 0) -> HeightMap:
        """Return the part of a level that holds a region, which may span both surfaces."""
        lattice = SampleGrid.of(self, region, level)
        parts = [self._part(k, lattice, level) for k in (0, 1)]
        given = [part for part in parts if part is not None]
        grey = given[0].all_in_focus.dtype if given else np.dtype(np.uint8)
        layers: dict[str, Any] = {
            "z_um": np.full(lattice.shape, np.nan, np.float32),
            "z_raw_um": np.full(lattice.shape, np.nan, np.float32),
            "confidence": np.zeros(lattice.shape, np.float32),
            "all_in_focus": np.zeros(lattice.shape, grey),
            "origin": np.full(lattice.shape, Origin.NOT_COVERED, np.uint8),
        }
        for k, part in enumerate(parts):
            if part is not None:
                _paste(layers, part, round((part.x0_um + k * self._off_um - lattice.x0_um) / lattice.pixel_um))
        return HeightMap(
            **layers,
            pixel_um=lattice.pixel_um,
            x0_um=lattice.x0_um,
            y0_um=lattice.y0_um,
            provenance=self.provenance,
        )

    @property
    def _off_um(self) -> float:
        return self.offset * self.pixel_um

    def _part(self, k: int, lattice: SampleGrid, level: int) -> HeightMap | None:
        """Return the part of the first (0) or second (1) surface in a window; None if there is none."""
        xa, ya, xb, yb = lattice.bounds_um
        off = k * self._off_um
        try:
            part = (self.resampled.first, self.resampled)[k].window(Region.rectangle(xa - off, ya, xb - off, yb), level)
        except MeasureError:
            return None
        return part


def _paste(layers: dict[str, Any], part: HeightMap, col: int) -> None:
    """Copy a part to its columns of a window of equal height, with its image converted to the window's depth."""
    left, right = max(col, 0), min(col + part.shape[1], layers["z_um"].shape[1])
    for name, layer in layers.items():
        values = getattr(part, name)[: layer.shape[0], left - col : right - col]
        shift = 8 * (values.dtype.itemsize - layer.dtype.itemsize) if name == "all_in_focus" else 0
        layer[: values.shape[0], left:right] = values >> shift if shift > 0 else values
