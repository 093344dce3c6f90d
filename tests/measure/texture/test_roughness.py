"""Roughness along lines whose parameters are known, with cut-offs, gaps, and what is said of it."""

from __future__ import annotations

import numpy as np
import pytest

from tests.support.surfaces import PIXEL_UM, coordinates, noise_of, surface_of
from wafer_viewer.measure.registry import measured
from wafer_viewer.measure.texture.roughness import roughness
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.measurement.tool_options import RoughnessOptions
from wafer_viewer.model.measurement.tools import ToolOptions
from wafer_viewer.model.region import Region

SHAPE = 40, 1200
ALONG = Region.line(-299.75, 0.25, 299.75, 0.25)
"""600 um, all of the row."""


def x_um():
    return np.meshgrid(*coordinates(*SHAPE))[0]


def wave(period_um, amplitude_um=1.0):
    return amplitude_um * np.cos(2 * np.pi * x_um() / period_um)


def of(z_um, line=ALONG, **options):
    return roughness(surface_of(z_um), line, **options)


def test_a_sine_has_the_parameters_of_the_textbook():
    found = of(wave(20) + 0.01 * x_um() + 7)
    assert found.ra.value_um == pytest.approx(2 / np.pi, rel=3e-3)
    assert found.rq.value_um == pytest.approx(1 / np.sqrt(2), rel=1e-3)
    assert found.rt.value_um == found.rz.value_um == pytest.approx(2, rel=0.01)
    assert found.rku == pytest.approx(1.5, rel=0.01)
    assert (found.sections, found.filter, found.main) == (1, "none", found.ra.quantity)
    assert any("waviness included" in note for note in found.notes)


def test_slopes_and_core_of_a_line_are_those_of_the_textbook():
    found = of(wave(4, 0.1))
    assert found.rdq == pytest.approx(0.1 * 2 * np.pi / 4 / np.sqrt(2), rel=0.005)
    normal = of(noise_of(5, SHAPE, 1.0))
    assert (normal.rk.value_um, normal.rpk.value_um, normal.rvk.value_um) == pytest.approx((2.56, 0.85, 0.85), abs=0.25)
    assert normal.rmr1_fraction == pytest.approx(0.1, abs=0.04)
    assert normal.rmr2_fraction == pytest.approx(0.9, abs=0.04)
    gaps = 0.02 * x_um() + wave(8, 0.1)
    gaps[:, ::9] = np.nan
    assert of(gaps).rdq == pytest.approx(0.1 * 2 * np.pi / 8 / np.sqrt(2), rel=0.05)


def test_a_cut_off_parts_roughness_from_waviness():
    found = of(wave(5, 0.2) + wave(300, 2.0), lambda_c_um=50.0, lambda_s_um=2.5)
    rough, wavy = 0.2 * 2 ** -((2.5 / 5) ** 2), 2 * (1 - 2 ** -((50 / 300) ** 2))
    assert found.rq.value_um == pytest.approx(np.hypot(rough, wavy) / np.sqrt(2), rel=0.05)
    assert found.filter == "Gaussian (ISO 16610-21), lambda-s 2.5 um, lambda-c 50 um"
    assert (found.sections, found.section_um, found.points) == (5, 50.0, 500)


def test_half_of_a_wave_at_the_cut_off_passes():
    """The line is long enough to leave its ends to the filter: exactly half."""
    assert of(wave(50), lambda_c_um=50.0).rq.value_um == pytest.approx(0.5 / np.sqrt(2), rel=1e-3)


def test_rz_is_the_mean_of_sections_and_rt_of_all():
    z_um = noise_of(3, SHAPE, 0.01)
    z_um[:, 600] += 1.0
    found = of(z_um, lambda_c_um=100.0)
    assert found.rt.value_um == pytest.approx(1.0, rel=0.1)
    assert found.rz.value_um < 0.35
    assert found.rz.value_um == pytest.approx(found.rp.value_um + found.rv.value_um)
    assert found.rsk > 5


def test_fewer_sampling_lengths_than_five_are_reported():
    found = of(wave(5), lambda_c_um=290.0)
    assert found.sections == 2
    assert any("2 of 5 sampling lengths" in note for note in found.notes)
    assert any("ISO 16610-28" in note for note in found.notes)
    assert not any("of 5 sampling" in note for note in of(wave(5), lambda_c_um=100.0).notes)


def test_a_fifth_of_gaps_leaves_the_numbers_as_they_are():
    z_um = wave(20) + wave(300) + noise_of(2, SHAPE, 0.1, 6.0)
    gaps = z_um.copy()
    gaps[:, np.random.default_rng(1).random(SHAPE[1]) < 0.15] = np.nan
    gaps[:, 400:460] = np.nan
    full, found = of(z_um, lambda_c_um=60.0), of(gaps, lambda_c_um=60.0)
    assert found.measured_fraction == pytest.approx(0.76, abs=0.06)
    assert found.ra.value_um == pytest.approx(full.ra.value_um, rel=0.03)
    assert found.rq.value_um == pytest.approx(full.rq.value_um, rel=0.03)


def test_the_tool_takes_its_options_and_a_wide_line_is_averaged_across():
    line = Region.line(-299.75, 0.25, 299.75, 0.25, width_um=10 * PIXEL_UM)
    options = ToolOptions(roughness=RoughnessOptions(lambda_c_um=80.0))
    narrow = measured(surface_of(noise_of(1, SHAPE, 0.1)), "roughness", (ALONG,), False, options)
    wide = measured(surface_of(noise_of(1, SHAPE, 0.1)), "roughness", (line,), False, options)
    assert wide.main.value == pytest.approx(narrow.main.value / np.sqrt(10), rel=0.2)
    assert wide.filter.endswith("mean over 5 um across the line")


@pytest.mark.parametrize(
    ("line", "options", "sentence"),
    [
        (ALONG, {"lambda_c_um": 700.0}, "lambda-c of 700 um is longer than the line, 599.5 um"),
        (ALONG, {"lambda_s_um": 700.0}, "lambda-s of 700 um is longer than the line"),
        (ALONG, {"lambda_c_um": 0.0}, "lambda_c_um is 0.0: it must be over 0"),
        (ALONG, {"lambda_s_um": -2.0}, "lambda_s_um is -2.0: it must be over 0"),
        (ALONG, {"lambda_s_um": 50.0, "lambda_c_um": 50.0}, "must be under lambda_c_um, which is 50"),
        (ALONG, {"lambda_c_um": 5.0}, "A section of the line, 5 um, has 10 measured points and roughness needs 20"),
        (Region.line(900, 0, 950, 0), {}, "lies outside of the surface"),
        (Region.line(0, 0, 0, 0), {}, "begins and ends at"),
        (Region.rectangle(0, 0, 5, 5), {}, "needs a line, this region is a rectangle"),
        (Region.line(0, 5, 280, 5), {}, r"Only \d+ % of the line is measured and roughness needs 50 %"),
        (Region.line(-5, 0.25, 3, 0.25), {}, "has 17 measured points and roughness needs 20"),
    ],
)
def test_what_cannot_be_measured_is_one_sentence(line, options, sentence):
    z_um = wave(20)
    z_um[:18, 700:] = np.nan
    with pytest.raises(MeasureError, match=sentence):
        of(z_um, line, **options)
