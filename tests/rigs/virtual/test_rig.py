"""The virtual rig whole, with its own optics."""

from __future__ import annotations

import numpy as np
import pytest

from wafer_viewer.acquire.pulse_reconciliation import reference_axes
from wafer_viewer.model.acquisition.plan import PulseTrain
from wafer_viewer.model.acquisition.sample import Sample
from wafer_viewer.rigs.virtual import rig as virtual_rig
from wafer_viewer.rigs.virtual.rig import VIRTUAL_MOUNT, VirtualRig, virtual_limits

ON_COMMAND = PulseTrain(axis="z", first_count=0, counts_per_frame=100, n_frames=100, direction=1)


def picture(rig, z_um, exposure_us=100.0):
    rig.stage.move_to(z_um=z_um)
    rig.camera.start(exposure_us)
    reference_axes(rig)
    rig.box.arm(ON_COMMAND, on_command=True)
    rig.box.fire()
    image = rig.camera.next_image(1.0).image
    rig.box.disarm()
    return image


@pytest.fixture
def stair():
    rig = VirtualRig("stair", limits=virtual_limits(96, 128), seed=4)
    yield rig
    rig.close()


@pytest.mark.slow
def test_it_sees_the_scene_sharp_where_the_truth_is(stair):
    stair.stage.move_to(x_um=90.0, y_um=40.0)
    truth_um = float(stair.truth_for_tests(90.0, 40.0))
    heights_um = truth_um + np.arange(-12.0, 13.0, 2.0)
    detail = [float(np.var(np.diff(picture(stair, z)[30:60, 40:80].astype(float)))) for z in heights_um]
    assert heights_um[int(np.argmax(detail))] == pytest.approx(truth_um, abs=2.0)


def test_a_longer_exposure_is_brighter(stair):
    short, long = picture(stair, 0.0, 50.0), picture(stair, 0.0, 100.0)
    assert long.mean() == pytest.approx(2 * short.mean(), rel=0.1)


def test_it_takes_the_same_picture_again_when_switched_on_again():
    limits, pictures = virtual_limits(96, 128), []
    for _ in range(2):
        rig = VirtualRig("stair", limits=limits, seed=4)
        pictures.append(picture(rig, 3.0))
        rig.close()
    np.testing.assert_array_equal(*pictures)


@pytest.mark.slow
def test_its_overview_shows_the_sample_where_it_lies():
    rig = VirtualRig("wafer")
    seen = rig.overview()
    rig.close()
    rows, cols = seen.image.shape
    left, right = seen.x0_um, seen.x0_um + (cols - 1) * seen.pixel_um
    top, bottom = seen.y0_um, seen.y0_um - (rows - 1) * seen.pixel_um
    assert left == pytest.approx(-right, abs=1e-6)
    assert top == pytest.approx(-bottom, abs=seen.pixel_um)
    assert min(x for x, _ in seen.outline_um) == pytest.approx(left, abs=2 * seen.pixel_um)
    assert len(seen.dies_um) > 50
    assert seen.image[rows // 2].std() > 5
    assert "wafer" in seen.title


def test_overview_is_drawn_once_for_a_state_of_the_sources(monkeypatch, tmp_path):
    drawn = []

    def draw(sample, width_px):
        drawn.append(sample.name)
        return np.full((width_px, width_px), len(drawn), np.uint8)

    monkeypatch.setenv("WAFER_VIEWER_CACHE", str(tmp_path))
    monkeypatch.setattr(virtual_rig, "overview", draw)
    first, second, other = (virtual_rig.scene_overview(name).image for name in ("stair", "stair", "cone"))
    np.testing.assert_array_equal(first, second)
    assert (drawn, other[0, 0]) == (["stair", "cone"], 2)
    (stored,) = tmp_path.rglob("*stair*")
    stored.write_bytes(stored.read_bytes()[:100])
    assert virtual_rig.scene_overview("stair").image[0, 0] == 3
    monkeypatch.setattr(virtual_rig, "kernel_state", lambda: "of an edited scene")
    assert virtual_rig.scene_overview("stair").image[0, 0] == 4
    assert virtual_rig.scene_overview("stair").image[0, 0] == 4
    (tmp_path / "file").touch()
    monkeypatch.setenv("WAFER_VIEWER_CACHE", str(tmp_path / "file"))
    assert virtual_rig.scene_overview("stair").image[0, 0] == 5


def test_a_closed_rig_is_at_rest(stair):
    stair.stage.start("x", 5_000.0, 1_000.0)
    stair.close()
    stair.stage.wait()
    assert stair.stage.position().x_um < 100.0


@pytest.mark.slow
def test_it_loads_the_sample_that_a_job_for_it_names_and_else_its_own(stair):
    own = stair.overview().title
    tour = Sample(product="cone", mount=VIRTUAL_MOUNT)
    assert stair.load_sample(tour)
    assert not stair.load_sample(tour), "it lies there already"
    assert stair.overview().title != own
    assert float(stair.truth_for_tests(0.0, 0.0)) == pytest.approx(120.0)
    assert stair.load_sample(Sample(product="cone", mount="chuck")), "a sample of somebody else's"
    assert stair.overview().title == own
    assert not stair.load_sample(None)
