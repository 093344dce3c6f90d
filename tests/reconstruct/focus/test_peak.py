"""Peaks are placed between the frames, and the scores say how much they stand out."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from tests.support.campaigns import examples
from wafer_viewer.model.acquisition.focus_stack import FieldStack
from wafer_viewer.reconstruct.focus.peak import confidence_of, lead_of
from wafer_viewer.reconstruct.focus.peak_interpolation import PEAKS, PeakInterpolation, place
from wafer_viewer.reconstruct.focus.peak_search import Search, search_field
from wafer_viewer.reconstruct.preprocess.frames import prepare

_INNER = slice(12, -12), slice(12, -12)


def _rmse(stack: FieldStack, truth: NDArray, estimator: str) -> float:
    z_um = search_field(prepare(stack), Search("tenengrad", 9, estimator, 4)).z_um
    return float(np.sqrt(np.mean((z_um - truth)[_INNER] ** 2)))


NO_FLOOR = -64.0


def _by(estimator: str, power: float = 2.0) -> PeakInterpolation:
    return PeakInterpolation(PEAKS[estimator].code, power, gap=4, reach=1)


def test_a_tilted_plane_is_found_to_a_fraction_of_a_step(plane_stack: FieldStack, plane_um: NDArray) -> None:
    errors = {name: _rmse(plane_stack, plane_um, name) for name in PEAKS}
    assert errors["tent"] < 0.35
    assert errors["gaussian"] < 0.6
    assert 1.0 < errors["argmax"] < 1.4
    assert errors["blur_law"] < 0.25
    assert errors["blur_law"] < errors["tent"] < errors["gaussian"]


def test_a_missing_frame_costs_little(
    make_stack: Callable[..., FieldStack], plane_stack: FieldStack, plane_um: NDArray
) -> None:
    present = np.ones(21, bool)
    present[[7, 10, 11, 14]] = False
    holed = make_stack(plane_um, plane_stack.z_um, present=present)
    assert _rmse(holed, plane_um, "tent") < 1.5


@pytest.mark.slow
@settings(max_examples=examples(100))
@given(at=st.floats(-0.49, 0.49), below=st.floats(0.5, 4), above=st.floats(0.5, 4), slope=st.floats(0.1, 3))
def test_a_tent_is_found_exactly_at_any_spacing(at: float, below: float, above: float, slope: float) -> None:
    z_um = np.array([-below, 0.0, above])
    peak = at * (below if at < 0 else above)
    left, top, right = 9 - slope * np.abs(z_um - peak)
    assert place(_by("tent"), *z_um, left, top, right, NO_FLOOR) == pytest.approx(peak, abs=1e-9)


@pytest.mark.slow
@settings(max_examples=examples(100))
@given(at=st.floats(-0.49, 0.49), below=st.floats(0.5, 4), above=st.floats(0.5, 4), bend=st.floats(0.1, 3))
def test_a_parabola_is_found_exactly_at_any_spacing(at: float, below: float, above: float, bend: float) -> None:
    z_um = np.array([-below, 0.0, above])
    peak = at * min(below, above)
    left, top, right = 9 - bend * (z_um - peak) ** 2
    assert place(_by("gaussian"), *z_um, left, top, right, NO_FLOOR) == pytest.approx(peak, abs=1e-9)


@settings(max_examples=examples(100))
@given(
    at=st.floats(-0.49, 0.49), below=st.floats(0.5, 4), above=st.floats(0.5, 4), power=st.sampled_from([1.7, 2.0, 3.0])
)
def test_the_blur_law_is_met_exactly_at_any_spacing(at: float, below: float, above: float, power: float) -> None:
    z_um = np.array([-below, 0.0, above])
    peak = at * min(below, above)
    left, top, right = 9 - power * np.log2(2.7**2 + (z_um - peak) ** 2)
    assert place(_by("blur_law", power), *z_um, left, top, right, NO_FLOOR) == pytest.approx(peak, abs=1e-9)


@settings(max_examples=examples(100))
@given(at=st.floats(-0.49, 0.49), power=st.sampled_from([1.7, 2.0, 3.0]), floor=st.floats(-4, 2.5))
def test_the_blur_law_stands_on_a_floor_of_noise(at: float, power: float, floor: float) -> None:
    """The tolerance is that of the quick logarithm."""
    z_um = np.array([-4.0, 0.0, 4.0])
    focus = 2.0**9 * (2.7**2 + (z_um - 4 * at) ** 2) ** -power
    left, top, right = np.log2(focus + 2.0**floor)
    if focus.min() > 0.03 * 2.0**top:
        assert place(_by("blur_law", power), *z_um, left, top, right, floor) == pytest.approx(4 * at, abs=0.01)


def test_the_blur_law_does_not_pull_peaks_to_the_frames(plane_stack: FieldStack, plane_um: NDArray) -> None:
    """The bias against the place between two frames: up to a twentieth of a step for a tent."""

    def bias(estimator: str) -> float:
        z_um = search_field(prepare(plane_stack), Search("tenengrad", 9, estimator, 4)).z_um
        part = ((plane_um - 20.0) / 4.0) % 1
        error, quarter = (z_um - plane_um)[_INNER], ((part > 0.1) & (part < 0.4))[_INNER]
        return abs(float(np.median(error[quarter])))

    assert bias("blur_law") < 0.04
    assert bias("tent") > 0.08


@pytest.mark.parametrize("estimator", PEAKS)
def test_a_flat_curve_stays_at_its_frame(estimator: str) -> None:
    assert place(_by(estimator), 0.0, 4.0, 8.0, 5.0, 5.0, 5.0, NO_FLOOR) == 4.0


def test_the_all_in_focus_image_takes_each_pixel_from_its_frame(plane_stack: FieldStack) -> None:
    peaks = search_field(prepare(plane_stack), Search("tenengrad", 9, "argmax", 4))
    k = np.searchsorted(plane_stack.z_um, peaks.z_um)
    rows, cols = np.indices(k.shape)
    np.testing.assert_array_equal(peaks.all_in_focus, plane_stack.images[k, rows, cols])


def test_confidence_is_what_the_rival_lacks() -> None:
    assert confidence_of(1.0) == 0.5
    assert lead_of(confidence_of(2.5)) == pytest.approx(2.5)
