"""The fields of a stitched surface as images in place, opened by a program of another origin."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

import wafer_viewer as wv
from tests.support.datasets.grid_dataset import REGISTERED, RESULT, add_surfaces, make_dataset
from tests.truth.field_grid import SMALL, make
from wafer_viewer.cli.app import main
from wafer_viewer.session.surface.stitching_job import bring_up_to_date
from wafer_viewer.store.mosaic.zarr_shards import COARSEST_PX

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def made():
    return make(dataclasses.replace(SMALL, rows=2, cols=3, field_rows=560, field_cols=600))


@pytest.fixture(scope="module")
def dataset(made, tmp_path_factory):
    path = make_dataset(tmp_path_factory.mktemp("fields") / "grid.wafer", made)
    add_surfaces(path, made, range(len(made.fields)))
    bring_up_to_date(path, RESULT, REGISTERED)
    return path


@pytest.fixture(scope="module")
def scene(dataset, tmp_path_factory):
    out = tmp_path_factory.mktemp("scene") / "grid.ome.zarr"
    assert main(["fields", str(dataset), str(out)]) == 0
    return out


def opened(path):
    ngff_zarr = pytest.importorskip("ngff_zarr")
    return ngff_zarr.from_ome_zarr(str(path), kind="scene", validate=True)


def places_um(scene, system):
    """(y, x) of the first pixel of each image, by its path."""
    placed = [t for t in scene.coordinateTransformations if t.output.name == system]
    return {t.input.path: np.array(t.translation) for t in placed}


@pytest.mark.campaign(at_least_one=True)
@pytest.mark.parametrize(("channel", "layer"), [(0, "all_in_focus"), (1, "z_um")])
def test_another_program_puts_the_fields_where_the_mosaic_has_them(dataset, scene, channel, layer):
    theirs = opened(scene)
    mosaic = wv.Dataset.open(dataset).result().mosaic().window()
    ours = getattr(mosaic, layer).astype(float)
    places = places_um(theirs, "stitched")
    assert len(places) == 6
    for path, (_, y_um, x_um) in places.items():
        image = theirs.images[path].images[0]
        assert (list(image.dims), image.axes_units["x"]) == (["c", "y", "x"], "micrometer")
        shown = np.asarray(image.data)[channel, 100:-100, 100:-100]  # without the overlaps
        row = round((mosaic.y0_um + y_um) / mosaic.pixel_um) + 100
        col = round((x_um - mosaic.x0_um) / mosaic.pixel_um) + 100
        off = {
            (down, right): shown - ours[row + down :, col + right :][: shown.shape[0], : shown.shape[1]]
            for down in (-2, 0, 2)
            for right in (-2, 0, 2)
        }
        scatter = {place: np.nanstd(difference) for place, difference in off.items()}
        assert min(scatter, key=scatter.__getitem__) == (0, 0)
        assert abs(np.nanmean(off[0, 0])) < 0.02 * np.nanstd(ours)


def test_channels_are_named_and_shown_alike_in_all_fields(scene):
    shown = [image.metadata.omero.channels for image in opened(scene).images.values()]
    assert [channel.label for channel in shown[0]] == ["all_in_focus", "z_um"]
    assert all(channels == shown[0] for channels in shown)


def test_the_positions_by_the_stage_are_a_system_of_their_own(dataset, scene, made):
    theirs = opened(scene)
    assert [one.name for one in theirs.coordinateSystems] == ["stitched", "stage"]
    stitched, stage = (places_um(theirs, system) for system in ("stitched", "stage"))
    poses = wv.Dataset.open(dataset).result().poses()
    moved = np.array([stitched[path] - stage[path] for path in stage])
    np.testing.assert_allclose(moved[:, 2], poses.x_um - poses.stage_x_um, atol=1e-9)
    np.testing.assert_allclose(moved[:, 1], -(poses.y_um - poses.stage_y_um), atol=1e-9)
    assert abs(moved).max() > 1.0


def test_levels_lie_in_place_until_the_image_is_small(scene):
    for field in opened(scene).images.values():
        assert max(field.images[-1].data.shape[1:]) <= COARSEST_PX
        for level, image in enumerate(field.images):
            pixel_um = field.images[0].scale["x"]
            assert image.scale["x"] == pytest.approx(pixel_um * 2**level)
            assert image.translation["y"] == pytest.approx(pixel_um * (2**level - 1) / 2)


def test_the_pose_with_its_uncertainty_is_in_the_image(dataset, scene):
    poses = wv.Dataset.open(dataset).result().poses()
    for n, number in enumerate(poses.numbers):
        name = wv.Dataset.open(dataset).field(int(number)).name
        about = json.loads((scene / name / "zarr.json").read_text())["attributes"]["wafer_viewer"]
        assert (about["numbers"], about["x_um"], about["u_x_um"]) == (number, poses.x_um[n], poses.u_x_um[n])


def test_what_cannot_be_written_is_said(dataset, scene, tmp_path, made):
    with pytest.raises(wv.WaferViewerError, match=r"exists already: give the name of a new folder"):
        wv.write_fields(dataset, scene)
    with pytest.raises(wv.WaferViewerError, match=r"not the name of a scene: give one such as out\.ome\.zarr"):
        wv.write_fields(dataset, tmp_path / "out.npz")
    with pytest.raises(wv.WaferViewerError, match=r"has no stitched surface 'default': stitch it first"):
        wv.write_fields(make_dataset(tmp_path / "new.wafer", made), tmp_path / "new.ome.zarr")
    with pytest.raises(wv.WaferViewerError, match=r"Writing the fields was stopped at 0 of 6"):
        wv.write_fields(dataset, tmp_path / "stopped.ome.zarr", should_stop=lambda: True)
    assert [path.name for path in tmp_path.iterdir()] == ["new.wafer"]
