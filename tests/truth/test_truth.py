"""The truth generator against what is known of light: what it makes is what other tests are judged by."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.support.campaigns import drawn_after
from tests.truth.layouts import HELD_OUT, TUNING, A, scene_of, take
from tests.truth.scene import PIXEL_UM, TruthScene
from tests.truth.scenes import BLOCKS_STEP_UM, SCENES, STEP_SWEEP_UM, band, dies, plane, rim, stair, step
from tests.truth.views import Camera, Optics, light_of, stack_from, stack_of

SMALL = (48, 56)
LEVEL_UM = 201.3


def level(grey: float = 0.4, side: int = 48) -> TruthScene:
    """A level sheet of even grey."""
    scene = band(1, (side, side))
    scene.reflectance[:] = grey
    return scene


def two_halves(step_um: float, left: float, right: float, side: int = 64) -> TruthScene:
    """A wall along the middle column, the right half higher; both halves of even grey."""
    scene = step(1, (side, side), step_um)
    scene.reflectance[0], scene.reflectance[1] = left, right
    return scene


def spread_px(light: NDArray) -> tuple[float, float]:
    """Deviation of a spot of light along rows and columns."""
    rows, cols = np.indices(light.shape)
    weight = light / light.sum()
    return tuple(float(np.sqrt(np.sum(weight * (at - np.sum(weight * at)) ** 2))) for at in (rows, cols))


@pytest.mark.slow
def test_an_even_sheet_is_equally_bright_at_every_height():
    light = light_of(level(), Optics(views=40), np.array([0.0, 150.0, LEVEL_UM, 400.0]))
    np.testing.assert_allclose(light, 0.4, rtol=1e-4)


@pytest.mark.slow
def test_light_is_neither_lost_nor_made_by_defocus():
    scene = plane(3, (200, 200), tilt=0.0)
    light = light_of(scene, Optics(views=60), LEVEL_UM + np.array([-20.0, 0.0, 20.0]))[:, 40:-40, 40:-40]
    means = light.mean(axis=(1, 2))
    assert means == pytest.approx(means[1], rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("off_um", "na"),
    [
        (12.0, 0.28),
        *(pytest.param(*one, marks=pytest.mark.campaign) for one in product((0.0, 12.0, 30.0), (0.28, 0.40))),
    ],
)
def test_a_point_out_of_focus_spreads_as_the_aperture_says(off_um: float, na: float):
    scene = level(1e-9, side=96)
    middle = scene.margin_px + 48
    scene.reflectance[0, middle, middle] = 1.0
    optics = Optics(na, views=400)
    # A uniform disc of radius r has a deviation of r / 2 along each axis; a tangent grows a little faster than a sine.
    disc_um = off_um * na / np.sqrt(1 - na**2) / 2
    point_px = 1 / 6  # variance of a single bilinear point
    pixel_px = 1 / 12
    expected = np.sqrt((disc_um**2 + optics.diffraction_um**2) / PIXEL_UM**2 + point_px + pixel_px)
    light = light_of(scene, optics, np.array([LEVEL_UM - off_um, LEVEL_UM + off_um]))
    for spot in light:
        assert spread_px(spot) == pytest.approx((expected, expected), rel=0.06)


@pytest.mark.slow
def test_a_surface_is_sharpest_in_the_frame_at_its_height():
    scene = plane(5, SMALL, tilt=0.0)
    z_um = LEVEL_UM + 2.0 * np.arange(-6, 7)
    sharpness = np.var(np.diff(light_of(scene, Optics(views=80), z_um), axis=2), axis=(1, 2))
    assert sharpness.argmax() == 6
    np.testing.assert_allclose(sharpness, sharpness[::-1], rtol=0.1)
    assert sharpness[6] > 10 * sharpness[0]


@pytest.mark.slow
def test_focus_does_not_depend_on_where_the_sweep_lies():
    scene = plane(5, SMALL, tilt=0.0)
    sharp = [light_of(scene, Optics(views=80), z_um)[1] for z_um in (LEVEL_UM + np.array(z) for z in SWEEPS)]
    np.testing.assert_allclose(np.std(sharp[0]), np.std(sharp[1]), rtol=0.01)
    assert np.corrcoef(sharp[0].ravel(), sharp[1].ravel())[0, 1] > 0.998


SWEEPS = ([-100.0, 0.0, 20.0], [-4.0, 0.0, 60.0])


@pytest.mark.slow
def test_light_of_a_bright_trench_reaches_a_dark_die_only_out_of_focus():
    scene = two_halves(60.3, left=0.6, right=0.1)
    low = float(scene.truth_um[0, 0])
    in_focus, out_of_focus = light_of(scene, Optics(views=100), np.array([low + 60.3, low + 160.0]))
    assert in_focus[:, 37:42].mean() == pytest.approx(0.1, rel=0.02)
    assert out_of_focus[:, 37:42].mean() > 0.3
    assert out_of_focus[:, -1].mean() > 0.15


@pytest.mark.slow
def test_a_wall_hides_a_part_of_the_aperture():
    scene = two_halves(60.3, left=0.6, right=0.0)
    low = float(scene.truth_um[0, 0])
    light = light_of(scene, Optics(views=400), np.array([low, low + 1]))[0].mean(axis=0)
    at_the_foot = light[28:31].mean()
    assert at_the_foot == pytest.approx(0.6 / 2, rel=0.2)
    # 60.3 um beside a wall of 60.3 um nothing is hidden at NA 0.28; half of the way some is.
    far = light_of(two_halves(10.3, 0.6, 0.0, side=160), Optics(views=100), np.array([194.0, 195.0]))[0].mean(axis=0)
    assert far[5:60].mean() == pytest.approx(0.6, rel=0.02)
    assert at_the_foot < light[10] < 0.6


@dataclass(frozen=True)
class Pinhole(Optics):
    """One direction only."""

    lean: float = 0.0

    def pupil(self):
        return np.array([self.lean]), np.array([0.0]), np.array([1.0])


@pytest.mark.slow
def test_a_rim_in_focus_is_sharp_before_a_ground_that_is_not():
    scene = two_halves(90.3, left=0.6, right=0.1)
    top = float(scene.truth_um[0, -1])
    edge = light_of(scene, Optics(), np.array([top, top + 1]))[0].mean(axis=0)
    sigma_px = np.hypot(Optics().diffraction_um / PIXEL_UM, np.sqrt(1 / 12))
    steepest = (edge[28] - edge[38]) / (np.sqrt(2 * np.pi) * sigma_px)
    assert np.abs(np.diff(edge)).max() == pytest.approx(steepest, rel=0.15)


@pytest.mark.parametrize(("glossy", "alike"), [(False, True), (True, False)])
def test_a_specular_trench_sends_each_view_something_else(glossy: bool, alike: bool):
    scene = dies(8, (40, 40), glossy=glossy, pitch_px=600, trench_px=400)
    z_um = np.array([float(np.median(scene.truth_um))] * 2)
    one, other = (light_of(scene, Pinhole(views=1, lean=lean), z_um)[0].ravel() for lean in (-0.2, 0.2))
    assert (np.corrcoef(one, other)[0, 1] > 0.95) == alike


@pytest.mark.slow
def test_a_polished_rim_shines():
    settings = {"pitch_px": 90.0, "trench_px": 30.0, "die_contrast": 0.0}
    dull, shining = dies(4, (90, 90), roll_um=7.0, **settings), rim(4, (90, 90), **settings)
    z_um = np.array([60.0, float(np.median(dull.truth_um[dull.layer == 1]))])
    line = (dull.layer == 1) & (dull.edge_distance_px > 8) & (dull.edge_distance_px < 14)
    bright, dark = (light_of(scene, Optics(views=60), z_um)[1][line] for scene in (shining, dull))
    assert bright.max() > 3 * dark.max()


@pytest.mark.slow
def test_the_same_seed_gives_the_same_bits_and_another_one_does_not():
    z_um = 100.0 + 20.0 * np.arange(4)
    optics = Optics(views=10)
    first, again = (stack_of(dies(3, SMALL), optics, z_um, seed=5).images for _ in range(2))
    np.testing.assert_array_equal(first, again)
    assert (stack_of(dies(3, SMALL), optics, z_um, seed=6).images != first).mean() > 0.1
    assert (dies(4, SMALL).truth_um != dies(3, SMALL).truth_um).any()


@pytest.mark.slow
def test_frames_do_not_depend_on_tiles(monkeypatch: pytest.MonkeyPatch):
    scene, optics, z_um = dies(3, SMALL), Optics(views=10), np.array([100.0, 140.0, 180.0])
    full = light_of(scene, optics, z_um)
    monkeypatch.setattr("tests.truth.views.TILE_PX", 30)
    np.testing.assert_allclose(light_of(scene, optics, z_um), full, atol=2e-3)


@pytest.mark.parametrize("full_well_e", [4_000.0, 15_000.0, 60_000.0, None])
def test_noise_is_that_of_the_full_well_and_of_a_third_of_a_grey_level(full_well_e: float | None):
    camera = Camera(full_well_e, clipped_share=0.0, bits=16)
    light = np.full((2, 200, 200), 0.5, np.float32)
    counts = camera.shoot(light, 1.0, seed=2).astype(float) / 257
    shot = 0.0 if full_well_e is None else 255 * np.sqrt(0.5 / full_well_e)
    assert counts.std() == pytest.approx(np.hypot(shot, 1 / 3), rel=0.02)
    assert counts.mean() == pytest.approx(127.5, rel=0.001)


def test_the_share_that_is_clipped_is_the_one_requested():
    scene = plane(3, SMALL, tilt=0.0)
    z_um = LEVEL_UM + np.array([-4.0, 0.0, 4.0])
    light = light_of(scene, Optics(views=40), z_um)
    stack = stack_from(scene, light, z_um, Camera(clipped_share=0.11))
    assert stack.images.dtype == np.uint8
    assert (stack.images[1] == 255).mean() == pytest.approx(0.11, abs=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENES)
def test_every_scene_has_a_truth_on_the_lattice_of_its_frames(name: str):
    scene = SCENES[name](2, SMALL)
    assert scene.truth_um.shape == scene.edge.shape == scene.textured.shape == scene.shape == SMALL
    assert np.isfinite(scene.truth_um).all()
    assert scene.truth_um.min() > 40
    assert scene.truth_um.max() < 360


def test_the_gauge_blocks_step_fits_their_sweep():
    scene = step(1, SMALL, BLOCKS_STEP_UM)
    heights = np.unique(scene.truth_um)
    assert np.ptp(heights) == pytest.approx(BLOCKS_STEP_UM, abs=1e-3)
    assert STEP_SWEEP_UM[0] + 40 < heights.min()
    assert heights.max() < STEP_SWEEP_UM[-1] - 40


def test_a_stair_hides_what_is_behind_its_risers():
    scene = stair(1, (40, 120), treads=3)
    assert np.unique(scene.truth_um).size == 3
    scene.reflectance[0], scene.reflectance[1], scene.reflectance[2] = 0.2, 0.4, 0.8
    light = light_of(scene, Optics(views=60), np.array([100.0, float(scene.truth_um[0, 60])]))[1].mean(axis=0)
    assert light[45:60].mean() == pytest.approx(0.4, rel=0.1)
    assert light[100:].mean() == pytest.approx(0.8, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("name", drawn_after(1, [*TUNING, *HELD_OUT]))
def test_every_layout_shows_dies_and_trenches(name):
    layout = {**TUNING, **HELD_OUT}[name]
    scene = scene_of(layout, (240, 240))
    assert 0.2 < (scene.layer == 1).mean() < 0.95
    assert 0.05 < scene.edge.mean() < 0.5


def test_layouts_kept_out_of_the_tuning_share_no_seed_with_those_in_it():
    seeds = [layout.seed for layout in (*TUNING.values(), *HELD_OUT.values())]
    assert len(set(seeds)) == len(seeds)


def test_the_sharp_picture_is_the_best_frame_without_its_noise(tmp_path):
    bright = replace(A, optics=Optics(views=30), scene="plane", settings={"tilt": 0.0}, camera=Camera(1e7))
    taken = take(bright, SMALL, LEVEL_UM + 4.0 * np.arange(-3, 4))
    errors = [np.std(frame - taken.sharp_grey) for frame in taken.stack.images]
    assert int(np.argmin(errors)) == 3
    assert errors[3] < 0.6


@pytest.mark.slow
def test_kept_light_gives_the_stack_that_new_light_gives(tmp_path):
    small = replace(A, optics=Optics(views=6))
    z_um = np.array([100.0, 140.0, 180.0])
    fresh = take(small, SMALL, z_um).stack.images
    for _ in range(2):
        np.testing.assert_array_equal(take(small, SMALL, z_um, keep_in=tmp_path).stack.images, fresh)
    assert len(list(tmp_path.iterdir())) == 1
