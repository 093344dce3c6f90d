"""Comparison of two surfaces: the second is aligned to the first by images and relief or stage, and subtracted."""

from __future__ import annotations

import dataclasses
import hashlib
import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from wafer_viewer._version import __version__
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.comparison import ALIGN_TITLES, FOUND_BY, Align, Change, Heights, Registration
from wafer_viewer.model.surface.field_poses import DOUBT_TITLES, RejectionReason
from wafer_viewer.model.surface.height_map import (
    UNMEASURED_FROM,
    AsArray,
    HeightMap,
    Mosaic,
    Origin,
    Outline,
    Provenance,
    ReadThrough,
    pixel_window,
)
from wafer_viewer.numerics.normal_statistics import MAD_TO_SIGMA
from wafer_viewer.reconstruct.blending.stitched_mosaic import coarser_levels
from wafer_viewer.reconstruct.comparison.registration import in_plane, levelled, settled
from wafer_viewer.reconstruct.comparison.resampled_surface import OnResampled, ResampledMosaic, SampleGrid

# ---------------------------------------------------------------------------------------------------- height difference


CHANGED_SIGMAS = 3.0
"""Limit of unchanged heights, in standard deviations of the differences."""
_LEAST_LIMIT_UM = 1e-4
"""Smallest limit of unchanged heights."""
_LOOKS, _LOOK_PX = 6, 192
"""Samples per side of the grid on which the noise is estimated, and their width in pixels."""
_BAND_PX = 2**22
"""Approximate number of pixels per band in sums over the entire difference."""


@dataclass(frozen=True, slots=True)
class DifferenceStatistics:
    """Sums from which statistics are computed, for one window or accumulated over many."""

    n: int = 0
    total: float = 0.0
    squares: float = 0.0
    lowest: float = math.inf
    highest: float = -math.inf
    changed: int = 0
    gained: float = 0.0
    lost: float = 0.0

    def __add__(self, other: DifferenceStatistics) -> DifferenceStatistics:
        return DifferenceStatistics(
            self.n + other.n, self.total + other.total, self.squares + other.squares,
            min(self.lowest, other.lowest), max(self.highest, other.highest),
            self.changed + other.changed, self.gained + other.gained, self.lost + other.lost,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Difference(OnResampled, AsArray):
    """A `Mosaic` of one level on the first's lattice: `resampled` over `resampled.first`, minus it.

    Unmeasured where either surface is, with the first's origin code if it has one. median_um, limit_um: see `Change`.
    """

    resampled: ResampledMosaic
    median_um: float
    limit_um: float
    provenance: Provenance

    @property
    def registration(self) -> Registration:
        """Registration of the second surface to the first."""
        return self.resampled.registration

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols)."""
        return self.resampled.shape

    @property
    def levels(self) -> int:
        """Number of levels: one."""
        return 1

    def window(self, region: Region | None = None, level: int = 0) -> HeightMap:
        """Return the part that holds a region, or all of it without one. Raises MeasureError when it is outside."""
        if level:
            raise MeasureError(f"A difference has one level until it is written, level {level} was asked for.")
        return dataclasses.replace(subtracted(self.resampled, region), provenance=self.provenance)

    def sums(self, part: HeightMap) -> DifferenceStatistics:
        """Return the statistics sums of a window."""
        off = part.z_raw_um[np.isfinite(part.z_raw_um)].astype(np.float64)
        if not off.size:
            return DifferenceStatistics()
        about = off - self.median_um
        changed = about[np.abs(about) > self.limit_um]
        return DifferenceStatistics(
            off.size, float(off.sum()), float((off**2).sum()), float(off.min()), float(off.max()),
            changed.size, float(changed[changed > 0].sum()), float(-changed[changed < 0].sum()),
        )  # fmt: skip

    def change(self, sums: DifferenceStatistics | None = None) -> Change:
        """Return the change statistics, from given sums or by summing over all windows."""
        total = sums or sum((self.sums(part) for part in self._bands()), DifferenceStatistics())
        if not total.n:
            raise MeasureError("No place is measured in both surfaces: take surfaces of the same part of the sample.")
        mean = total.total / total.n
        return Change(
            n_points=total.n,
            mean_um=mean,
            median_um=self.median_um,
            sq_um=math.sqrt(max(0.0, total.squares / total.n - mean**2)),
            lowest_um=total.lowest,
            highest_um=total.highest,
            limit_um=self.limit_um,
            changed_fraction=total.changed / total.n,
            gained_um3=total.gained * self.pixel_um**2,
            lost_um3=total.lost * self.pixel_um**2,
        )

    def _bands(self) -> Iterator[HeightMap]:
        rows, cols = self.shape
        step = max(1, _BAND_PX // cols)
        x1 = self.x0_um + (cols - 1) * self.pixel_um
        for top in range(0, rows, step):
            ends = (self.y0_um - row * self.pixel_um for row in (top, min(top + step, rows) - 1))
            yield self.window(Region.rectangle(self.x0_um, next(ends), x1, next(ends)))


def subtracted(resampled: ResampledMosaic, region: Region | None) -> HeightMap:
    """Return second minus first in a window of the first's lattice."""
    one = resampled.first.window(region)
    other = resampled.on(SampleGrid(one.pixel_um, one.x0_um, one.y0_um, one.shape))
    return HeightMap(
        z_um=other.z_um - one.z_um,
        z_raw_um=other.z_raw_um - one.z_raw_um,
        confidence=np.minimum(one.confidence, other.confidence),
        all_in_focus=other.all_in_focus,
        origin=np.where(one.origin >= UNMEASURED_FROM, one.origin, np.maximum(one.origin, other.origin)),
        pixel_um=one.pixel_um,
        x0_um=one.x0_um,
        y0_um=one.y0_um,
    )


