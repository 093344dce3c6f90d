"""Refused points: kept with a field, read back, drawn by reason, clipped and counted, stitched as the surface is."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import msgspec
import numpy as np
import pytest

from tests.support.datasets.grid_dataset import REGISTERED, add_surfaces, make_dataset
from tests.support.page_stand_in import MemoryShelf, height_map
from tests.truth.field_grid import SMALL, make
from wafer_viewer.draw.colormaps import ORIGIN_COLOURS
from wafer_viewer.draw.surface.texture_baking import CODES
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.measurement.tool_options import Datum
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.clipping import Clip, Slab
from wafer_viewer.model.surface.field_poses import Poses
from wafer_viewer.model.surface.height_map import HeightMap, Origin, RefusedHeights
from wafer_viewer.session.rendering.render_pictures import paint
from wafer_viewer.session.rendering.render_request import (
    RefusedCounts,
    RenderRequest,
    Statistics,
    SurfaceKey,
    unpack_points,
)
from wafer_viewer.session.rendering.surface_source import PlacedField, placed_fields, points_of
from wafer_viewer.session.surface.stitching_job import bring_up_to_date
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.formats.npz_file import read_npz, write_npz

PIXEL, ROWS, COLS = 0.5, 60, 80
HOLE = np.s_[10:20, 30:50]
"""Without texture; the noise there peaks at 30 um."""


@pytest.fixture
def field() -> HeightMap:
    """Level ground at 2 um with a hole of 200 pixels, whose peaks were refused, and one filled pixel."""
    z = np.full((ROWS, COLS), 2.0)
    z[HOLE] = np.nan
    made = height_map(z, PIXEL)
    made.z_um[10, 30], made.origin[10, 30] = 2.0, Origin.FILLED
    at = np.flatnonzero(np.isnan(made.z_raw_um) | (made.origin == Origin.FILLED))
    reason = np.full(at.size, Origin.NO_TEXTURE, np.uint8)
    reason[0] = Origin.OUTLIER
    return dataclasses.replace(
        made, refused=RefusedHeights(at.astype(np.uint32), np.full(at.size, 30.0, np.float32), reason)
    )


def requested(what: str, show: int = 1, **more: object) -> RenderRequest:
    return RenderRequest(SurfaceKey(Path("x"), "default", show, 1), what, refused=True, **more)  # pyright: ignore[reportArgumentType]


def drawn(provider: MemoryShelf, **more: object) -> tuple[np.ndarray, np.ndarray]:
    complete = {"rows": (0, ROWS), "cols": (0, COLS)}
    places, colours = unpack_points(paint(provider, requested("points", **{**complete, **more})))
    return places.astype(float) * 1e3, colours


def counted(provider: MemoryShelf, show: int = 1, **more: object) -> Statistics:
    return msgspec.msgpack.decode(paint(provider, requested("statistics", show, **more)), type=Statistics)


def test_a_field_keeps_them_on_disk(field: HeightMap, tmp_path: Path):
    write_npz(field, tmp_path / "a.npz")
    back = read_npz(tmp_path / "a.npz").refused
    assert back is not None
    assert field.refused is not None
    for name in ("at", "z_um", "reason"):
        np.testing.assert_array_equal(getattr(back, name), getattr(field.refused, name))
        assert getattr(back, name).dtype == getattr(field.refused, name).dtype
    none = RefusedHeights(np.empty(0, np.uint32), np.empty(0, np.float32), np.empty(0, np.uint8))
    write_npz(dataclasses.replace(field, refused=none), tmp_path / "b.npz")
    empty = read_npz(tmp_path / "b.npz").refused
    assert empty is not None
    assert len(empty) == 0
    write_npz(dataclasses.replace(field, refused=None), tmp_path / "c.npz")
    assert read_npz(tmp_path / "c.npz").refused is None
    with pytest.raises(MeasureError, match="one length"):
        RefusedHeights(none.at, np.zeros(1, np.float32), none.reason)


def test_they_stand_at_their_heights_in_the_colours_of_their_reasons(field: HeightMap):
    places, colours = drawn(MemoryShelf({1: field}))
    high = places[:, 2] > 20
    assert high.sum() == 200
    assert places[high, 2] == pytest.approx(30, rel=1e-2)
    tones, counts = np.unique(colours[high], axis=0, return_counts=True)
    assert dict(zip(map(tuple, tones.tolist()), counts.tolist(), strict=True)) == {
        ORIGIN_COLOURS[Origin.OUTLIER]: 1,
        ORIGIN_COLOURS[Origin.NO_TEXTURE]: 199,
    }
    x = places[high, 0] + (COLS - 1) / 2 * PIXEL
    assert (x.min(), x.max()) == pytest.approx((30 * PIXEL, 49 * PIXEL), abs=0.02)


def test_tiles_share_them_out_and_the_outer_ones_have_what_lies_beyond(field: HeightMap):
    provider = MemoryShelf({1: field})
    parts = [
        drawn(provider, rows=rows, cols=cols, skirts=(foot, top, left, right))[0]
        for rows, foot, top in (((5, 15), True, False), ((15, 60), False, True))
        for cols, left, right in (((0, 40), False, True), ((40, 45), True, False))
    ]
    assert sum((part[:, 2] > 20).sum() for part in parts) == 200


def test_far_away_every_few_of_them_are_drawn(field: HeightMap):
    places, _ = drawn(MemoryShelf({1: field}), level=1, rows=(0, ROWS // 2), cols=(0, COLS // 2))
    assert (places[:, 2] > 20).sum() == 50


def test_a_clip_leaves_them_out_for_the_same_reasons(field: HeightMap):
    provider, line = MemoryShelf({1: field}), Region.line(0.0, -15 * PIXEL, 40.0, -15 * PIXEL, PIXEL)
    clips = {
        "height": (Clip(heights_um=(0.0, 10.0)), 200),
        "confidence": (Clip(least_confidence=0.5), 200),
        "box": (Clip(box_um=(0.0, -100.0, 39.5 * PIXEL, 100.0)), 100),
        "slab": (Clip(slab=Slab(line, "hide")), 80),
    }
    for why, (clip, n_out) in clips.items():
        reported = counted(provider, clip=clip).refused
        assert reported is not None
        assert (reported.n_heights, reported.n_points) == (200, 200 - n_out)
        assert reported.left_out[why] == n_out
        assert (drawn(provider, clip=clip)[0][:, 2] > 20).sum() == 200 - n_out
    assert (drawn(provider, clip=Clip(slab=Slab(line, "pale")))[0][:, 2] > 20).sum() == 200


def test_they_are_counted_by_reason_and_read_from_the_datum(field: HeightMap):
    provider = MemoryShelf({1: field})
    reported = counted(provider).refused
    assert reported is not None
    assert reported.by_reason == {Origin.OUTLIER: 1, Origin.NO_TEXTURE: 199}
    assert (reported.n_fields, reported.n_fields_without) == (1, 0)
    part = counted(provider, box_um=(0.0, -100.0, 39.5 * PIXEL, 100.0)).refused
    assert part is not None
    assert part.n_heights == 100
    over = counted(
        provider, datum=Datum(powers=((0, 0),), coefficients=(25.0,)), clip=Clip(heights_um=(4.0, 6.0))
    ).refused
    assert over is not None
    assert over.n_points == 200
    old = counted(MemoryShelf({1: dataclasses.replace(field, refused=None)})).refused
    assert old is not None
    assert (old.n_heights, old.n_fields_without) == (0, 1)
    assert counted(MemoryShelf({0: field}), 0).refused == RefusedCounts(0, 0, dict.fromkeys(CODES, 0), {}, 0, 0)


@pytest.mark.slow
def test_in_the_stitched_surface_they_lie_where_their_neighbours_do(tmp_path: Path):
    """Where a field is moved, lifted and tilted by stitching, its refused points move with it."""
    made = make(SMALL)
    heights = list(made.heights)
    for place, height in enumerate(heights):
        at = np.arange(0, height.z_um.size, 97, dtype=np.uint32)
        z = height.z_um.ravel()[at]
        present = np.isfinite(z)
        reason = np.full(int(present.sum()), Origin.AMBIGUOUS, np.uint8)
        heights[place] = dataclasses.replace(height, refused=RefusedHeights(at[present], z[present], reason))
    changed = dataclasses.replace(made, heights=tuple(heights))
    path = tmp_path / "grid.wafer"
    make_dataset(path, changed)
    stored = add_surfaces(path, changed, range(len(heights)))
    stored.save_recipe(REGISTERED)
    bring_up_to_date(path, "default", REGISTERED)
    poses = stored.poses()
    assert isinstance(poses, Poses)
    assert np.hypot(poses.x_um - poses.stage_x_um, poses.y_um - poses.stage_y_um).max() > 1
    mosaic = Dataset.open(path).result("default").mosaic().window()
    fields = placed_fields(SurfaceKey(path, "default", 0, 1))
    assert len(fields) == len(heights)
    off_um = [_beside(mosaic, field) for field in fields]
    halves = [np.nanmedian(half) for off in off_um for half in np.array_split(off, 2)]
    assert np.abs(halves).max() < 0.15  # fields are lifted by up to 1.7 um, and tilted by 0.9 um from top to foot


def _beside(mosaic: HeightMap, field: PlacedField) -> np.ndarray:
    """How far the stitched surface lies over its refused points, um, row by row; the ground is rough."""
    points = points_of(field, (-np.inf, -np.inf, np.inf, np.inf))
    assert points is not None
    col = np.rint((points.x_um - mosaic.x0_um) / mosaic.pixel_um).astype(int)
    row = np.rint((mosaic.y0_um - points.y_um) / mosaic.pixel_um).astype(int)
    return mosaic.z_um[row, col] - points.z_um
