"""Comparison views of a position: other dies, golden die and earlier scan; and the picture of a typical die."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
import numpy as np
from numpy.typing import NDArray

from wafer_viewer.draw.surface.pictures import (
    LEAST_SPAN_GREY,
    LEAST_SPAN_UM,
    Range,
    difference_of,
    greys_of,
    heights_of,
    picture_of,
)
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

PLACE_PX, DIE_PX = 400, 640
"""Maximum length in pixels of the longer side of a picture, of a position and of a die."""
DIE_REACH_PX, SCAN_REACH_PX = 3, 48
"""Search range in pixels for the offset of a die, and of an earlier scan."""
LEAST_MEASURED = 0.2
Box = tuple[float, float, float, float]

MOST_SECTION_PX, SECTION_ROWS = 400, 3
"""Maximum number of points of a section, and number of pixel rows that it is the mean of."""


@dataclass(frozen=True, slots=True)
class _Crops:
    """The same content of the patch that is shown and of the strip along the section."""

    shown: DieCrop
    strip: DieCrop


Pair = tuple[ComparisonView, _Crops | None]


@dataclass(frozen=True, slots=True)
class _Place:
    """Position under comparison: its patch and strip, and its own crops."""

    patch: DiePatch
    strip: DiePatch
    own: _Crops


def comparison(provider: SurfaceProvider, request: RenderRequest) -> bytes:
    """Return `ComparisonViews` as msgpack; no bytes if nothing was scanned there."""
    like, box = request.like, request.box_um
    if like is None or box is None:
        return b""
    surface = provider.surface(request.source)
    patch, strip = DiePatch.of_box(surface, box, PLACE_PX), _strip(surface, like.section_um or box)
    shown, along = crop(surface, patch), crop(surface, strip)
    if shown is None or along is None or not (np.isfinite(shown.z_um).any() or np.isfinite(shown.picture).any()):
        return b""
    here = _Place(patch, strip, _Crops(shown, along))
    pairs = [(ComparisonView("here"), here.own), *_others(provider, request.source, like, surface, here)]
    views = _Drawing.of([crops.shown for _, crops in pairs if crops is not None], here, _inside(patch, like))
    answer = ComparisonViews(
        views.heights.low,
        views.heights.high,
        views.heights.zero,
        _box_of(patch),
        patch.pixel_um,
        tuple(views.drawn(view, crops) for view, crops in pairs),
        views.differences.high,
        views.grey_differences.high,
        like.section_um or box,
    )
    return msgspec.msgpack.encode(answer)


def _strip(surface: Mosaic, section_um: Box) -> DiePatch:
    """Return the patch along a section, its first point at the left end of the line."""
    x0, y0, x1, y1 = section_um
    length_um = max(math.hypot(x1 - x0, y1 - y0), surface.pixel_um)
    cols = min(MOST_SECTION_PX, max(2, round(length_um / surface.pixel_um)))
    angle = math.atan2(y1 - y0, x1 - x0)
    return DiePatch((x0 + x1) / 2, (y0 + y1) / 2, length_um / cols, (SECTION_ROWS, cols), angle)


@dataclass(frozen=True, slots=True)
class _Drawing:
    """Ranges that all views of a comparison share, and the crops that they are compared with."""

    own: _Crops
    pixel_um: float
    heights: Range
    greys: Range
    differences: Range
    grey_differences: Range

    @classmethod
    def of(cls, crops: list[DieCrop], here: _Place, inside: tuple[slice, slice]) -> _Drawing:
        own = here.own.shown
        heights = heights_of([one.z_um for one in crops], own.z_um[inside], here.patch.pixel_um)
        z, grey = ([getattr(own, name) - getattr(one, name) for one in crops[1:2]] for name in ("z_um", "picture"))
        within = [plane[0][inside] if plane else own.z_um[:0] for plane in (z, grey)]
        differences = difference_of(z, within[0], LEAST_SPAN_UM)
        grey_differences = difference_of(grey, within[1], LEAST_SPAN_GREY)
        greys = greys_of([one.picture for one in crops])
        return cls(here.own, here.patch.pixel_um, heights, greys, differences, grey_differences)

    def drawn(self, view: ComparisonView, crops: _Crops | None) -> ComparisonView:
        """Return a view with its pictures and its section."""
        if crops is None:
            return view
        own, other = self.own.shown, crops.shown
        differs = other is not own
        return msgspec.structs.replace(
            view,
            height=self._picture(other.z_um, self.heights),
            picture=self._picture(other.picture, self.greys),
            height_difference=self._picture(own.z_um - other.z_um, self.differences) if differs else b"",
            picture_difference=self._picture(own.picture - other.picture, self.grey_differences) if differs else b"",
            section=_along(crops.strip.z_um),
            section_grey=_along(crops.strip.picture),
        )

    def _picture(self, plane: NDArray[np.float32], over: Range) -> bytes:
        return picture_of(plane, self.pixel_um, over)


def _along(plane: NDArray[np.float32]) -> tuple[float, ...]:
    """Return the mean over the rows of a strip; NaN where none is known."""
    known = np.isfinite(plane)
    n = known.sum(0)
    mean = np.where(known, plane, 0).sum(0) / np.maximum(n, 1)
    return tuple(np.where(n > 0, mean, np.nan).round(4).tolist())


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
    others = replace(like, die=place, dies=like.dies[1:])
    cuts = [own, *(one.cut for _, one in _aligned_crops(surface, others, patch, own))]
    return DiePicture(_grey(median_crop(own, cuts)), len(cuts))


def _others(
    provider: SurfaceProvider, source: SurfaceKey, like: ComparisonRequest, surface: Mosaic, here: _Place
) -> Iterator[Pair]:
    """Yield the reference, then the earlier scan; each with the reason if it is missing."""
    yield (_of_golden(source.dataset.parent, like, surface, here) if like.golden else _of_dies(like, surface, here))
    yield _of_before(provider, like, here)


def _of_dies(like: ComparisonRequest, surface: Mosaic, here: _Place) -> Pair:
    grid, die = like.grid, like.die
    if grid is None:
        return ComparisonView(
            "dies", why_not="The surface was compared with its form: there are no dies to show."
        ), None
    if die is None:
        return ComparisonView("dies", why_not="The place lies outside of the dies."), None
    aligned = list(_aligned_crops(surface, like, here.patch, here.own.shown))
    if not aligned:
        return ComparisonView("dies", why_not="No other die was scanned completely."), None
    strips = (crop(surface, _moved(here.strip.on_die(grid, die, other), one.moved_um)) for other, one in aligned)
    along = [levelled_on(here.own.strip, strip) for strip in strips if strip is not None]
    shown = median_crop(here.own.shown, [one.cut for _, one in aligned])
    return ComparisonView("dies", dies=len(aligned)), _Crops(shown, median_crop(here.own.strip, along))


def _moved(patch: DiePatch, moved_um: tuple[float, float]) -> DiePatch:
    """Return a patch at the place of an aligned one, `moved_um` down and to the right."""
    down_um, right_um = moved_um
    return replace(patch, x_um=float(patch.x_um) + right_um, y_um=float(patch.y_um) - down_um)


def _aligned_crops(
    surface: Mosaic, like: ComparisonRequest, patch: DiePatch, own: DieCrop
) -> Iterator[tuple[tuple[int, int], AlignedPatch]]:
    """Yield the other dies with the same position of each, as far as it is measured there."""
    for other in like.dies:
        if like.grid is not None and like.die is not None and other != like.die:
            aligned = align_crop(own, surface, patch.on_die(like.grid, like.die, other), DIE_REACH_PX)
            if aligned is not None and aligned.cut.measured >= LEAST_MEASURED:
                yield other, aligned


def _of_golden(folder: Path, like: ComparisonRequest, surface: Mosaic, here: _Place) -> Pair:
    if like.grid is None or like.die is None:
        return ComparisonView("golden", why_not="The place lies outside of the dies."), None
    try:
        golden = _golden(folder, like, surface)
    except WaferViewerError as fault:
        return ComparisonView("golden", why_not=str(fault)), None
    shown, strip = (cut_of_golden(golden, like.grid, like.die, patch) for patch in (here.patch, here.strip))
    crops = _Crops(levelled_on(here.own.shown, shown), levelled_on(here.own.strip, strip))
    if crops.shown.measured < LEAST_MEASURED:
        return ComparisonView(
            "golden", why_not=f"{golden.title} knows nothing of this place: a street has no golden die."
        ), None
    return ComparisonView("golden", name=golden.title, dies=golden.header.dies), crops


def _golden(folder: Path, like: ComparisonRequest, surface: Mosaic) -> GoldenDie:
    """Return the stored golden die. Raises DatasetError if it does not exist, MeasureError if it does not fit."""
    from wafer_viewer.store.records.golden_dies import FOLDER, golden_named

    golden = golden_named(folder / FOLDER, like.golden, like.product)
    if like.grid is None:
        raise MeasureError("There are no dies: nothing to lay a golden die on.")
    size = {"width_um": like.grid.width_um, "height_um": like.grid.height_um}
    golden.require_fit(product=like.product, pixel_um=surface.pixel_um, **size)
    return golden


def _of_before(provider: SurfaceProvider, like: ComparisonRequest, here: _Place) -> Pair:
    if like.before is None or like.before_at_um is None:
        return ComparisonView("before", why_not=like.no_before), None
    name, (x_um, y_um) = like.before_name, like.before_at_um
    try:
        earlier = provider.surface(like.before)
    except WaferViewerError as fault:
        return ComparisonView("before", name=name, why_not=str(fault)), None
    patch_there = replace(here.patch, x_um=x_um, y_um=y_um, angle_rad=like.before_turn_rad)
    aligned = align_crop(here.own.shown, earlier, patch_there, SCAN_REACH_PX)
    if aligned is None or aligned.cut.measured < LEAST_MEASURED:
        return ComparisonView(
            "before", name=name, why_not=f"{name} was not scanned, or not measured, at this place."
        ), None
    if aligned.similarity < LEAST_SIMILARITY:
        near_um = SCAN_REACH_PX * here.patch.pixel_um
        reason = f"What {name} has within {near_um:.0f} um of this place does not look like it."
        return ComparisonView("before", name=name, similarity=aligned.similarity, why_not=reason), None
    down_um, right_um = aligned.moved_um
    strip = crop(earlier, _strip_there(here, patch_there.moved(*(um / here.patch.pixel_um for um in aligned.moved_um))))
    along = levelled_on(here.own.strip, strip) if strip is not None else _nothing_of(here.own.strip)
    view = ComparisonView("before", name=name, moved_um=(right_um, -down_um), similarity=aligned.similarity)
    return view, _Crops(aligned.cut, along)


def _strip_there(here: _Place, there: DiePatch) -> DiePatch:
    """Return the strip that lies in another patch as its own does in that of the place."""
    right, up = float(here.strip.x_um) - float(here.patch.x_um), float(here.strip.y_um) - float(here.patch.y_um)
    c, s = math.cos(there.angle_rad), math.sin(there.angle_rad)
    x_um, y_um = float(there.x_um) + c * right - s * up, float(there.y_um) + s * right + c * up
    return replace(here.strip, x_um=x_um, y_um=y_um, angle_rad=here.strip.angle_rad + there.angle_rad)


def _nothing_of(one: DieCrop) -> DieCrop:
    return DieCrop(np.full_like(one.z_um, np.nan), np.full_like(one.picture, np.nan))


def _grey(die_crop: DieCrop) -> bytes:
    return picture_of(die_crop.picture, 1.0, greys_of([die_crop.picture]))


def _inside(patch: DiePatch, like: ComparisonRequest) -> tuple[slice, slice]:
    """Return the rows and columns of a patch that hold the defect."""
    if like.defect_um is None:
        return slice(0, 0), slice(0, 0)
    (x0, y0, x1, y1), (left, _, _, high) = like.defect_um, _box_of(patch)
    cols = slice(max(0, int((x0 - left) / patch.pixel_um)), max(0, int((x1 - left) / patch.pixel_um) + 1))
    rows = slice(max(0, int((high - y1) / patch.pixel_um)), max(0, int((high - y0) / patch.pixel_um) + 1))
    return rows, cols


def _box_of(patch: DiePatch) -> tuple[float, float, float, float]:
    """Return the box of an upright patch, to the outer edges of its pixels."""
    half_y, half_x = (n / 2 * patch.pixel_um for n in patch.shape)
    x_um, y_um = float(patch.x_um), float(patch.y_um)
    return x_um - half_x, y_um - half_y, x_um + half_x, y_um + half_y