def noise_of(resampled: ResampledMosaic, region: Region) -> tuple[float, float]:
    """Return (median, limit of unchanged heights) of the differences, from samples over a region, in um.

    Raises
    ------
    MeasureError
        When no sampled pixel is measured in both.
    """
    found = [off for block in _noise_blocks(resampled, region) if (off := _differences(resampled, block)).size]
    if not found:
        raise MeasureError("No place is measured in both surfaces: take surfaces of the same part of the sample.")
    off = np.concatenate(found)
    median = float(np.median(off))
    return median, max(_LEAST_LIMIT_UM, CHANGED_SIGMAS * MAD_TO_SIGMA * float(np.median(np.abs(off - median))))


def _noise_blocks(resampled: ResampledMosaic, region: Region) -> Iterator[Region]:
    xa, ya, xb, yb = region.bounds_um
    half = _LOOK_PX / 2 * resampled.pixel_um
    for x in np.unique(np.linspace(min(xa + half, xb), max(xb - half, xa), _LOOKS)):
        for y in np.unique(np.linspace(min(ya + half, yb), max(yb - half, ya), _LOOKS)):
            yield Region.rectangle(float(x) - half, float(y) - half, float(x) + half, float(y) + half)


def _differences(resampled: ResampledMosaic, block: Region) -> NDArray[np.float32]:
    try:
        off = subtracted(resampled, block).z_raw_um
    except MeasureError:
        return np.empty(0, np.float32)
    return off[np.isfinite(off)]


def provenance_of(first: Provenance, second: Provenance, notes: tuple[str, ...]) -> Provenance:
    """Combine provenances: the first's recipe; simulated if either is, calibrated if both are alike."""
    joint = hashlib.sha256(f"{first.input_checksum} {second.input_checksum}".encode()).hexdigest()
    return replace(
        first,
        calibration=first.calibration if first.calibration == second.calibration else None,
        software_version=__version__,
        input_checksum=joint,
        simulated=first.simulated or second.simulated,
        even_step_um=0.0,
        notes=notes,
    )


_COARSEST_PX = 256
"""Approximate longer side of the coarsest level, in pixels."""


