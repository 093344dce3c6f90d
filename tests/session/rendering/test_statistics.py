"""Statistics of what is shown: a surface, a part of it, the points that a clip leaves, a brushed range of heights."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import msgspec
import numpy as np
import pytest

from tests.support.page_stand_in import MemoryShelf, height_map
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.measurement.tool_options import Datum
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.clipping import Clip, Slab
from wafer_viewer.model.surface.height_map import HeightMap, Origin, PartOfMosaic
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.session.rendering import render_statistics
from wafer_viewer.session.rendering.render_pictures import paint
from wafer_viewer.session.rendering.render_request import (
    RenderRequest,
    Statistics,
    SurfaceKey,
    SurfaceStatistics,
)

PIXEL = 0.5
ROWS, COLS = 120, 160


@pytest.fixture
def surface() -> HeightMap:
    """Level ground at 2 um with two pillars of 20 and 21 um, and a hole; confidence grows to the right."""
    z = np.full((ROWS, COLS), 2.0)
    z[20:40, 30:50], z[60:70, 100:105], z[80:100, 10:40] = 20.0, 21.0, np.nan
    made = height_map(z, PIXEL)
    return dataclasses.replace(made, confidence=np.broadcast_to(np.linspace(0, 1, COLS, dtype=np.float32), z.shape))


def counted(surface: HeightMap, **requested: object) -> Statistics:
    request = RenderRequest(SurfaceKey(Path("x"), "default", 0, 1), "statistics", **requested)  # pyright: ignore[reportArgumentType]
    return msgspec.msgpack.decode(paint(MemoryShelf({0: surface}), request), type=Statistics)


def test_a_surface_in_numbers(surface: HeightMap):
    reported, present = counted(surface), np.isfinite(surface.z_um)
    assert (reported.rows, reported.cols, reported.n_heights, reported.n_points) == (
        ROWS,
        COLS,
        present.sum(),
        present.sum(),
    )
    assert reported.measured_fraction == pytest.approx(present.mean())
    assert reported.unmeasured == (("no texture", pytest.approx(600 / ROWS / COLS)),)
    assert (reported.lowest_um, reported.highest_um) == (2.0, 21.0)
    assert reported.mean_um == pytest.approx(surface.z_um[present].mean(), rel=1e-5)
    assert reported.spread_um == pytest.approx(surface.z_um[present].std(ddof=1), rel=1e-4)
    assert sum(reported.counts) == present.sum()


def test_heights_are_counted_by_their_probability_where_they_have_one(surface: HeightMap):
    def facts(recipe: Recipe) -> SurfaceStatistics:
        shown = dataclasses.replace(surface, provenance=replace(surface.provenance, recipe=recipe))
        request = RenderRequest(SurfaceKey(Path("x"), "default", 0, 1), "facts")
        return msgspec.msgpack.decode(paint(MemoryShelf({0: shown}), request), type=SurfaceStatistics)

    found = facts(replace(Recipe(), least_probability=0.96))
    assert sum(found.by_probability) == ROWS * COLS
    kept, false = found.kept_from(0.9)
    assert kept == pytest.approx(0.1, abs=0.01)
    assert false == pytest.approx(0.05, abs=0.01)
    assert facts(Recipe.paper()).by_probability == ()
    assert facts(Recipe()).by_probability == (), "nothing was weighed"


def test_what_no_field_covers_is_nobodys_loss(surface: HeightMap):
    origin = np.where(np.isfinite(surface.z_um), Origin.MEASURED, Origin.NOT_COVERED).astype(np.uint8)
    reported = counted(dataclasses.replace(surface, origin=origin))
    assert reported.measured_fraction == 1.0
    assert reported.unmeasured == ()


def test_a_part_of_it(surface: HeightMap):
    box = (30 * PIXEL, -39 * PIXEL, 49 * PIXEL, -20 * PIXEL)
    reported = counted(surface, box_um=box)
    assert (reported.rows, reported.cols) == (20, 20)
    assert (reported.lowest_um, reported.highest_um, reported.spread_um) == (20.0, 20.0, 0.0)
    with pytest.raises(MeasureError, match="outside"):
        counted(surface, box_um=(1e4, 1e4, 1e4 + 1, 1e4 + 1))


def test_heights_are_read_from_the_datum(surface: HeightMap):
    reported = counted(surface, datum=Datum(powers=((0, 0),), coefficients=(2.0,)))
    assert (reported.lowest_um, reported.highest_um) == (0.0, 19.0)


def test_more_points_than_can_be_read_are_means_of_blocks(surface: HeightMap, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(render_statistics, "MOST_POINTS", ROWS * COLS // 4)
    reported = counted(surface)
    assert reported.block_px == 2
    assert reported.n_heights == pytest.approx(np.isfinite(surface.z_um).sum(), rel=0.02)
    assert (reported.rows, reported.cols) == (ROWS, COLS)


def test_a_brushed_range_is_reported_with_its_places(surface: HeightMap):
    reported = counted(surface, brush_um=(15.0, 30.0)).brushed
    assert reported is not None
    assert (reported.n_points, reported.n_places) == (400 + 50, 2)
    assert reported.fraction == pytest.approx(450 / np.isfinite(surface.z_um).sum())
    assert reported.mean_um == pytest.approx((400 * 20 + 50 * 21) / 450)
    assert reported.places[0] == pytest.approx((29.5 * PIXEL, -39.5 * PIXEL, 49.5 * PIXEL, -19.5 * PIXEL))
    nothing = counted(surface, brush_um=(5.0, 6.0)).brushed
    assert nothing is not None
    assert (nothing.n_points, nothing.mean_um, nothing.places) == (0, None, ())


def test_each_point_is_left_out_for_one_reason(surface: HeightMap):
    present = np.isfinite(surface.z_um)
    clip = Clip(heights_um=(0.0, 10.0), least_confidence=0.5)
    reported = counted(surface, clip=clip)
    high, low = present & (surface.z_um > 10), present & (surface.confidence < 0.5)
    assert reported.left_out == {"box": 0, "height": high.sum(), "confidence": (low & ~high).sum(), "slab": 0}
    assert reported.n_points == reported.n_heights - sum(reported.left_out.values())
    assert (reported.lowest_um, reported.highest_um) == (2.0, 2.0)
    assert sum(reported.counts) == present.sum()


def test_before_a_slab_is_the_right_hand_of_its_way(surface: HeightMap):
    present, y = np.isfinite(surface.z_um), -50 * PIXEL
    line = Region.line(0.0, y, 70.0, y, 4 * PIXEL)
    reported = counted(surface, clip=Clip(slab=Slab(line, "hide")))
    assert reported.left_out["slab"] == present[53:].sum()
    assert counted(surface, clip=Clip(slab=Slab(line, "show"))).left_out["slab"] == 0
    turned = Region.line(70.0, y, 0.0, y, 4 * PIXEL)
    assert counted(surface, clip=Clip(slab=Slab(turned, "pale"))).left_out["slab"] == present[:48].sum()


def test_a_part_of_a_surface_is_a_surface(surface: HeightMap):
    part = PartOfMosaic(surface, Region.rectangle(30 * PIXEL, -39 * PIXEL, 49 * PIXEL, -20 * PIXEL))
    complete = part.window()
    assert part.shape == complete.shape == (20, 20)
    assert (part.x0_um, part.y0_um) == (complete.x0_um, complete.y0_um) == (15.0, -10.0)
    assert (complete.z_um == 20.0).all()
    strip = part.window(Region.rectangle(15.0, -12.0, 24.5, -11.0))
    assert strip.shape == (3, 20)
    assert strip.y0_um == -11.0
