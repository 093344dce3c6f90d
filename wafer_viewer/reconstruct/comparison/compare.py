"""Comparison of two surfaces: the second is aligned to the first by images and relief or stage, and subtracted."""

from __future__ import annotations

import numpy as np

from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.comparison import ALIGN_TITLES, FOUND_BY, Align, Registration
from wafer_viewer.model.surface.field_poses import DOUBT_TITLES, RejectionReason
from wafer_viewer.model.surface.height_map import Mosaic, Outline
from wafer_viewer.reconstruct.comparison.height_difference import Difference, as_pyramid, noise_of, provenance_of
from wafer_viewer.reconstruct.comparison.registration import in_plane, levelled, settled
from wafer_viewer.reconstruct.comparison.resampled_surface import ResampledMosaic, SampleGrid

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
