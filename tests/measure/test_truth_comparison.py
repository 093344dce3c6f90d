"""The figures of an evaluation against other people's formulas."""

from __future__ import annotations

import dataclasses
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray
from scipy.signal import convolve2d
from scipy.stats import pearsonr
from skimage.metrics import mean_squared_error, peak_signal_noise_ratio

import wafer_viewer as wv
from tests.support.surfaces import height_map
from wafer_viewer.measure.truth_comparison import Quality, compare_with_truth, quality, smoothness
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.surface.height_map import HeightMap, Origin

ROWS, COLS = 40, 60


@pytest.fixture(scope="module")
def truth_um() -> NDArray:
    rows, cols = np.indices((ROWS, COLS))
    return 100 + 0.8 * cols + 0.3 * rows


@pytest.fixture(scope="module")
def found_um(truth_um: NDArray) -> NDArray:
    return truth_um + np.random.default_rng(1).normal(0.4, 2.0, truth_um.shape)


def test_error_correlation_and_peak_signal_to_noise_are_those_of_other_libraries(truth_um, found_um):
    got = quality(found_um, truth_um, 4.0)
    assert got.rmse_um == pytest.approx(np.sqrt(mean_squared_error(truth_um, found_um)))
    assert got.corr == pytest.approx(pearsonr(truth_um.ravel(), found_um.ravel()).statistic)
    assert got.peak_um == pytest.approx(np.ptp(truth_um))
    assert got.psnr_db == pytest.approx(peak_signal_noise_ratio(truth_um, found_um, data_range=np.ptp(truth_um)))
    assert quality(found_um, truth_um, 4.0, peak_um=255.0).psnr_db == pytest.approx(
        peak_signal_noise_ratio(truth_um, found_um, data_range=255.0)
    )


def test_smoothness_is_the_printed_equation_by_convolutions(found_um):
    xx = convolve2d(found_um, [[1], [-2], [1]], "valid")[:, 1:-1]
    yy = convolve2d(found_um, [[1, -2, 1]], "valid")[1:-1, :]
    xy = convolve2d(found_um, [[1, -1], [-1, 1]], "valid")[1:, 1:]
    assert smoothness(found_um) == pytest.approx(np.mean(xx**2 + 2 * xy**2 + 2 * yy**2))


def test_a_plane_is_perfectly_smooth_and_its_tilt_is_no_error_of_form(truth_um):
    assert smoothness(truth_um) == pytest.approx(0, abs=1e-20)


def test_unmeasured_pixels_count_for_completeness_alone(truth_um, found_um):
    holed = found_um.copy()
    holed[:10] = np.nan
    got = quality(holed, truth_um, 4.0)
    assert got.completeness_fraction == 0.75
    assert got.rmse_um == pytest.approx(np.sqrt(mean_squared_error(truth_um[10:], found_um[10:])))
    assert got.ssm_um2 == pytest.approx(smoothness(found_um[10:]))
    assert got.peak_um == pytest.approx(np.ptp(truth_um))


def test_pixels_without_a_truth_do_not_count(truth_um, found_um):
    unknown = truth_um.copy()
    unknown[:, :30] = np.nan
    got = quality(found_um, unknown, 4.0)
    assert got.n_px == ROWS * 30
    assert got.completeness_fraction == 1
    assert got.rmse_um == pytest.approx(np.sqrt(mean_squared_error(truth_um[:, 30:], found_um[:, 30:])))


def test_false_is_more_than_the_tolerance_off(truth_um):
    found = truth_um + 1.0
    found[:4] += 50.0
    got = quality(found, truth_um, 4.0)
    assert got.false_fraction == pytest.approx(0.1)
    assert got.true_rmse_um == pytest.approx(1.0)
    assert got.bias_um == pytest.approx(1.0)


def test_the_truth_itself_is_perfect(truth_um):
    got = quality(truth_um, truth_um, 4.0)
    assert (got.rmse_um, got.psnr_db, got.false_fraction, got.completeness_fraction) == (0, np.inf, 0, 1)
    assert got.corr == pytest.approx(1)


