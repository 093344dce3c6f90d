"""Texture of surfaces whose parameters are known, with filters, with holes, and what is said of it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from tests.support.surfaces import PIXEL_UM, calibration, coordinates, noise_of, surface_of
from wafer_viewer.measure.texture.areal_texture import texture
from wafer_viewer.model.acquisition.calibration import OpticalSetup
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.recipe import Recipe

SHAPE = 240, 300
FACE = Region.rectangle(-74.9, -59.9, 74.9, 59.9)
"""All of it: 150 um by 120 um, ten and eight waves of 15 um."""


def lattice():
    return np.meshgrid(*coordinates(*SHAPE))


def wave(period_um, amplitude_um=1.0, turned_deg=0.0):
    """Waves that run along x, or turned from it counter-clockwise."""
    x_um, y_um = lattice()
    along = np.cos(np.deg2rad(turned_deg)) * x_um + np.sin(np.deg2rad(turned_deg)) * y_um
    return amplitude_um * np.cos(2 * np.pi * along / period_um)


def smooth_noise(seed=1, sigma_px=3.0):
    noise = gaussian_filter(np.random.default_rng(seed).normal(size=SHAPE), sigma_px)
    return noise / noise.std()


def holed(z_um, share=0.2, seed=5):
    """Single pixels and one large hole are not measured."""
    left = z_um.copy()
    left[np.random.default_rng(seed).random(z_um.shape) < share - 0.02] = np.nan
    left[50:88, 60:98] = np.nan
    return left


def of(z_um, region=FACE, **options):
    return texture(surface_of(z_um), region, **options)


def test_a_sine_has_the_heights_and_slopes_of_the_textbook():
    found = of(wave(15) + 0.01 * lattice()[0])
    assert found.sa.value_um == pytest.approx(2 / np.pi, rel=4e-3)
    assert found.sq.value_um == pytest.approx(1 / np.sqrt(2), rel=1e-5)
    assert found.sdq == pytest.approx(2 * np.pi / 15 / np.sqrt(2), rel=3e-3)
    slope = 2 * np.pi / 15 * np.cos(np.linspace(0, 2 * np.pi, 1000, endpoint=False))
    assert found.sdr_fraction == pytest.approx(np.mean(np.sqrt(1 + slope**2)) - 1, rel=5e-3)


def test_a_sine_has_the_volumes_of_its_material_ratio_curve():
    """The curve of a sine of amplitude 1 is cos(pi mr), whose integrals are known."""

    def material(mr):
        return np.sin(np.pi * mr) / np.pi - mr * np.cos(np.pi * mr)

    def void(mr):
        return np.sin(np.pi * mr) / np.pi + (1 - mr) * np.cos(np.pi * mr)

    found = of(wave(15.37, turned_deg=31.0), form_order=0)
    true = {
        "vmp": material(0.1),
        "vmc": material(0.8) - material(0.1),
        "vvc": void(0.1) - void(0.8),
        "vvv": void(0.8),
        "sxp": np.cos(0.025 * np.pi),
    }
    assert {name: getattr(found, name).value_um for name in true} == pytest.approx(true, abs=4e-3)
    assert found.vmp.value_um == pytest.approx(0.003257, rel=0.02)


@pytest.mark.parametrize(
    ("period_px", "neighbours", "seven"), [(15, 0.0073, 0.004), (10, 0.0164, 0.005), (6, 0.045, 0.015)]
)
def test_slopes_of_short_waves_are_truer_through_seven_pixels(period_px, neighbours, seven):
    z_um = wave(period_px * PIXEL_UM, amplitude_um=0.05)
    slope = 0.05 * 2 * np.pi / (period_px * PIXEL_UM)
    along = slope * np.cos(np.linspace(0, 2 * np.pi, 4096, endpoint=False))
    sdq, sdr = slope / np.sqrt(2), np.mean(np.sqrt(1 + along**2)) - 1
    plain, truer = of(z_um), of(z_um, slopes="seven_point")
    assert truer.sdq == pytest.approx(sdq, rel=seven)
    assert truer.sdr_fraction == pytest.approx(sdr, rel=2.5 * seven)
    assert plain.sdq == pytest.approx(sdq * (1 - neighbours), rel=3e-3)
    assert truer.sq == plain.sq
    assert any("through seven pixels" in note for note in truer.notes)
    assert any("neighbouring pixels" in note for note in plain.notes)


def test_slopes_through_seven_pixels_need_all_of_them():
    z_um = 0.02 * lattice()[0] + smooth_noise() * 0.01
    full, left = of(z_um, slopes="seven_point"), of(holed(z_um, 0.05), slopes="seven_point")
    assert left.sdq == pytest.approx(full.sdq, rel=0.05)
    with pytest.raises(MeasureError, match=r"TextureOptions.slopes is 'five': it must be one of 'neighbours', 'seven"):
        of(z_um, slopes="five")


@pytest.mark.parametrize("turned_deg", [0.0, 30.0, 90.0, 137.0])
def test_a_grating_has_a_lay_and_its_direction(turned_deg):
    found = of(wave(10, turned_deg=turned_deg) + 0.1 * smooth_noise())
    assert found.str_ratio < 0.05
    assert abs((found.std.value - turned_deg + 90) % 180 - 90) < 0.6
    assert found.sal.value_um == pytest.approx(10 * np.arccos(0.2) / (2 * np.pi), rel=0.02)
    assert any("Str is an upper limit" in note for note in found.notes)


def test_even_noise_has_no_lay_and_its_length_of_correlation():
    found = of(smooth_noise())
    assert found.str_ratio > 0.85
    assert found.std is None
    assert found.sal.value_um == pytest.approx(2 * 3 * PIXEL_UM * np.sqrt(np.log(5)), rel=0.1)


def test_normal_heights_have_the_core_of_normal_heights():
    """The flattest 40 % of a normal distribution lie from 30 to 70 %: its line of least squares gives Sk."""
    from scipy.special import ndtri

    ratio = np.linspace(0.3, 0.7, 4001)
    sk = -np.polyfit(ratio, ndtri(1 - ratio), 1)[0]
    found = of(np.random.default_rng(2).normal(size=SHAPE))
    assert found.sk.value_um == pytest.approx(sk, rel=0.01)
    assert found.spk.value_um == pytest.approx(found.svk.value_um, rel=0.05)
    assert found.smr1_fraction == pytest.approx(1 - found.smr2_fraction, abs=0.005)


def test_deep_scratches_show_in_the_valleys_only():
    plateau = 0.02 * smooth_noise()
    plateau[:, ::20] -= 1.0
    found = of(plateau)
    assert found.svk.value_um > 10 * found.spk.value_um
    assert found.ssk < -2


@pytest.mark.parametrize("kind", ["s_filter_um", "l_filter_um"])
@pytest.mark.parametrize("turned_deg", [0, 90])
def test_half_of_a_wave_at_the_cut_off_passes(kind, turned_deg):
    """Of the region as a whole to five per cent, for filters end differently at its border."""
    found = of(wave(15, turned_deg=turned_deg), **{kind: 15.0})
    assert found.sq.value_um == pytest.approx(0.5 / np.sqrt(2), rel=0.05)
    assert found.filter == f"Gaussian (ISO 16610-61), {kind[0].upper()} 15 um"


def test_filters_part_roughness_from_waviness():
    """As much of each wave is left as the norm says."""
    found = of(wave(4, 0.2) + wave(75, 1.0), s_filter_um=2.0, l_filter_um=12.0)
    rough, wavy = 0.2 * 2 ** -((2 / 4) ** 2), 1 - 2 ** -((12 / 75) ** 2)
    assert found.sq.value_um == pytest.approx(np.hypot(rough, wavy) / np.sqrt(2), rel=0.03)
    assert (found.options.s_filter_um, found.options.l_filter_um) == (2.0, 12.0)


@pytest.mark.parametrize("order", [0, 1, 2, 4])
def test_form_of_an_order_is_taken_off_and_no_more(order):
    x_um, y_um = (v / 100 for v in lattice())
    noise = 0.01 * smooth_noise()
    of_order = of(noise + (x_um + 0.5 * y_um) ** order, form_order=order)
    assert of_order.sq.value_um == pytest.approx(0.01, rel=0.05)
    assert of(noise + x_um ** (order + 1), form_order=order).sq.value_um > 0.012
    assert str(order) in of_order.notes[0] if order > 1 else "Form removed" in of_order.notes[0]


PARAMETERS = ("sa", "sq", "sk", "spk", "svk", "sal")


@pytest.mark.parametrize("options", [{}, {"form_order": 3, "s_filter_um": 2.5, "l_filter_um": 40.0}])
def test_a_fifth_of_holes_leaves_every_parameter_as_it_is(options):
    """To two per cent; an S-filter of five pixels has slopes of its own round single holes, to five."""
    z_um = smooth_noise() + 0.5 * wave(12, turned_deg=20) + 0.02 * lattice()[1]
    full, found = of(z_um, **options), of(holed(z_um), **options)
    assert found.measured_fraction == pytest.approx(0.8, abs=0.01)
    for name in PARAMETERS:
        assert getattr(found, name).value_um == pytest.approx(getattr(full, name).value_um, rel=0.02), name
    slopes = 0.05 if options else 0.02
    assert found.sdq == pytest.approx(full.sdq, rel=slopes)
    assert found.sdr_fraction == pytest.approx(full.sdr_fraction, rel=2.5 * slopes)
    assert found.str_ratio == pytest.approx(full.str_ratio, rel=0.04)


def test_what_lies_outside_of_a_round_region_does_not_count():
    x_um, y_um = lattice()
    z_um = np.where(np.hypot(x_um, y_um) < 50, smooth_noise(), 50.0)
    assert of(z_um, Region.circle(0, 0, 49)).sz.value_um < 10


def test_a_flat_surface_has_neither_slopes_nor_waves():
    found = of(np.full(SHAPE, 12.0))
    assert (found.sal, found.str_ratio, found.std) == (None, None, None)
    assert (found.sdq, found.sdr_fraction, found.sk.value_um) == (0, 0, 0)


def observed(z_um, *, window=9, z_step_um=4.0, peak="blur_law", objective="10x/0.28", **options):
    """As a scan would give it."""
    held = replace(calibration(), setup=OpticalSetup(objective=objective))
    recipe = Recipe(window=window, peak=peak)
    surface = surface_of(z_um, calibration=held, recipe=recipe, z_step_um=z_step_um)
    return texture(surface, FACE, **options).notes


def test_a_scale_that_optics_cannot_see_is_reported():
    z_um = wave(15)
    assert any(
        "S-filter is 2 um" in n and "focus window of 9 pixels: take 4.5 um" in n for n in observed(z_um, s_filter_um=2)
    )
    assert not any("cannot be seen" in n for n in observed(z_um, s_filter_um=5))
    assert any("Waves under 4.5 um cannot be seen" in n for n in observed(z_um))
    by_lens = observed(z_um, window=3, objective="5x/0.10", s_filter_um=2)
    assert any("waves under 2.75 um" in n and "aperture of 0.1" in n for n in by_lens)


@pytest.mark.parametrize(
    ("peak", "amplitude_um", "warned"), [("blur_law", 0.1, True), ("argmax", 0.7, True), ("blur_law", 0.7, False)]
)
def test_heights_near_the_noise_of_the_sweep_are_reported(peak, amplitude_um, warned):
    notes = observed(wave(15, amplitude_um), peak=peak)
    assert any("much of it is noise" in note for note in notes) == warned


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"s_filter_um": 0.0}, "s_filter_um is 0.0: it must be over 0"),
        ({"l_filter_um": -80.0}, "l_filter_um is -80.0: it must be over 0"),
        ({"s_filter_um": 80.0, "l_filter_um": 80.0}, "must be under l_filter_um, which is 80"),
        ({"form_order": -1}, "form_order is -1: it must be between 0 and 8"),
        ({"l_filter_um": 121.0}, "L-filter of 121 um is longer than the face, 120 um at its narrowest"),
        ({"s_filter_um": 500.0}, "S-filter of 500 um is longer than the face"),
    ],
)
def test_filters_that_make_no_sense_are_one_sentence(options, sentence):
    with pytest.raises(MeasureError, match=sentence) as refused:
        of(smooth_noise(), **options)
    assert str(refused.value).count(". ") == 0


def test_points_on_a_line_have_no_form_of_high_order():
    z_um = np.full(SHAPE, np.nan)
    z_um[40:43, :] = noise_of(1, (3, 300), 0.1)
    with pytest.raises(MeasureError, match="do not determine a form of order 4"):
        of(z_um, Region.rectangle(-74.9, 38.6, 74.9, 39.9), form_order=4)
