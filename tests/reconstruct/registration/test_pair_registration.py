"""Where a field lies beside its neighbour, how surely, and when that is not to be believed."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from tests.support.overlapping_tiles import PIXEL_UM, Sample, a_field, a_sample, with_heights, with_picture
from tests.support.surfaces import height_map
from wafer_viewer.model.surface.field_poses import ObservationSource, RejectionReason
from wafer_viewer.model.surface.height_map import HeightMap
from wafer_viewer.reconstruct.registration.pair_registration import PairShift, refine_pair, register, register_pair

SHAPE = (200, 240)
BESIDE, BELOW = (0, 190), (155, 0)


@pytest.fixture(scope="module")
def sample() -> Sample:
    return a_sample((460, 520))


def pair(
    sample: Sample, neighbour: tuple[int, int], off_px: tuple[float, float], seed: int = 5, **noise: float
) -> tuple[HeightMap, HeightMap]:
    first = a_field(sample, 40, 40, SHAPE, seed=seed, **noise)
    return first, a_field(sample, 40 + neighbour[0], 40 + neighbour[1], SHAPE, off_px=off_px, seed=seed + 1, **noise)


def error_px(found: PairShift, off_px: tuple[float, float]) -> NDArray:
    return np.array([-found.y_um / PIXEL_UM - off_px[0], found.x_um / PIXEL_UM - off_px[1]])


@pytest.mark.parametrize("neighbour", [BESIDE, BELOW], ids=["beside", "below"])
@pytest.mark.parametrize("off_px", [(0.0, 0.0), (0.37, -0.5), (-7.4, 11.2), (24.3, 17.8), (-19.6, -31.1)])
def test_a_shift_is_found_to_a_small_part_of_a_pixel(sample, neighbour, off_px):
    found = register_pair(*pair(sample, neighbour, off_px))
    assert (found.doubt, found.by) == (RejectionReason.NONE, ObservationSource.PICTURE)
    assert np.abs(error_px(found, off_px)).max() < 0.06
    assert found.correlation > 0.9


@pytest.mark.slow
def test_the_uncertainty_is_that_of_the_errors(sample):
    rng = np.random.default_rng(3)
    normalised = []
    for n in range(16):
        off = tuple(rng.uniform(-6, 6, 2))
        found = register_pair(*pair(sample, BESIDE, off, seed=10 * n, noise_counts=25.0))
        assert found.doubt is RejectionReason.NONE
        normalised.append(error_px(found, off) * PIXEL_UM / np.array([found.u_y_um, found.u_x_um]))
    assert 0.5 < np.sqrt(np.mean(np.square(normalised))) < 1.4


def test_light_that_differs_does_not_matter(sample):
    off = 3.3, -8.6
    first, second = pair(sample, BESIDE, off)
    falls_off = np.linspace(1.0, 0.8, SHAPE[1])
    darker = with_picture(second, 12 + 0.6 * second.all_in_focus * falls_off)
    assert np.abs(error_px(register_pair(first, darker), off)).max() < 0.06


def test_where_the_picture_is_blank_the_heights_tell(sample):
    off = -4.7, 6.2
    rng = np.random.default_rng(0)
    first, second = (with_picture(h, 90 + rng.normal(0, 2, SHAPE)) for h in pair(sample, BESIDE, off))
    holes = [
        np.where(rng.random(SHAPE) < 0.1, np.nan, h.z_raw_um + 0.004 * np.arange(SHAPE[1])) for h in (first, second)
    ]
    found = register_pair(*(with_heights(h, z) for h, z in zip((first, second), holes, strict=True)))
    assert (found.doubt, found.by) == (RejectionReason.NONE, ObservationSource.HEIGHT)
    assert np.abs(error_px(found, off)).max() < 0.25


@pytest.mark.parametrize("noise_counts", [0.0, 2.0])
def test_blank_overlaps_keep_the_stage_position(sample, noise_counts):
    rng = np.random.default_rng(0)
    blank = [with_picture(h, 90 + rng.normal(0, noise_counts, SHAPE)) for h in pair(sample, BESIDE, (2.0, 2.0))]
    found = register_pair(*(with_heights(h, np.full(SHAPE, np.nan)) for h in blank))
    assert (found.doubt, found.by) == (RejectionReason.BLANK, ObservationSource.STAGE)
    assert (found.x_um, found.y_um, found.u_x_um, found.u_y_um) == (0, 0, np.inf, np.inf)


def test_another_sample_is_unlike(sample):
    other = a_field(a_sample((460, 520), seed=9), 40, 230, SHAPE)
    assert register_pair(pair(sample, BESIDE, (0, 0))[0], other).doubt is RejectionReason.UNLIKE


@pytest.mark.parametrize("turn", [np.fliplr, np.flipud, lambda a: a[::-1, ::-1]])
def test_what_is_mirrored_or_turned_is_unlike(sample, turn):
    first, second = pair(sample, BESIDE, (0, 0))
    held = dataclasses.replace(second, all_in_focus=turn(second.all_in_focus), z_raw_um=turn(second.z_raw_um))
    assert register_pair(first, held).doubt is RejectionReason.UNLIKE


def test_what_repeats_is_ambiguous(sample):
    rows, cols = np.indices((460, 520))
    lines = Sample(110 + 40 * np.sign(np.sin(rows / 2.2) + np.sin(cols / 1.9)), sample.z_um)
    assert register_pair(*pair(lines, BESIDE, (1.5, 2.5))).doubt is RejectionReason.AMBIGUOUS


@pytest.mark.parametrize("period_px", [8.6, 12.8, 21.0])
def test_a_grating_is_never_believed_at_a_wrong_period(sample, period_px):
    rows, cols = np.indices((460, 520)) * 2 * np.pi / period_px
    grating = Sample(0.3 * sample.grey + 80 + 25 * (np.sin(rows) + np.sin(cols)), sample.z_um)
    for seed, off in enumerate([(1.5, 2.5), (-6.3, 4.1), (9.2, -7.7), (-3.4, -11.0)]):
        found = register_pair(*pair(grating, BESIDE, off, seed=seed))
        assert found.doubt is RejectionReason.AMBIGUOUS or np.abs(error_px(found, off)).max() < 0.1


@pytest.mark.parametrize("neighbour", [BESIDE, BELOW], ids=["beside", "below"])
@pytest.mark.parametrize("noise_counts", [0.0, 2.0])
def test_lines_in_one_direction_tell_the_shift_across_them_and_nothing_along(sample, neighbour, noise_counts):
    cols = np.arange(520) / 6
    lines = 110 + 40 * np.clip(8 * (np.sin(cols) + np.sin(cols * 2.3)), -1, 1)
    striped = Sample(np.tile(lines, (460, 1)), sample.z_um)
    found = register_pair(*pair(striped, neighbour, (2.0, 3.5), noise_counts=noise_counts))
    assert found.doubt is RejectionReason.NONE
    assert abs(error_px(found, (2.0, 3.5))[1]) < 0.03
    assert found.u_x_um < 0.5 * PIXEL_UM
    assert found.u_y_um > 100 * PIXEL_UM


def test_slanting_lines_have_a_covariance_of_both_axes(sample):
    rows, cols = np.indices((460, 520))
    across = (rows + cols) / np.sqrt(2) / 5
    striped = Sample(110 + 40 * np.clip(8 * (np.sin(across) + np.sin(across * 2.3)), -1, 1), sample.z_um)
    off = 2.0, 3.5
    found = register_pair(*pair(striped, BESIDE, off, noise_counts=2.0))
    assert found.doubt is RejectionReason.NONE
    down, right = error_px(found, off)
    assert abs(down + right) / np.sqrt(2) < 0.03
    covariance = np.array([[found.u_x_um**2, found.covariance_um2], [found.covariance_um2, found.u_y_um**2]])
    across_um = np.array([1, -1]) / np.sqrt(2)  # x to the right, y up
    assert np.sqrt(across_um @ covariance @ across_um) < 0.1 * PIXEL_UM


@pytest.mark.parametrize("pitch_px", [(31.0, 31.0), (14.3, 22.6), (40.0, 11.2)])
def test_a_pattern_has_all_its_offsets_as_candidates(sample, pitch_px):
    rows, cols = np.indices((460, 520))
    cell = np.sign(np.sin(rows * 2 * np.pi / pitch_px[0]) + 0.4) + np.sign(np.sin(cols * 2 * np.pi / pitch_px[1]) - 0.3)
    dies = Sample(110 + 25 * ndimage.gaussian_filter(cell, 1.2), sample.z_um)
    found = register_pair(*pair(dies, BESIDE, off := (2.4, -3.7), noise_counts=2.0))
    assert found.doubt is RejectionReason.AMBIGUOUS
    at_px = np.column_stack([-found.candidates[:, 1], found.candidates[:, 0]]) / PIXEL_UM
    for i, j in [(0, 0), (1, 0), (0, -1), (-1, 1)]:
        expected = np.add(off, (i * pitch_px[0], j * pitch_px[1]))
        if np.abs(expected).max() < 30:
            assert np.hypot(*(at_px - expected).T).min() < 0.5
    near = refine_pair(*pair(dies, BESIDE, off, noise_counts=2.0), (off[1] * PIXEL_UM + 0.3, -off[0] * PIXEL_UM - 0.3))
    assert near.doubt is RejectionReason.NONE
    assert np.abs(error_px(near, off)).max() < 0.06


def test_a_pattern_may_lie_where_too_little_overlap_is_left_to_be_compared(sample):
    """The fields overlap by 24 px by the stage; where they truly lie, by half of that."""
    rows, cols = np.indices((460, 520))
    cell = np.sign(np.sin(rows * 2 * np.pi / 22) + 0.4) + np.sign(np.sin(cols * 2 * np.pi / 23) - 0.3)
    dies = Sample(110 + 25 * ndimage.gaussian_filter(cell, 1.2), sample.z_um)
    found = register_pair(*pair(dies, (0, 216), off := (-4.0, 13.5), noise_counts=2.0))
    at_px = np.column_stack([-found.candidates[:, 1], found.candidates[:, 0]]) / PIXEL_UM
    assert np.hypot(*(at_px - off).T).min() < 0.7


@pytest.mark.parametrize("pitch_px", [30.0, 33.0])
def test_it_may_lie_there_where_the_pattern_fits_along_one_line_elsewhere(sample, pitch_px):
    """Of the periods across the border only one leaves enough to be compared: it spans no lattice with the true one."""
    rows, cols = np.indices((460, 520)) * 2 * np.pi / pitch_px
    cell = np.sign(np.sin(rows) + 0.4) + np.sign(np.sin(cols) - 0.3)
    dies = Sample(110 + 25 * ndimage.gaussian_filter(cell, 1.2), sample.z_um)
    found = register_pair(*pair(dies, (0, 216), off := (0.3, 9.8), noise_counts=2.0))
    at_px = np.column_stack([-found.candidates[:, 1], found.candidates[:, 0]]) / PIXEL_UM
    far_px = np.hypot(*(at_px - off).T)
    assert far_px.min() < 2.5
    precision = found.candidates[far_px.argmin(), 2] * PIXEL_UM**2
    assert far_px.min() < 3 / np.sqrt(precision)
    assert found.candidates[far_px.argmin(), 5] < 3


def test_further_than_the_reach_is_not_believed(sample):
    found = register_pair(*pair(sample, BESIDE, (3.0, -20.0)), reach_px=12)
    assert found.doubt in (RejectionReason.END_OF_SEARCH, RejectionReason.UNLIKE)
    assert register_pair(*pair(sample, BESIDE, (3.0, -20.0)), reach_px=25).doubt is RejectionReason.NONE


def test_without_a_reach_what_fits_nowhere_is_looked_for_further_away():
    sample, off = a_sample((500, 960)), (3.0, -49.0)
    first = a_field(sample, 20, 20, (420, 460))
    found = register_pair(first, a_field(sample, 20, 400, (420, 460), off_px=off, seed=2))
    assert found.doubt is RejectionReason.NONE
    assert np.abs(error_px(found, off)).max() < 0.06


def test_many_pairs_at_once(sample):
    heights = [a_field(sample, 40, 40, SHAPE), a_field(sample, 40, 230, SHAPE, off_px=(2.5, -3.5), seed=2)]
    heights.append(a_field(sample, 195, 40, SHAPE, off_px=(-1.25, 4.0), seed=3))
    shares: list[float] = []
    pairs = np.array([[0, 1], [0, 2]], np.int32)
    shifts = register(heights, pairs, 30.0, threads=2, progress=shares.append)
    assert sorted(shares) == [0.5, 1.0]
    np.testing.assert_allclose(shifts.x_um, np.array([-3.5, 4.0]) * PIXEL_UM, atol=0.04)
    np.testing.assert_allclose(shifts.y_um, np.array([-2.5, 1.25]) * PIXEL_UM, atol=0.04)
    assert shifts.believed.all()
    assert (shifts.first.tolist(), shifts.second.tolist()) == ([0, 0], [1, 2])
    assert len(register(heights, np.zeros((0, 2), np.int32)).x_um) == 0


def test_where_nothing_was_ever_sharp_pictures_may_differ():
    """Two blocks with a gap between them: what is shown of the gap is noise, and says nothing against either field."""
    noise = np.random.default_rng(5)
    pair = [_of_noise(noise, x0_um) for x0_um in (0.0, 270.0)]
    assert register_pair(*pair).doubt is RejectionReason.BLANK


def _of_noise(noise: np.random.Generator, x0_um: float) -> HeightMap:
    grey = ndimage.gaussian_filter(noise.normal(size=(270, 360)), 2.0)
    seen = (128 + 200 * grey).clip(0, 255).astype(np.uint8)
    return height_map(np.full(grey.shape, np.nan), 1.0, x0_um, grey=seen, confidence=0.0)