def test_a_map_without_heights_has_zero_completeness(truth_um):
    got = quality(np.full_like(truth_um, np.nan), truth_um, 4.0)
    assert got.completeness_fraction == 0
    assert all(np.isnan([got.rmse_um, got.corr, got.psnr_db, got.false_fraction, got.ssm_um2]))


def test_a_truth_without_heights_compares_no_pixels(truth_um):
    got = quality(truth_um, np.full_like(truth_um, np.nan), 4.0)
    assert got.n_px == 0
    assert np.isnan(got.completeness_fraction)


def test_a_flat_truth_has_no_range_and_no_correlation(found_um):
    got = quality(found_um, np.full_like(found_um, 100.0), 4.0)
    assert np.isnan([got.corr, got.psnr_db]).all()
    assert np.isfinite(got.rmse_um)


@given(
    arrays(np.float64, (7, 9), elements=st.integers(-32_000, 32_000).map(lambda n: n / 64)),
    arrays(np.bool_, (7, 9)),
    st.integers(-6400, 6400).map(lambda n: n / 64),
)
def test_an_offset_of_everything_changes_nothing_but_its_own(error, holes, offset):
    truth = np.add.outer(np.arange(7.0), np.arange(9.0))
    z = np.where(holes, np.nan, truth + error)
    first, moved = quality(z, truth, 4.0), quality(z + offset, truth + offset, 4.0)
    for name in ("completeness_fraction", "rmse_um", "bias_um", "psnr_db"):
        assert getattr(moved, name) == pytest.approx(getattr(first, name), rel=1e-6, abs=1e-6, nan_ok=True)


def test_errors_grow_towards_an_edge(truth_um):
    distance = np.abs(np.indices((ROWS, COLS))[1] - 29.5)
    found = truth_um + 20.0 / (distance + 1)
    found[distance < 2] = np.nan
    masks = [(distance >= low) & (distance < high) for low, high in pairwise((0, 2, 5, 10, 20, np.inf))]
    bands = [quality(found, np.where(mask, truth_um, np.nan), 4.0) for mask in masks]
    assert sum(b.n_px for b in bands) == truth_um.size
    assert bands[0].completeness_fraction == 0
    assert [b.rmse_um for b in bands[1:]] == sorted((b.rmse_um for b in bands[1:]), reverse=True)
    inside = masks[1]
    assert bands[1].rmse_um == pytest.approx(np.sqrt(np.mean((found - truth_um)[inside] ** 2)))
    assert bands[1].false_fraction == pytest.approx(np.mean((20.0 / (distance + 1) > 4)[inside]))


def a_map(z_um: NDArray, raw_um: NDArray, origin: NDArray) -> HeightMap:
    return height_map(z_um, 0.5, z_raw_um=raw_um, origin=origin.astype(np.uint8), z_step_um=4.0)


def test_a_height_map_is_compared_by_what_measurements_use(truth_um):
    origin = np.zeros(truth_um.shape)
    origin[:10] = Origin.FILLED
    raw = np.where(origin == Origin.FILLED, np.nan, truth_um + 1)
    height = a_map(truth_um + 3, raw, origin)
    got = wv.compare_with_truth(height, truth_um)
    assert isinstance(got, Quality)
    assert (got.tolerance_um, got.completeness_fraction) == (4.0, 0.75)
    assert got.rmse_um == pytest.approx(1.0, rel=1e-4)
    filled = compare_with_truth(height, truth_um, count_filled=True)
    assert filled.completeness_fraction == 1
    assert filled.rmse_um == pytest.approx(3.0, rel=1e-4)
    assert compare_with_truth(height, truth_um, tolerance_um=0.5).false_fraction == 1


def test_another_shape_and_no_tolerance_are_refused_in_one_sentence(truth_um):
    with pytest.raises(MeasureError, match=r"shape \(40, 59\) cannot be compared with a truth of shape \(40, 60\)"):
        quality(truth_um[:, 1:], truth_um, 4.0)
    with pytest.raises(MeasureError, match="tolerance is 0"):
        quality(truth_um, truth_um, 0)


def test_figures_cannot_be_changed(truth_um):
    with pytest.raises(dataclasses.FrozenInstanceError):
        quality(truth_um, truth_um, 4.0).rmse_um = 0
