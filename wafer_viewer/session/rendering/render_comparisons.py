"""Comparison views of a position: other dies, golden die and earlier scan; and the picture of a typical die."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
import numpy as np
from numpy.typing import NDArray

from wafer_viewer.draw.surface.pictures import Range, greys_of, heights_of, picture_of
from wafer_viewer.measure.dies.die_crops import (
    LEAST_SIMILARITY,
    AlignedPatch,
    DieCrop,
    DiePatch,
    align_crop,
    crop,
    cut_of_golden,
    levelled_on,
    median_crop,
)
from wafer_viewer.model.errors import MeasureError, WaferViewerError
from wafer_viewer.session.rendering.render_request import (
    ComparisonRequest,
    ComparisonView,
    ComparisonViews,
    DiePicture,
    RenderRequest,
    SurfaceKey,
)
from wafer_viewer.session.rendering.surface_source import SurfaceProvider

if TYPE_CHECKING:
    from wafer_viewer.model.inspection.golden_die import GoldenDie
    from wafer_viewer.model.surface.height_map import Mosaic

PLACE_PX, DIE_PX = 320, 640
"""Maximum length in pixels of the longer side of a picture, of a position and of a die."""
DIE_REACH_PX, SCAN_REACH_PX = 3, 48
"""Search range in pixels for the offset of a die, and of an earlier scan."""
LEAST_MEASURED = 0.2

Pair = tuple[ComparisonView, DieCrop | None]


def comparison(provider: SurfaceProvider, request: RenderRequest) -> bytes:
    """Return `ComparisonViews` as msgpack; no bytes if nothing was scanned there."""
    like, box = request.like, request.box_um
    if like is None or box is None:
        return b""
    surface = provider.surface(request.source)
    patch = DiePatch.of_box(surface, box, PLACE_PX)
    own = crop(surface, patch)
    if own is None or not (np.isfinite(own.z_um).any() or np.isfinite(own.picture).any()):
        return b""
    pairs = [(ComparisonView("here"), own), *_others(provider, request.source, like, surface, patch, own)]
    cuts = [one for _, one in pairs if one is not None]
    heights = heights_of([one.z_um for one in cuts], _inside(own, patch, like), patch.pixel_um)
    greys = greys_of([one.picture for one in cuts])
    views = tuple(_drawn(view, one, patch.pixel_um, heights, greys) for view, one in pairs)
    result = ComparisonViews(heights.low, heights.high, heights.zero, _box_of(patch), patch.pixel_um, views)
    return msgspec.msgpack.encode(result)


def die(provider: SurfaceProvider, request: RenderRequest) -> bytes:
    """Return a `DiePicture` as msgpack."""
    if request.like is None:
        return b""
    folder = request.source.dataset.parent
    return msgspec.msgpack.encode(picture_of_die(provider.surface(request.source), folder, request.like))


def picture_of_die(surface: Mosaic, folder: Path, like: ComparisonRequest) -> DiePicture:
    """Return the picture of a die along its own axes: the golden one, or the median of the dies of `like`.

    folder: the data folder, which contains the golden dies.
    """
    nothing = DiePicture(why_not="No die was scanned completely.")
    if like.grid is None or not (like.dies or like.golden):
        return nothing
    place = like.dies[0] if like.dies else (like.grid.first_col, like.grid.first_row)
    patch = DiePatch.of_die(surface, like.grid, place, DIE_PX)
    if like.golden:
        with suppress(WaferViewerError):
            golden = _golden(folder, like, surface)
            return DiePicture(_grey(cut_of_golden(golden, like.grid, place, patch)), golden.header.dies, golden.title)
    own = crop(surface, patch)
    if own is None:
        return nothing
    cuts = [
        own,
        *(one.cut for one in _aligned_crops(surface, replace(like, die=place, dies=like.dies[1:]), patch, own)),
    ]
    return DiePicture(_grey(median_crop(own, cuts)), len(cuts))


def _others(
    provider: SurfaceProvider,
    source: SurfaceKey,
    like: ComparisonRequest,
    surface: Mosaic,
    patch: DiePatch,
    own: DieCrop,
) -> Iterator[Pair]:
    """Yield the reference, then the earlier scan; each with the reason if it is missing."""
    yield (
        _of_golden(source.dataset.parent, like, surface, patch, own)
        if like.golden
        else _of_dies(like, surface, patch, own)
    )
    yield _of_before(provider, like, patch, own)


def _of_dies(like: ComparisonRequest, surface: Mosaic, patch: DiePatch, own: DieCrop) -> Pair:
    if like.grid is None:
        return ComparisonView(
            "dies", why_not="The surface was compared with its form: there are no dies to show."
        ), None
    if like.die is None:
        return ComparisonView("dies", why_not="The place lies outside of the dies."), None
    aligned = list(_aligned_crops(surface, like, patch, own))
    if not aligned:
        return ComparisonView("dies", why_not="No other die was scanned completely."), None
    return ComparisonView("dies", dies=len(aligned)), median_crop(own, [one.cut for one in aligned])


def _aligned_crops(surface: Mosaic, like: ComparisonRequest, patch: DiePatch, own: DieCrop) -> Iterator[AlignedPatch]:
    """Yield the same position of the other dies, as far as it is measured there."""
    for other in like.dies:
        if like.grid is not None and like.die is not None and other != like.die:
            aligned = align_crop(own, surface, patch.on_die(like.grid, like.die, other), DIE_REACH_PX)
            if aligned is not None and aligned.cut.measured >= LEAST_MEASURED:
                yield aligned


def _of_golden(folder: Path, like: ComparisonRequest, surface: Mosaic, patch: DiePatch, own: DieCrop) -> Pair:
    if like.grid is None or like.die is None:
        return ComparisonView("golden", why_not="The place lies outside of the dies."), None
    try:
        golden = _golden(folder, like, surface)
    except WaferViewerError as fault:
        return ComparisonView("golden", why_not=str(fault)), None
    golden_crop = levelled_on(own, cut_of_golden(golden, like.grid, like.die, patch))
    if golden_crop.measured < LEAST_MEASURED:
        return ComparisonView(
            "golden", why_not=f"{golden.title} knows nothing of this place: a street has no golden die."
        ), None
    return ComparisonView("golden", name=golden.title, dies=golden.header.dies), golden_crop


def _golden(folder: Path, like: ComparisonRequest, surface: Mosaic) -> GoldenDie:
    """Return the stored golden die. Raises DatasetError if it does not exist, MeasureError if it does not fit."""
    from wafer_viewer.store.records.golden_dies import FOLDER, golden_named

    golden = golden_named(folder / FOLDER, like.golden, like.product)
    if like.grid is None:
        raise MeasureError("There are no dies: nothing to lay a golden die on.")
    size = {"width_um": like.grid.width_um, "height_um": like.grid.height_um}
    golden.require_fit(product=like.product, pixel_um=surface.pixel_um, **size)
    return golden


def _of_before(provider: SurfaceProvider, like: ComparisonRequest, patch: DiePatch, own: DieCrop) -> Pair:
    if like.before is None or like.before_at_um is None:
        return ComparisonView("before", why_not=like.no_before), None
    name, (x_um, y_um) = like.before_name, like.before_at_um
    try:
        earlier = provider.surface(like.before)
    except WaferViewerError as fault:
        return ComparisonView("before", name=name, why_not=str(fault)), None
    patch_there = replace(patch, x_um=x_um, y_um=y_um, angle_rad=like.before_turn_rad)
    aligned = align_crop(own, earlier, patch_there, SCAN_REACH_PX)
    if aligned is None or aligned.cut.measured < LEAST_MEASURED:
        return ComparisonView(
            "before", name=name, why_not=f"{name} was not scanned, or not measured, at this place."
        ), None
    if aligned.similarity < LEAST_SIMILARITY:
        reason = f"What {name} has within {SCAN_REACH_PX * patch.pixel_um:.0f} um of this place does not look like it."
        return ComparisonView("before", name=name, similarity=aligned.similarity, why_not=reason), None
    down_um, right_um = aligned.moved_um
    return ComparisonView(
        "before", name=name, moved_um=(right_um, -down_um), similarity=aligned.similarity
    ), aligned.cut


def _drawn(
    view: ComparisonView, crop_of_view: DieCrop | None, pixel_um: float, heights: Range, greys: Range
) -> ComparisonView:
    if crop_of_view is None:
        return view
    height, picture = (
        picture_of(crop_of_view.z_um, pixel_um, heights),
        picture_of(crop_of_view.picture, pixel_um, greys),
    )
    return msgspec.structs.replace(view, height=height, picture=picture)


def _grey(die_crop: DieCrop) -> bytes:
    return picture_of(die_crop.picture, 1.0, greys_of([die_crop.picture]))


def _inside(own: DieCrop, patch: DiePatch, like: ComparisonRequest) -> NDArray[np.float32]:
    """Return the heights inside the defect."""
    if like.defect_um is None:
        return own.z_um[:0]
    (x0, y0, x1, y1), (left, low, _, high) = like.defect_um, _box_of(patch)
    cols = slice(max(0, int((x0 - left) / patch.pixel_um)), max(0, int((x1 - left) / patch.pixel_um) + 1))
    rows = slice(max(0, int((high - y1) / patch.pixel_um)), max(0, int((high - y0) / patch.pixel_um) + 1))
    return own.z_um[rows, cols] if high > low else own.z_um


def _box_of(patch: DiePatch) -> tuple[float, float, float, float]:
    """Return the box of an upright patch, to the outer edges of its pixels."""
    half_y, half_x = (n / 2 * patch.pixel_um for n in patch.shape)
    x_um, y_um = float(patch.x_um), float(patch.y_um)
    return x_um - half_x, y_um - half_y, x_um + half_x, y_um + half_y
