"""The virtual microscope blurs by its law and focuses where the surface is; its sensor is as noisy as it should be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import laplace, uniform_filter
from scipy.special import erf

from tests.support.campaigns import examples
from wafer_viewer.model.errors import RigError
from wafer_viewer.rigs.virtual.camera import FrameRenderer, Sensor, flat_field
from wafer_viewer.rigs.virtual.optics.optics import FieldPicture, Optics
from wafer_viewer.rigs.virtual.scenes.catalogue import scene

OPTICS = Optics()
DOT_UM = 0.8


def a_dot(x, y, footprint, out):
    """A Gaussian dot on a dark level plate at z = 0, averaged over the footprint."""
    out.height_a[:] = out.height_b[:] = 0
    out.cover[:] = 1
    out.radiance_a[:] = averaged(x, footprint) * averaged(y, footprint)
    out.radiance_b[:] = 0


def averaged(x, footprint):
    edge = footprint / 2
    scale = DOT_UM * np.sqrt(2)
    return DOT_UM * np.sqrt(np.pi / 2) / footprint * (erf((x + edge) / scale) - erf((x - edge) / scale))


@pytest.mark.parametrize("z_um", [0, 1.5, -3, 5, 9, -14, 30, 60])
def test_a_dot_spreads_by_the_blur_law(z_um):
    dot = replace(scene("plane"), fill=a_dot)
    picture = FieldPicture(dot, OPTICS, 0, 0, 241, 241, (-60, 60)).radiance(z_um)
    column_um = (np.arange(241) - 120) * OPTICS.pixel_um
    light = picture.sum(axis=0, dtype=float)
    variance = np.sum(light * column_um**2) / light.sum()
    assert variance == pytest.approx(DOT_UM**2 + OPTICS.sigma_um(z_um) ** 2, rel=0.02)


def test_the_optics_of_a_10x_objective_are_those_of_the_text_books():
    assert pytest.approx(8.7, abs=0.05) == OPTICS.depth_of_field_um
    assert OPTICS.sigma_um(0) == pytest.approx(0.21 * 0.55 / 0.28)
    assert OPTICS.sigma_um(-100) == pytest.approx(14, rel=0.01)


@pytest.mark.parametrize(("name", "z_um"), [("wafer", 0), ("wafer", 12), ("wafer", 30), ("gauge_blocks", 200)])
def test_neighbouring_fields_show_the_same_light_where_they_overlap(name, z_um):
    sample = scene(name)
    z_range = (sample.z_min_um, sample.z_max_um)
    shift_px = 64
    x, y = sample.tour_center_um
    left = FieldPicture(sample, OPTICS, x, y, 150, 200, z_range).radiance(z_um)
    right = FieldPicture(sample, OPTICS, x + shift_px * OPTICS.pixel_um, y, 150, 200, z_range).radiance(z_um)
    assert np.abs(left[:, shift_px:] - right[:, :-shift_px]).max() * 255 < 0.1


PLACES = {
    "plane": (0, 0),
    "cone": (150, 100),
    "stair": (90, 0),
    "upper block": (-250, 30),
    "lower block": (250, 30),
    "trench floor": (780, 400),
    "memory": (520 + 32 + 44 + 46, 400 + 32 + 78 + 45),
}
SCENE_OF = {"upper block": "gauge_blocks", "lower block": "gauge_blocks", "trench floor": "wafer", "memory": "wafer"}


@pytest.mark.parametrize("place", PLACES)
def test_the_picture_is_sharpest_where_the_surface_is(place):
    sample = scene(SCENE_OF.get(place, place))
    x, y = PLACES[place]
    middle = float(sample.truth(x, y))
    step_um = 2.0
    z_um = middle + step_um * np.arange(-8, 9) + 0.3
    field = FieldPicture(sample, OPTICS, x, y, 64, 96, (z_um[0], z_um[-1]))
    sharpness = [uniform_filter(laplace(field.radiance(z)) ** 2, 9) for z in z_um]
    found = z_um[np.argmax(sharpness, axis=0)]
    inner = (slice(8, -8), slice(8, -8))
    right = np.abs(found - field.truth())[inner] <= step_um
    assert right.mean() > 0.97


def test_light_bleeds_from_the_bright_trench_onto_the_dark_rim_when_out_of_focus():
    rim_x, rim_y = 520 + 32 + 8, 600
    field = FieldPicture(scene("wafer"), OPTICS, rim_x, rim_y, 5, 5, (-10, 100))
    in_focus, far_above = field.radiance(30).mean(), field.radiance(100).mean()
    assert in_focus < 0.05
    assert far_above > 3 * in_focus


@settings(max_examples=examples(12))
@given(radiance=st.floats(0.02, 0.7), well_e=st.sampled_from([2000.0, 10000.0]))
def test_the_noise_of_the_sensor_follows_its_law(radiance, well_e):
    sensor = Sensor(120, 200, well_e=well_e, bits=16)
    light = np.full((120, 200), radiance, np.float32)
    one, other = (sensor.expose(light, 1.0, seed).astype(float) for seed in (1, 2))
    counts = 65535 * radiance * flat_field(120, 200, sensor.seed)
    wanted = np.mean(counts * 65535 / well_e + (65535 * sensor.read_e / well_e) ** 2)
    assert np.var(one - other) / 2 == pytest.approx(wanted, rel=0.05)
    assert np.mean(one - counts) == pytest.approx(0, abs=5 * float(np.sqrt(wanted / one.size)))


def test_too_much_light_is_clipped_to_white():
    light = np.full((20, 30), 0.5, np.float32)
    assert np.all(Sensor(20, 30).expose(light, 10.0, 1) == 255)
    assert np.all(Sensor(20, 30, bits=16).expose(light, 10.0, 1) == 65535)


def test_a_sensor_of_10_bits_is_refused():
    with pytest.raises(RigError, match="10 bits per pixel; choose 8 or 16"):
        Sensor(20, 30, bits=10)


@pytest.fixture
def renderer():
    return FrameRenderer(scene("wafer"), OPTICS, Sensor(90, 120))


def test_a_frame_is_the_same_for_the_same_seed_and_another_for_another(renderer):
    frame = renderer.frame(700, 600, 29, 100, seed=5)
    assert frame.shape == (90, 120)
    assert frame.dtype == np.uint8
    np.testing.assert_array_equal(frame, renderer.frame(700, 600, 29, 100, seed=5))
    again = FrameRenderer(scene("wafer"), OPTICS, Sensor(90, 120)).frame(700, 600, 29, 100, seed=5)
    np.testing.assert_array_equal(frame, again)
    assert np.any(frame != renderer.frame(700, 600, 29, 100, seed=6))


def test_the_scatter_of_a_stage_that_stands_still_prepares_nothing_anew(renderer, monkeypatch):
    prepared = []
    prepare = renderer._prepare
    monkeypatch.setattr(renderer, "_prepare", lambda *place: prepared.append(place) or prepare(*place))
    scatter = np.random.default_rng(3).uniform(-0.02, 0.02, (40, 2))
    for k, (dx, dy) in enumerate(scatter):
        renderer.frame(700 + dx, 600 + dy, float(k), 100, seed=k)
    assert len(prepared) == 1


def test_a_line_pass_sees_the_sample_go_by(renderer):
    here = renderer.frame(700, 600, 29, 100, seed=1).astype(float)
    ten_px_right = renderer.frame(700 + 10 * OPTICS.pixel_um, 600, 29, 100, seed=2).astype(float)
    ten_px_up = renderer.frame(700, 600 + 10 * OPTICS.pixel_um, 29, 100, seed=3).astype(float)
    unmoved = np.abs(here - ten_px_right).mean()
    assert np.abs(here[:, 10:] - ten_px_right[:, :-10]).mean() < unmoved / 2
    assert np.abs(here[:-10] - ten_px_up[10:]).mean() < unmoved / 2


def test_a_longer_exposure_is_brighter_in_proportion(renderer):
    short, long = (renderer.frame(700, 600, 60, us, seed=1).mean() for us in (50, 150))
    assert long / short == pytest.approx(3, rel=0.03)


def test_a_search_for_focus_from_far_above_finds_ever_more_contrast(renderer):
    contrast = [renderer.frame(700, 600, z, 100, seed=1).std() for z in (200, 60, 45, 30)]
    assert contrast == sorted(contrast)
    assert contrast[-1] > 4 * contrast[0]


@pytest.mark.parametrize(("name", "shape"), [("wafer", (150, 150)), ("gauge_blocks", (100, 150))])
def test_the_overview_shows_the_whole_sample(name, shape):
    picture = FrameRenderer(scene(name), OPTICS, Sensor(90, 120)).overview(150)
    assert picture.shape == shape
    assert picture.dtype == np.uint8
    assert picture[shape[0] // 2, 8] > 100


@pytest.mark.parametrize("bits", [8, 16])
def test_hidden_shading_and_black_are_those_asked_for_and_none_by_default(bits):
    radiance = np.full((90, 120), 0.5, np.float32)
    plain = Sensor(90, 120, bits=bits)
    np.testing.assert_array_equal(plain.expose(radiance, 1.0, 3), Sensor(90, 120, bits=bits).expose(radiance, 1.0, 3))
    np.testing.assert_array_equal(flat_field(90, 120, 7), flat_field(90, 120, 7, 0.0))
    hidden = replace(plain, shading_fraction=0.2, black_counts=10).expose(radiance, 1.0, 3).astype(float)
    black = 10 * 2 ** (bits - 8)
    ratio = (hidden - black).mean(axis=0) / plain.expose(radiance, 1.0, 3).mean(axis=0)
    assert ratio[-1] - ratio[0] == pytest.approx(0.2, abs=0.02)
    white = replace(plain, black_counts=10).expose(np.ones((90, 120), np.float32), 5.0, 3)
    assert white.min() == 2**bits - 1, "no counts beyond white"


def test_a_pixel_of_a_distorting_lens_shows_what_lies_nearer_to_the_centre():
    sensor, at = Sensor(121, 121), 20.0
    corner_um = np.hypot(121, 121) / 2 * OPTICS.pixel_um

    def dot_at(x, y, footprint, out):
        a_dot(x - at, y, footprint, out)

    def place_px(distortion):
        made = FrameRenderer(replace(scene("plane"), fill=dot_at), OPTICS, sensor, distortion_fraction=distortion)
        picture = made.frame(0, 0, 0, 100.0, 1).astype(float)
        light = np.maximum(picture - 30, 0)
        return float((light * np.arange(121)).sum() / light.sum()) - 60

    apart_um = place_px(0.05) * OPTICS.pixel_um
    assert apart_um * (1 - 0.05 * (apart_um / corner_um) ** 2) == pytest.approx(at, abs=0.1)
    assert place_px(0.0) * OPTICS.pixel_um == pytest.approx(at, abs=0.1)