@dataclass(frozen=True, eq=False)
class Reduced:
    """A `Mosaic` over a map in memory."""

    full: HeightMap

    @property
    def pixel_um(self) -> float:
        """Pixel size of level 0."""
        return self.full.pixel_um

    @property
    def x0_um(self) -> float:
        """Stage x of pixel (0, 0) of level 0."""
        return self.full.x0_um

    @property
    def y0_um(self) -> float:
        """Stage y of pixel (0, 0) of level 0."""
        return self.full.y0_um

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols) of level 0."""
        return self.full.shape

    @property
    def levels(self) -> int:
        """Number of levels until the longer side is about 256 pixels."""
        return 1 + max(0, math.ceil(math.log2(max(self.shape) / _COARSEST_PX)))

    @property
    def provenance(self) -> Provenance:
        """Provenance of the map."""
        return self.full.provenance

    def window(self, region: Region | None = None, level: int = 0) -> HeightMap:
        """Return the part of a level that holds a region. Raises MeasureError if either does not exist."""
        if not 0 <= level < self.levels:
            raise MeasureError(f"The surface has levels 0 to {self.levels - 1}, level {level} was asked for.")
        if region is None:
            return self._at(level)
        return self._at(level).crop(*pixel_window(self, region, level))

    def _at(self, level: int) -> HeightMap:
        if level == 0:
            return self.full
        return self._coarser[level - 1]

    @cached_property
    def _coarser(self) -> list[HeightMap]:
        return list(islice(coarser_levels(self.full), self.levels - 1))


def as_pyramid(surface: Mosaic) -> Mosaic:
    """Return the surface itself, or a pyramid over it if it is a map with one level."""
    return Reduced(surface) if isinstance(surface, HeightMap) else surface


@dataclass(frozen=True, eq=False)
class HeightLayerView(ReadThrough):
    """A `Mosaic` with one height layer, raw or cleaned, in place of both."""

    surface: Mosaic
    heights: Heights

    def window(self, region: Region | None = None, level: int = 0) -> HeightMap:
        """Return the part of a level that holds a region, with one height layer."""
        part = self.surface.window(region, level)
        if self.heights == "cleaned":
            return dataclasses.replace(part, z_raw_um=part.z_um)
        raw = np.isfinite(part.z_raw_um)
        why = np.where(part.origin >= UNMEASURED_FROM, part.origin, np.uint8(Origin.NOT_COVERED))
        origin = np.where(raw, np.uint8(Origin.MEASURED), why).astype(np.uint8)
        return dataclasses.replace(part, z_um=part.z_raw_um, origin=origin)


def read_as(surface: Mosaic, heights: Heights) -> Mosaic:
    """Return a view with one height layer, or the surface itself for "both"."""
    return surface if heights == "both" else HeightLayerView(surface, heights)


# -------------------------------------------------------------------------------------------------------------- compare


LEAST_OVERLAP_PX = 32
"""Smallest overlap of two surfaces along x and along y, in pixels of the first."""
_SEEN_PX = 512
"""Largest longer side of the level on which the overlap fraction is counted, in pixels."""
_MEND = "align by the stage, or take surfaces of the same part of the sample"
_MENDS: dict[RejectionReason, str] = {
    RejectionReason.BLANK: "there is nothing to be seen in both",
    RejectionReason.UNLIKE: "they do not look alike and may be of different samples",
    RejectionReason.AMBIGUOUS: "they fit at several places",
    RejectionReason.END_OF_SEARCH: "they lie further apart than is looked for",
}


def compare(first: Mosaic, second: Mosaic, align: Align = "auto", keep_z: bool = False) -> Difference:
    """Return the second surface minus the first, on the first's lattice.

    The second surface is aligned to the first, resampled and subtracted.

    Parameters
    ----------
    first : Mosaic
        Surface that is subtracted; the difference is on its lattice. A `HeightMap` is a mosaic of one level.
    second : Mosaic
        Surface that is aligned to `first`.
    align : {"auto", "images", "stage", "none"}, default "auto"
        Alignment of the second surface. "images": shift and rotation by the all-in-focus images and the relief, then
        height and tilt. "stage": x and y of the stage, with height and tilt by a robust plane. "none": x and y of the
        stage, with heights unchanged. "auto": no alignment where both surfaces are of the same frames, otherwise
        "images".
    keep_z : bool, default False
        Leave height and tilt unchanged, as against a golden surface.

    Returns
    -------
    Difference
        A `Mosaic` of one level with the differences in um, unmeasured where either surface is. It also holds the
        registration, the median difference and the limit of unchanged heights.

    Raises
    ------
    MeasureError
        When `align` is none of the four values, the surfaces have no part in common (at least 32 pixels of the first
        in x and y) or no pixel that is measured in both, too little is measured in both for a plane fit, or the
        alignment by images is unreliable.
    ComputeError
        When the surfaces are aligned by images, without `keep_z`, and Open3D cannot be loaded.

    Notes
    -----
    To write or display the result, do not cache it: each window is computed on request.

    The images are matched in patches, coarse to fine; where they cannot be matched, the relief is matched in the same
    way. Unless `keep_z` is set, point-to-plane ICP [1]_ then refines the registration, with Tukey's loss, so that
    changed areas do not count.

    References
    ----------
    .. [1] Y. Chen, G. Medioni, Object modelling by registration of multiple range images, Image Vis. Comput. 10 (1992)
       145.
    """
    if align not in ALIGN_TITLES:
        raise MeasureError(f"align is {align!r}: it must be one of {', '.join(ALIGN_TITLES)}.")
    one = as_pyramid(first)
    other = one if second is first else as_pyramid(second)
    registration = register_surfaces(one, other, align, keep_z)
    resampled = ResampledMosaic(one, other, registration)
    region = _common(one, other, registration)
    median_um, limit_um = noise_of(resampled, region)
    notes = ("Heights are those of the second surface minus the first.", f"Aligned {FOUND_BY[registration.by]}.")
    return Difference(resampled, median_um, limit_um, provenance_of(first.provenance, second.provenance, notes))


def register_surfaces(first: Mosaic, second: Mosaic, align: Align = "auto", keep_z: bool = False) -> Registration:
    """Return the registration that aligns the second surface to the first; see `compare`."""
    identical = align == "auto" and of_same_frames(first, second)
    found = Registration(by="same" if identical else "stage")
    region = _common(first, second, found)
    if align == "images" or (align == "auto" and not identical):
        found = _by_images(first, second, region, keep_z)
    elif align == "stage" and not keep_z:
        found = levelled(first, second, _about(found, region), region)
    return replace(found, overlap_fraction=_overlap_fraction(first, second, found))


def of_same_frames(first: Mosaic, second: Mosaic) -> bool:
    """Return whether two surfaces were made of the same frames and are therefore already aligned."""
    checksum = first.provenance.input_checksum
    return first is second or (checksum != "" and checksum == second.provenance.input_checksum)


def _by_images(first: Mosaic, second: Mosaic, region: Region, keep_z: bool) -> Registration:
    found = in_plane(first, second, region.bounds_um)
    if found.doubt is not RejectionReason.NONE:
        why = _MENDS.get(found.doubt, DOUBT_TITLES[found.doubt])
        raise MeasureError(f"The two surfaces cannot be aligned by their images, for {why}: {_MEND}.")
    both = _common(first, second, found.registration)
    if not keep_z:
        return settled(first, second, found.registration, found.covariance, both)
    u = 2 * np.sqrt(np.diag(found.covariance))
    return replace(found.registration, u_xy_um=float(max(u[:2])), u_turn_mrad=float(1e3 * u[2]))


def _about(registration: Registration, region: Region) -> Registration:
    xa, ya, xb, yb = region.bounds_um
    return replace(registration, about_x_um=(xa + xb) / 2, about_y_um=(ya + yb) / 2)


def _common(first: Outline, second: Outline, registration: Registration) -> Region:
    """Return the axis-parallel rectangle common to both. Raises MeasureError when it is too small."""
    xa, ya, xb, yb = SampleGrid(first.pixel_um, first.x0_um, first.y0_um, first.shape).bounds_um
    x0, y0, x1, y1 = _moved(SampleGrid(second.pixel_um, second.x0_um, second.y0_um, second.shape), registration)
    low_x, low_y, high_x, high_y = max(xa, x0), max(ya, y0), min(xb, x1), min(yb, y1)
    if min(high_x - low_x, high_y - low_y) < LEAST_OVERLAP_PX * first.pixel_um:
        raise MeasureError(
            f"The surfaces lie beside each other: the first from ({xa:.0f}, {ya:.0f}) to ({xb:.0f}, {yb:.0f}) um, the "
            f"second from ({x0:.0f}, {y0:.0f}) to ({x1:.0f}, {y1:.0f}) um: take two of the same part of the sample."
        )
    return Region.rectangle(low_x, low_y, high_x, high_y)


def _moved(lattice: SampleGrid, r: Registration) -> tuple[float, float, float, float]:
    """Return the bounds of a surface after alignment."""
    xa, ya, xb, yb = lattice.bounds_um
    cos, sin = np.cos(r.turn_mrad * 1e-3), np.sin(r.turn_mrad * 1e-3)
    dx, dy = np.array([xa, xa, xb, xb]) - r.about_x_um, np.array([ya, yb, ya, yb]) - r.about_y_um
    x, y = r.about_x_um + r.x_um + cos * dx - sin * dy, r.about_y_um + r.y_um + sin * dx + cos * dy
    return float(x.min()), float(y.min()), float(x.max()), float(y.max())


def _overlap_fraction(first: Mosaic, second: Mosaic, registration: Registration) -> float:
    """Return the fraction of the first's measured pixels that are measured in the second, on a coarse level."""
    level = min(first.levels - 1, max(0, int(np.ceil(np.log2(max(first.shape) / _SEEN_PX)))))
    one = first.window(None, level)
    other = ResampledMosaic(first, second, registration).on(SampleGrid(one.pixel_um, one.x0_um, one.y0_um, one.shape))
    measured = np.isfinite(one.z_raw_um)
    both = measured & np.isfinite(other.z_raw_um)
    if not both.any():
        raise MeasureError("No place is measured in both surfaces: take surfaces of the same part of the sample.")
    return float(both.sum() / measured.sum())
