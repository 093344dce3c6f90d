from __future__ import annotations

import dataclasses
import itertools
import json
import pickle
import shutil

import numpy as np
import pytest
import zarr
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from tests.support.campaigns import examples
from tests.support.datasets.samples import assert_same_surface, make_surface
from tests.support.direct_pyramid import assert_level, with_gaps
from wafer_viewer.measure.base.height_samples import heights
from wafer_viewer.model.errors import DatasetError, MeasureError
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.height_map import Origin
from wafer_viewer.numerics.grids.pyramid_level import halve
from wafer_viewer.store.mosaic import zarr_shards
from wafer_viewer.store.mosaic.missing_shards import missing_files
from wafer_viewer.store.mosaic.zarr_mosaic import ZarrMosaic, lay_out, patches, write_mosaic, write_patch

SIZES = zarr_shards.CHUNK, zarr_shards.SHARD
pytestmark = pytest.mark.usefixtures("small_shards")


@pytest.mark.slow
def test_what_was_written_is_what_is_read(stored, surface):
    assert_same_surface(stored.window(), surface)
    assert (stored.shape, stored.pixel_um, stored.x0_um, stored.y0_um) == ((150, 201), 0.5, -30.0, 80.0)
    assert stored.provenance.simulated
    assert stored.levels == 4


def test_a_window_is_cut_as_from_a_map_in_memory(stored, surface):
    region = Region.rectangle(-10.2, 20.0, 33.0, 61.7)
    assert_same_surface(stored.window(region), surface.window(region))
    with pytest.raises(MeasureError, match="lies outside"):
        stored.window(Region.rectangle(500, 500, 501, 501))
    with pytest.raises(DatasetError, match="has levels 0 to 3 and no level 4"):
        stored.window(None, 4)


@pytest.mark.parametrize("layer", ["unsmoothed", "smoothed", "filled"])
@pytest.mark.parametrize("level", [0, 2])
def test_one_layer_of_heights_is_read_alone_as_a_window_has_it(stored, monkeypatch, level, layer):
    region = Region.rectangle(-10.2, 20.0, 33.0, 61.7)
    part = stored.window(region, level)
    read = []
    full = ZarrMosaic.read
    monkeypatch.setattr(ZarrMosaic, "read", lambda self, name, *at: read.append(name) or full(self, name, *at))
    alone = stored.one_layer(layer, region, level)
    np.testing.assert_array_equal(alone.z_um, heights(part, layer))
    assert (alone.pixel_um, alone.x0_um, alone.y0_um) == (part.pixel_um, part.x0_um, part.y0_um)
    assert len(read) == (2 if layer == "smoothed" else 1)


def test_heights_and_picture_are_read_without_the_rest_as_a_window_has_them(stored, monkeypatch):
    region = Region.rectangle(-10.2, 20.0, 33.0, 61.7)
    part = stored.window(region)
    read = []
    full = ZarrMosaic.read
    monkeypatch.setattr(ZarrMosaic, "read", lambda self, name, *at: read.append(name) or full(self, name, *at))
    observed = stored.pictured("unsmoothed", region)
    np.testing.assert_array_equal(observed.z_um, part.z_raw_um)
    np.testing.assert_array_equal(np.isnan(observed.picture), part.origin == Origin.NOT_COVERED)
    np.testing.assert_array_equal(
        np.nan_to_num(observed.picture), np.where(np.isnan(observed.picture), 0, part.all_in_focus)
    )
    assert (observed.pixel_um, observed.x0_um, observed.y0_um) == (part.pixel_um, part.x0_um, part.y0_um)
    assert sorted(read) == ["all_in_focus", "origin", "z_raw_um"]


