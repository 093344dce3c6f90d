from __future__ import annotations

import numpy as np
import pytest

from tests.support.surfaces import height_map
from wafer_viewer.model.surface.height_map import Origin
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.reconstruct.stitching import stitch
from wafer_viewer.session.core.dataset_library import load_summary, save_summary, summarise
from wafer_viewer.session.state.snapshot import SurfaceInfo
from wafer_viewer.store.dataset.result import Result
from wafer_viewer.store.mosaic.zarr_mosaic import write_mosaic


def flat(z_um, *, x0_um=0.0, y0_um=0.0, shape=(40, 60), noise_um=0.0):
    z = np.full(shape, z_um, np.float32) + np.random.default_rng(3).normal(0, noise_um, shape).astype(np.float32)
    return height_map(z, 0.5, x0_um, y0_um, z_raw_um=z.copy())


def unmeasured(surface, rows, cols, why):
    surface.z_um[rows, cols] = surface.z_raw_um[rows, cols] = np.nan
    surface.origin[rows, cols] = why
    return surface


def test_it_says_how_much_is_measured_and_why_the_rest_is_not():
    surface = unmeasured(flat(5.0), slice(0, 10), slice(None), Origin.CLIPPED)
    surface = unmeasured(surface, slice(10, 12), slice(None), Origin.NO_TEXTURE)
    surface.z_um[20, 20], surface.origin[30] = 9.0, Origin.FILLED
    info = summarise(surface, 1, "default")
    assert info.unmeasured == (("too bright", 0.25), ("no texture", 0.05))
    assert info.filled_fraction == 1 / 40
    assert info.measured_fraction == pytest.approx(1 - 0.3 - 1 / 40)
    assert (info.lowest_um, info.highest_um) == (5.0, 9.0)
    assert (info.rows, info.cols, info.n_fields) == (40, 60, 1)


def test_a_surface_without_any_height_is_summarised_as_well():
    nothing = unmeasured(flat(0.0), slice(None), slice(None), Origin.NO_TEXTURE)
    info = summarise(nothing, 1, "default")
    assert info.measured_fraction == 0
    assert info.low_um < info.high_um
    assert info.overlap_rms_um is None


def test_what_no_field_covers_is_nobodys_loss():
    islands = summarise(stitch([flat(1.0), flat(2.0, x0_um=500.0)], recipe=Recipe.paper()).window(), 2, "default")
    assert (islands.measured_fraction, islands.unmeasured) == (1.0, ())


@pytest.mark.slow
@pytest.mark.parametrize(("dx", "dy"), [(25.0, 0.0), (-25.0, 5.0), (0.0, 15.0), (10.0, -10.0)])
def test_the_misfit_of_neighbours_is_found_where_they_overlap(dx, dy):
    assert misfit_of(flat(1.0), flat(1.25, x0_um=dx, y0_um=dy)) == pytest.approx(0.25)


def test_false_heights_do_not_count_as_misfit():
    a, b = flat(1.0, noise_um=0.01), flat(1.0, x0_um=10.0, noise_um=0.02)
    b.z_raw_um[5, 5] = 500.0
    assert 0.005 < misfit_of(a, b) < 0.05


def test_fields_that_do_not_touch_have_no_misfit():
    assert misfit_of(flat(1.0), flat(2.0, x0_um=1000.0)) is None


@pytest.mark.slow
def test_a_mosaic_on_disk_is_summarised_from_what_is_stored_next_to_it(tmp_path):
    surface = unmeasured(flat(5.0, shape=(700, 1100), noise_um=0.1), slice(0, 70), slice(None), Origin.CLIPPED)
    surface = stitch([surface, flat(5.1, shape=(700, 1100), x0_um=500.0)], recipe=Recipe.paper())
    stored = write_mosaic(tmp_path / "m.zarr", surface)
    kept, read = summarise(stored, 2, "default"), summarise(surface.window(), 2, "default")
    assert kept.overlap_rms_um == pytest.approx(read.overlap_rms_um, rel=0.01)
    for name in ("measured_fraction", "unmeasured", "highest_um", "lowest_um", "n_fields"):
        assert getattr(kept, name) == getattr(read, name)
    assert (kept.low_um, kept.high_um) == pytest.approx((read.low_um, read.high_um), abs=0.02)


def misfit_of(a, b):
    return summarise(stitch([a, b], recipe=Recipe.paper()).window(), 2, "default").overlap_rms_um


def test_a_summary_comes_back_from_the_disk_and_a_damaged_one_is_no_summary(tmp_path):
    result = Result.of(tmp_path, "default")
    result.path.mkdir()
    assert load_summary(result) is None
    info = summarise(flat(2.0), 1, "default", Recipe.paper())
    save_summary(result, info)
    back = load_summary(result)
    assert isinstance(back, SurfaceInfo)
    assert back == info
    (result.path / "surface.json").write_text("{")
    assert load_summary(result) is None
