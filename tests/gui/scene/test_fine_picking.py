"""Clicks on a surface much finer than the heights that the page keeps of it."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import pytest

from tests.support.page_stand_in import MemoryShelf, height_map
from wafer_viewer.gui.scene.heightfield import HeightField, refine_height_field
from wafer_viewer.gui.scene.scene_contents import DisplayedSurface
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.measurement.tool_options import Datum
from wafer_viewer.session.rendering.render_pictures import paint
from wafer_viewer.session.rendering.render_request import (
    CoarseHeightField,
    ColourScale,
    RenderRequest,
    SurfaceKey,
    SurfaceStatistics,
)

PIXEL_UM, SIDE = 0.5, 3000
SOURCE = SurfaceKey(Path("memory.wafer"), "default", 0, 1)
TILTED = Datum(powers=((0, 0), (1, 0)), coefficients=(2.0, 0.01))


@pytest.fixture(scope="module")
def surface():
    """Ridges 60 um high and 8 um wide, which the coarse heights do not resolve."""
    x = np.arange(SIDE) * PIXEL_UM
    z = np.where(np.mod(x, 20.0) < 8.0, 60.0, 0.0)[None, :] * np.ones((SIDE, 1))
    return height_map(z, PIXEL_UM, 0.0, 0.0)


@pytest.mark.campaign(at_least_one=True)
@pytest.mark.parametrize("datum", [None, TILTED])
def test_a_click_hits_the_pixel_it_seems_to(surface, datum):
    shelf = MemoryShelf({0: surface})
    facts, scale, relief = (
        msgspec.msgpack.decode(paint(shelf, RenderRequest(SOURCE, what, datum=datum)), type=kind)  # type: ignore
        for what, kind in (("facts", SurfaceStatistics), ("scale", ColourScale), ("relief", CoarseHeightField))
    )
    on_show = DisplayedSurface(SOURCE, facts, scale, facts.lowest_um, 3.0, datum)
    height_field = HeightField(relief, on_show)
    for x_um in (604.0, 704.2, 985.6):
        over = datum.at(np.float64(x_um), np.float64(-400.0)) if datum else 0.0
        top = np.array([x_um * 1e-3, -0.4, on_show.scene_z(60.0 - float(over))])
        origin = top + np.array([0.0, -0.8, 1.1])
        near = refine_height_field(lambda show: surface, height_field, origin, top - origin)
        result = near.hit(origin, top - origin)
        assert result is not None
        assert np.hypot(result[0] - x_um, result[1] + 400.0) < 0.71 * PIXEL_UM
        assert near.reached(origin, top - origin) == pytest.approx(1.0, abs=1e-3)


@pytest.mark.slow
def test_a_surface_that_cannot_be_read_is_hit_where_the_coarse_heights_are(surface):
    shelf = MemoryShelf({0: surface})
    relief = msgspec.msgpack.decode(paint(shelf, RenderRequest(SOURCE, "relief")), type=CoarseHeightField)
    facts = msgspec.msgpack.decode(paint(shelf, RenderRequest(SOURCE, "facts")), type=SurfaceStatistics)
    scale = ColourScale("height", 0.0, 1.0, 0.0, 1.0, 0.0, 1.0, ())
    height_field = HeightField(relief, DisplayedSurface(SOURCE, facts, scale, 0.0, 1.0))

    def gone(show: int):
        raise DatasetError("The surface is gone.")

    origin = np.array([0.5, -0.5, 1.0])
    assert refine_height_field(gone, height_field, origin, np.array([0.0, 0.0, -1.0])) is height_field
