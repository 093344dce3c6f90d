"""Peaks, material ratios, cut borders and profile elements of surfaces whose parameters are known."""

from __future__ import annotations

import numpy as np
import pytest

from tests.measure.texture.test_areal_texture import FACE, lattice, of, smooth_noise, wave
from tests.measure.texture.test_roughness import of as along
from tests.measure.texture.test_roughness import wave as wave_along
from tests.measure.texture.test_roughness import x_um
from tests.support.surfaces import calibration, noise_of, surface_of
from wafer_viewer.measure.texture.areal_texture import texture
from wafer_viewer.measure.texture.features import peaks_of
from wafer_viewer.measure.texture.roughness import roughness
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import replace

PERIOD_UM = 20.0


def egg_box(period_um=PERIOD_UM, amplitude_um=1.0):
    """Peaks of a height and curvature that are known, two for each square of the period."""
    x, y = lattice()
    return amplitude_um * np.cos(2 * np.pi * (x - 3) / period_um) * np.cos(2 * np.pi * (y + 2) / period_um)


def peaks_inside():
    """Number of peaks of the egg box more than a pixel within the face."""
    n = np.arange(-20, 20)
    inside = [
        np.count_nonzero(np.abs(3 + PERIOD_UM * (n + shift)) < 74)
        * np.count_nonzero(np.abs(-2 + PERIOD_UM * (n + shift)) < 59)
        for shift in (0.0, 0.5)
    ]
    return sum(inside)


def test_an_egg_box_has_the_peaks_of_the_textbook():
    found = of(egg_box(), form_order=0)
    assert found.s5p.value_um == pytest.approx(1, abs=0.01)
    assert found.s5v.value_um == pytest.approx(1, abs=0.01)
    assert found.s10z.value_um == pytest.approx(found.s5p.value_um + found.s5v.value_um)
    assert found.spd_per_mm2 * found.points * 0.5**2 / 1e6 == pytest.approx(peaks_inside())
    assert found.spc_per_mm == pytest.approx(1000 * (2 * np.pi / PERIOD_UM) ** 2, rel=0.01)


@pytest.mark.parametrize(("height", "peaks"), [(0.04, 1), (0.06, 2)])
def test_a_hill_under_five_percent_of_sz_belongs_to_its_neighbour(height, peaks):
    x = np.arange(60.0)
    ridge = np.interp(x, [0, 20, 30, 40, 59], [0, 1, 0.5, 0.5 + height, 0])
    z_um = ridge[:, None] * np.clip(1 - np.abs(np.arange(40) - 20.0) / 20, 0, 1)[None] ** 0.1
    assert len(peaks_of(z_um, 0.05).rows) == peaks


def test_peaks_at_the_border_and_beside_holes_do_not_count():
    z_um = egg_box()
    whole = peaks_of(z_um, 0.1)
    assert len(whole.rows) == peaks_inside()
    z_um[whole.rows[0] + 1, whole.cols[0]] = np.nan
    assert len(peaks_of(z_um, 0.1).rows) == len(whole.rows) - 1
    ramp = np.add.outer(np.arange(30.0), np.arange(30.0))
    assert len(peaks_of(ramp, 1.0).rows) == 0


def test_fewer_than_five_peaks_have_no_mean_of_five():
    x, y = lattice()
    found = of(np.exp(-(x**2 + y**2) / 200), form_order=0)
    assert found.s5p is None
    assert found.s10z is None
    assert found.spd_per_mm2 * found.points * 0.25 / 1e6 == pytest.approx(1)


def test_material_ratios_of_a_sine_are_those_of_its_curve():
    found = of(wave(15.37, turned_deg=31.0), form_order=0, c_um=0.5, mr_percent=10.0)
    assert found.smr_fraction == pytest.approx(np.arccos(0.5) / np.pi, abs=2e-3)
    assert found.smc.value_um == pytest.approx(np.cos(0.1 * np.pi), abs=4e-3)
    silent = of(wave(15.37), form_order=0)
    assert (silent.smr_fraction, silent.smc) == (None, None)


@pytest.mark.slow
def test_without_its_borders_a_filter_passes_half_at_the_cut_off():
    """A wave whose mean over what there is of the filter is furthest off at the border."""
    x, _ = lattice()
    z_um = np.sin(2 * np.pi * x / 30 + 0.7)
    inner = np.abs(x[0]) < 75 - 15
    true = np.sqrt(np.mean((0.5 * np.sin(2 * np.pi * x[0][inner] / 30 + 0.7)) ** 2))
    kept, cut = (of(z_um, form_order=0, l_filter_um=30.0, borders=borders).sq.value_um for borders in ("keep", "cut"))
    assert cut == pytest.approx(true, rel=0.01)
    assert abs(kept - true) > 2 * abs(cut - true)