@pytest.mark.parametrize("level", [1, 2, 3])
def test_a_pixel_of_a_level_is_the_mean_of_what_it_stands_for(stored, surface, level):
    n = 2**level
    coarse = stored.window(level=level)
    assert coarse.pixel_um == n * 0.5
    rows, cols = 150 // n * n, 201 // n * n
    blocks = surface.all_in_focus[:rows, :cols].reshape(rows // n, n, cols // n, n).astype(float).mean(axis=(1, 3))
    assert np.abs(coarse.all_in_focus[: rows // n, : cols // n] - blocks).max() <= 0.5 * level + 1e-6
    assert coarse.x_um[0] == pytest.approx(surface.x_um[:n].mean())
    assert coarse.y_um[0] == pytest.approx(surface.y_um[:n].mean())


@pytest.mark.slow
def test_every_level_is_the_mean_of_the_measured_pixels_of_level_0(tmp_path, surface):
    gappy = with_gaps(surface)
    stored = write_mosaic(tmp_path / "m.zarr", gappy)
    for level in range(1, stored.levels):
        assert_level(stored.layers(level, *all_of(stored, level)), gappy, level)
    assert list(missing_files(stored)) == []


@pytest.mark.slow
def test_a_level_knows_how_many_pixels_its_means_are_of(tmp_path, surface):
    gappy = with_gaps(surface)
    stored = write_mosaic(tmp_path / "m.zarr", gappy)
    top = stored.levels - 1
    layers = stored.layers(top, *all_of(stored, top))
    assert layers["n_covered"].sum() == (gappy.origin != Origin.NOT_COVERED).sum()
    assert layers["n_overlap"].sum() == np.isfinite(gappy.overlap_um).sum()
    row, col = np.argwhere(layers["origin"] == Origin.MEASURED)[-1]
    below = np.s_[row * 2**top : (row + 1) * 2**top, col * 2**top : (col + 1) * 2**top]
    assert layers["n_origin"][row, col] == gappy.measured[below].sum()
    assert (layers["n_origin"][layers["origin"] == Origin.NOT_COVERED] == 0).all()


def test_the_span_of_a_coarse_pixel_holds_every_measured_height_below_it(stored, surface):
    low, high = stored.span(None, 2)
    measured = np.where(surface.measured, surface.z_um, np.nan)
    blocks = np.pad(measured, ((0, 2), (0, 3)), constant_values=np.nan).reshape(38, 4, 51, 4)
    np.testing.assert_array_equal(low, np.fmin.reduce(blocks, axis=(1, 3)))
    np.testing.assert_array_equal(high, np.fmax.reduce(blocks, axis=(1, 3)))
    assert_array_equal_pair(stored.span(None, 0), measured)


def assert_array_equal_pair(pair, expected):
    for part in pair:
        np.testing.assert_array_equal(part, expected)


LAYER_SHAPE = (5, 7)
HEIGHTS = arrays(np.float32, LAYER_SHAPE, elements=st.floats(-100, 100, width=32))
ORIGINS = arrays(np.uint8, LAYER_SHAPE, elements=st.sampled_from([o.value for o in Origin]))


@given(heights=HEIGHTS, origins=ORIGINS)
@settings(max_examples=examples(60))
def test_halving_invents_nothing(heights, origins):
    z = np.where(origins >= 10, np.nan, heights).astype(np.float32)
    raw = np.where(origins != 0, np.nan, heights).astype(np.float32)
    grey = np.full(LAYER_SHAPE, 7, np.uint8)
    layers = {"z_um": z, "z_raw_um": raw, "confidence": np.ones_like(z), "all_in_focus": grey, "origin": origins}
    half = halve(layers)
    for row, col in itertools.product(range(3), range(4)):
        block = np.s_[2 * row : 2 * row + 2, 2 * col : 2 * col + 2]
        best = origins[block].min()
        assert half["origin"][row, col] == best
        if best >= 10:
            assert np.isnan(half["z_um"][row, col])
            assert np.isnan(half["z_min_um"][row, col])
            continue
        expected = z[block][origins[block] == best].astype(float).mean()
        assert half["z_um"][row, col] == pytest.approx(expected, abs=1e-4)
        measured = z[block][origins[block] == 0]
        assert half["z_min_um"][row, col] == measured.min() if measured.size else np.isnan(half["z_min_um"][row, col])
        assert np.isnan(half["z_raw_um"][row, col]) == (best != 0)


def test_other_programs_find_a_pyramid_in_each_layer(stored):
    root = zarr.open_group(stored.path, mode="r", zarr_format=3)
    for name in ("z_um", "z_min_um", "z_max_um", "confidence", "all_in_focus", "origin", "z_raw_um"):
        ome = root[name].attrs["ome"]
        assert ome["version"] == "0.5"
        scales = [d["coordinateTransformations"][0]["scale"] for d in ome["multiscales"][0]["datasets"]]
        paths = [d["path"] for d in ome["multiscales"][0]["datasets"]]
        assert scales == [[0.5 * 2 ** int(p)] * 2 for p in paths]
        assert [a["unit"] for a in ome["multiscales"][0]["axes"]] == ["micrometer"] * 2
        assert all(root[name][p].shards == (64, 64) and root[name][p].chunks == (16, 16) for p in paths)


def test_the_real_sizes_are_those_of_the_format():
    assert SIZES == (256, 2048)


@pytest.mark.slow
def test_patches_can_be_written_in_any_order_within_a_level(tmp_path, surface, stored):
    path = tmp_path / "n.zarr"
    lay_out(path, surface)
    work = patches(surface.shape)
    assert len(set(work)) == len(work)
    for _, of_level in itertools.groupby(work, lambda patch: patch.level):
        for patch in reversed(list(of_level)):
            write_patch(path, surface, patch)
    for level in range(4):
        assert_same_surface(ZarrMosaic.open(path).window(level=level), stored.window(level=level))


def test_a_mosaic_goes_to_another_process_by_its_path(stored, surface):
    copy = pickle.loads(pickle.dumps(stored))
    assert_same_surface(copy.window(), surface)


def test_a_new_mosaic_takes_the_place_of_the_old_one(tmp_path):
    other = make_surface(rows=20, cols=30, seed=9)
    for source in (make_surface(), other):
        write_mosaic(tmp_path / "m.zarr", source)
    assert_same_surface(ZarrMosaic.open(tmp_path / "m.zarr").window(), other)
    assert [p.name for p in tmp_path.iterdir()] == ["m.zarr"]


def test_stopped_work_leaves_the_place_as_it_was(tmp_path, surface):
    fractions = []
    with pytest.raises(DatasetError, match="Writing the mosaic was stopped at 3 of"):
        write_mosaic(tmp_path / "m.zarr", surface, fractions.append, lambda: len(fractions) == 3)
    assert list(tmp_path.iterdir()) == []


def test_a_tiny_surface_has_two_levels(tmp_path):
    tiny = make_surface(rows=1, cols=3)
    stored = write_mosaic(tmp_path / "m.zarr", tiny)
    assert stored.levels == 2
    assert stored.window(level=1).shape == (1, 2)


@pytest.mark.slow
def test_sixteen_bit_grey_is_kept(tmp_path):
    surface = make_surface(grey=np.uint16)
    assert_same_surface(write_mosaic(tmp_path / "m.zarr", surface).window(), surface)


def test_deeper_grey_than_a_mosaic_has_room_for_is_refused(tmp_path, surface):
    lay_out(tmp_path / "m.zarr", surface)
    deep = dataclasses.replace(surface, all_in_focus=surface.all_in_focus.astype(np.uint16))
    with pytest.raises(DatasetError, match="holds uint8 and not uint16: stitch fields of one kind of camera"):
        write_patch(tmp_path / "m.zarr", deep, patches(surface.shape)[0])


def test_memory_is_that_of_shards_not_of_the_surface(stored, source):
    assert source.largest == 64 * 64


def test_a_folder_that_is_no_mosaic(tmp_path):
    with pytest.raises(DatasetError, match="is not a mosaic of Wafer Viewer"):
        ZarrMosaic.open(tmp_path)
    stored = write_mosaic(tmp_path / "m.zarr", make_surface())
    (stored.path / "origin/0/zarr.json").unlink()
    with pytest.raises(DatasetError, match="origin/0 is missing or damaged: stitch the fields again"):
        stored.window()
    group = json.loads((stored.path / "zarr.json").read_bytes())
    del group["attributes"]["wafer_viewer"]["rows"]
    (stored.path / "zarr.json").write_text(json.dumps(group))
    with pytest.raises(DatasetError, match=r"zarr\.json is damaged, its checksum differs"):
        ZarrMosaic.open(stored.path)
    del group["attributes"]["crc32c"]
    (stored.path / "zarr.json").write_text(json.dumps(group))
    with pytest.raises(DatasetError, match="rows"):
        ZarrMosaic.open(stored.path)
    (stored.path / "zarr.json").write_text("{")
    with pytest.raises(DatasetError, match="is not a mosaic of Wafer Viewer, or is damaged"):
        ZarrMosaic.open(stored.path)


# ---------------------------------------------------------------------------------------------- other readers


def test_independent_readers_see_the_same_pixels(stored, surface):
    tensorstore = pytest.importorskip("tensorstore")
    for name, level in itertools.product(("z_um", "overlap_um", "all_in_focus", "origin"), (0, 2)):
        ours = stored.read(name, level, *all_of(stored, level))
        with_zarr = zarr.open_array(stored.path / name / str(level), mode="r")
        place = {"driver": "file", "path": str(stored.path / name / str(level))}
        with_tensorstore = tensorstore.open({"driver": "zarr3", "kvstore": place}).result()
        np.testing.assert_array_equal(with_zarr[:], ours)
        np.testing.assert_array_equal(with_tensorstore.read().result(), ours)
        assert with_tensorstore.domain.labels == ("y", "x")
    np.testing.assert_array_equal(stored.read("z_um", 0, *all_of(stored, 0)), surface.z_um)


def all_of(stored, level):
    return tuple(slice(0, n) for n in stored.header.shape_of(level))


@pytest.mark.slow
def test_each_layer_is_an_image_of_the_format(stored):
    models = pytest.importorskip("ome_zarr_models.v05")
    root = zarr.open_group(stored.path, mode="r")
    assert {name for name, _ in root.members()} == {*zarr_shards.FILLS, "facts"}
    for name in zarr_shards.FILLS:
        image = models.Image.from_zarr(root[name])
        scales = [d.coordinateTransformations for d in image.attributes.ome.multiscales[0].datasets]
        assert len(scales) == (stored.levels - 1 if name in zarr_shards.FROM_LEVEL_1 else stored.levels)


def test_the_root_is_an_image_of_the_format_with_a_pyramid_for_each_layer(stored):
    models = pytest.importorskip("ome_zarr_models.v05")
    image = models.Image.from_zarr(zarr.open_group(stored.path, mode="r"))
    multiscales = image.attributes.ome.multiscales
    assert [one.name for one in multiscales] == list(zarr_shards.FILLS)
    assert multiscales[0].name == "z_um"
    for one in multiscales:
        alone = models.Image.from_zarr(zarr.open_group(stored.path / one.name, mode="r")).attributes.ome.multiscales[0]
        places = [dataset.coordinateTransformations for dataset in one.datasets]
        assert places == [dataset.coordinateTransformations for dataset in alone.datasets]
        assert [d.path for d in one.datasets] == [f"{one.name}/{d.path}" for d in alone.datasets]


@pytest.mark.slow
@pytest.mark.parametrize("layer", ["", "all_in_focus"])
def test_another_reader_sees_every_level_where_it_lies_on_the_stage(stored, surface, layer):
    ngff_zarr = pytest.importorskip("ngff_zarr")
    images = ngff_zarr.from_ngff_zarr(str(stored.path / layer), version="0.5").images
    assert len(images) == stored.levels
    for level, image in enumerate(images):
        ours = stored.window(level=level)
        assert image.dims == ("y", "x")
        assert image.axes_units == {"y": "micrometer", "x": "micrometer"}
        for axis, um in (("x", ours.x_um), ("y", -ours.y_um)):
            n = image.data.shape[image.dims.index(axis)]
            np.testing.assert_allclose(image.translation[axis] + np.arange(n) * image.scale[axis], um, atol=1e-9)
        np.testing.assert_array_equal(np.asarray(image.data), getattr(ours, layer or "z_um"))


@pytest.mark.slow
def test_two_mosaics_lie_beside_each_other_as_on_the_stage(stored, tmp_path, surface):
    ngff_zarr = pytest.importorskip("ngff_zarr")
    right_um, up_um = 300.0, 40.0
    moved = dataclasses.replace(surface, x0_um=surface.x0_um + right_um, y0_um=surface.y0_um + up_um)
    other = write_mosaic(tmp_path / "m.zarr", moved)
    a, b = (ngff_zarr.from_ngff_zarr(str(one.path), version="0.5").images[0].translation for one in (stored, other))
    assert (b["x"] - a["x"], b["y"] - a["y"]) == pytest.approx((right_um, -up_um))


def test_other_programs_may_write_shards_that_we_read(stored, tmp_path, surface):
    copy = shutil.copytree(stored.path, tmp_path / "m.zarr")
    array = zarr.open_array(copy / "z_um" / "0", mode="r+")
    array[:] = surface.z_um + 1
    np.testing.assert_array_equal(ZarrMosaic.open(copy).window().z_um, surface.z_um + 1)


def test_threads_make_the_same_mosaic(stored, tmp_path, surface):
    copy = write_mosaic(tmp_path / "m.zarr", surface, threads=3)
    for level in range(stored.levels):
        assert_same_surface(copy.window(level=level), stored.window(level=level))


@pytest.mark.slow
def test_the_differences_of_overlaps_are_kept_and_averaged_on_the_way_up(tmp_path, surface):
    overlap = np.full(surface.shape, np.nan, np.float32)
    overlap[40:60, 80:100] = 2.0
    overlap[50:60] *= 3
    stored = write_mosaic(tmp_path / "m.zarr", dataclasses.replace(surface, overlap_um=overlap))
    np.testing.assert_array_equal(stored.window().overlap_um, overlap)
    assert np.nanmax(stored.window(level=2).overlap_um) == 6.0
    assert stored.window(level=2).overlap_um[12, 20] == pytest.approx(4.0)
    assert np.isnan(stored.window(level=2).overlap_um[0, 0])
    assert not (stored.path / "overlap_um/0/c/1/0").exists()
    assert stored.facts().overlaps_um.size > 0


def test_uncertainties_are_kept_and_averaged_on_the_way_up(tmp_path, surface):
    u_um = np.full(surface.shape, np.nan, np.float32)
    u_um[40:60, 80:100] = 0.2
    u_um[50:60] *= 3
    stored = write_mosaic(tmp_path / "m.zarr", dataclasses.replace(surface, u_um=u_um))
    np.testing.assert_array_equal(stored.window().u_um, u_um)
    assert stored.window(level=2).u_um[12, 20] == pytest.approx(0.4)
    assert np.isnan(stored.window(level=2).u_um[0, 0])


@pytest.mark.parametrize("layer", ["u_um", "n_origin"])
def test_a_mosaic_without_a_layer_is_named_with_the_mend(tmp_path, surface, layer):
    stored = write_mosaic(tmp_path / "m.zarr", surface)
    shutil.rmtree(stored.path / layer)
    with pytest.raises(DatasetError, match=rf"m\.zarr/{layer}.* is missing or damaged: stitch the fields again"):
        ZarrMosaic.open(stored.path).layers(1, slice(0, 8), slice(0, 8))


@pytest.mark.slow
def test_a_small_defect_is_seen_at_the_top(tmp_path):
    rng = np.random.default_rng(2)
    flat = make_surface(rows=400, cols=500, pixel_um=0.5)
    z = rng.normal(0, 0.01, flat.shape).astype(np.float32)
    z[200:203, 300:303], z[90:93, 90:93] = 12.0, -7.0
    z[300:340, 100:140] = np.nan
    origin = np.where(np.isnan(z), Origin.NO_TEXTURE, Origin.MEASURED).astype(np.uint8)
    stored = write_mosaic(tmp_path / "m.zarr", dataclasses.replace(flat, z_um=z, z_raw_um=z, origin=origin))
    low, high = stored.span(None, stored.levels - 1)
    assert (np.nanmin(low), np.nanmax(high)) == (-7.0, 12.0)
    coarse = stored.window(level=stored.levels - 1)
    assert np.nanmax(np.abs(coarse.z_um)) < 2.0
    assert (stored.facts().lowest_um, stored.facts().highest_um) == (-7.0, 12.0)