@pytest.mark.slow
def test_cut_borders_follow_the_outline_and_leave_holes_alone():
    z_um = smooth_noise()
    z_um[100:110, 100:110] = np.nan
    whole, cut = (of(z_um, l_filter_um=20.0, borders=borders) for borders in ("keep", "cut"))
    assert whole.points == 240 * 300 - 100
    assert cut.points == (240 - 40) * (300 - 40) - 100
    assert any("is not evaluated" in note for note in cut.notes)
    with pytest.raises(MeasureError, match="Without its borders too little"):
        of(z_um, l_filter_um=119.0, borders="cut")


def test_a_sine_has_elements_of_its_period_and_twice_its_height():
    found = along(wave_along(17.3, 0.8))
    assert found.rsm.value_um == pytest.approx(17.3, rel=2e-3)
    assert found.rc.value_um == pytest.approx(1.6, rel=5e-3)


def test_elements_lower_than_a_tenth_of_rz_belong_to_their_neighbours():
    ripple = 0.03 * np.sin(2 * np.pi * x_um() / 2.1)
    found = along(wave_along(40, 1.0) + ripple)
    assert found.rsm.value_um == pytest.approx(40, rel=0.01)
    high = along(wave_along(100, 0.5) + np.sin(2 * np.pi * x_um() / 24))
    assert high.rsm.value_um == pytest.approx(24, rel=0.02)
    narrow = along(wave_along(40, 1.0) + 30 * ripple)
    assert narrow.rsm.value_um == pytest.approx(40, rel=0.02), "hills under 1 % of the line"


def test_a_line_without_a_complete_element_has_neither_rsm_nor_rc():
    found = along(np.broadcast_to(np.abs(x_um()), x_um().shape) ** 2 / 1000)
    assert (found.rsm, found.rc) == (None, None)


def test_cut_ends_shorten_the_line_by_a_cut_off():
    z_um = wave_along(5, 0.2)
    whole, cut = (along(z_um, lambda_c_um=110.0, borders=borders) for borders in ("keep", "cut"))
    assert (whole.sections, cut.sections) == (5, 4)
    assert any("at each end is not evaluated" in note for note in cut.notes)


def with_own_u(z_um, u_um):
    surface = surface_of(z_um, z_step_um=1.0, calibration=calibration(0.0))
    return replace(surface, u_um=np.full(np.shape(z_um), u_um, np.float32))


NAMES = ("sa", "sq", "sz", "sk", "vmc", "s10z")


@pytest.mark.campaign
def test_u_by_the_uncertainty_of_the_heights_covers_what_noise_does():
    true = of(egg_box(), form_order=0)
    covered, sharp = dict.fromkeys(NAMES, 0), list[float]()
    n = 10
    for seed in range(n):
        found = texture(with_own_u(egg_box() + noise_of(seed, egg_box().shape, 0.1), 0.1), FACE, form_order=0)
        for name in NAMES:
            length = getattr(found, name)
            error_um = abs(length.value_um - getattr(true, name).value_um)
            covered[name] += error_um <= length.expanded_um
            sharp.append(length.expanded_um / getattr(true, name).value_um)
    assert min(covered.values()) >= 0.9 * n, covered
    assert max(sharp) < 0.7


@pytest.mark.campaign
def test_u_of_roughness_by_the_uncertainty_of_the_heights_covers_what_noise_does():
    line, names, n = Region.line(-299.75, 0.25, 299.75, 0.25), ("ra", "rq", "rz", "rsm", "rk"), 30
    true = along(wave_along(17.3, 0.8), lambda_c_um=100.0)
    covered = dict.fromkeys(names, 0)
    for seed in range(n):
        z_um = wave_along(17.3, 0.8) + noise_of(seed, wave_along(20).shape, 0.05)
        found = roughness(with_own_u(z_um, 0.05), line, lambda_c_um=100.0)
        for name in names:
            length = getattr(found, name)
            covered[name] += abs(length.value_um - getattr(true, name).value_um) <= length.expanded_um
    assert min(covered.values()) >= 0.9 * n, covered


@pytest.mark.campaign
def test_a_given_noise_is_taken_instead_and_heights_without_uncertainty_have_no_u():
    own = texture(with_own_u(egg_box(), 0.1), FACE)
    given = texture(with_own_u(egg_box(), 0.1), FACE, noise_um=0.02)
    assert given.sq.expanded_um < own.sq.expanded_um
    assert any("from the uncertainty of the heights" in note for note in own.notes)
    without = texture(surface_of(egg_box(), z_step_um=1.0, calibration=calibration(0.0)), FACE)
    assert without.sq.status == "not evaluated"
    assert any("U needs the noise" in note for note in without.notes)
