"""Brackets become one linear picture that is clipped only where the shortest exposure is."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from numpy.typing import NDArray

import wafer_viewer as wv
from tests.reconstruct.conftest import correction, whole_field
from wafer_viewer.model.acquisition.focus_stack import Bracket, FieldStack
from wafer_viewer.model.errors import ComputeError, DatasetError
from wafer_viewer.reconstruct.field_pipeline import reconstruct
from wafer_viewer.reconstruct.preprocess.exposure_fusion import Fusion
from wafer_viewer.reconstruct.preprocess.frames import prepare

READ_COUNTS, GAIN = 0.4, 0.03
FULL = 65535


@pytest.fixture(scope="module")
def light(plane_light: NDArray) -> NDArray:
    """[k, row, col], 1 what makes the shortest exposure white: dark dies beside trenches eight times as bright."""
    bright = np.ones(plane_light.shape[1:])
    bright[:, 64:] = 8.0
    return plane_light * bright * 0.055


@pytest.fixture(scope="module")
def plane_light(plane_stack: FieldStack) -> NDArray:
    return plane_stack.images / plane_stack.images.mean()


def exposed(light: NDArray, gain: float, seed: int, black: float = 0.0, white: int = 255) -> NDArray:
    """What a linear camera makes of light: shot noise, read noise, a black level, whole counts, white clipped."""
    counts = light * gain * white
    noise = np.random.default_rng(seed).normal(size=light.shape) * np.sqrt(GAIN * counts + READ_COUNTS**2)
    dtype = np.uint8 if white == 255 else np.uint16
    return np.clip(np.rint(counts + noise + black), 0, white).astype(dtype)


def bracketed(stack: FieldStack, light: NDArray, *gains: float, black: float = 0.0, white: int = 255) -> FieldStack:
    all_there = np.ones(len(light), bool)
    images = [exposed(light, gain, n, black, white) for n, gain in enumerate(gains)]
    others = tuple(Bracket(i, all_there, 100 * g) for i, g in zip(images[1:], gains[1:], strict=True))
    return dataclasses.replace(stack, images=images[0], exposure_us=100 * gains[0], brackets=others)


@pytest.mark.slow
@pytest.mark.parametrize("ratio", [2, 4, 8])
@pytest.mark.parametrize("black", [0.0, 6.0])
def test_the_fused_picture_is_linear_in_light(
    plane_stack: FieldStack, light: NDArray, ratio: int, black: float
) -> None:
    frames = prepare(bracketed(plane_stack, light, 1, ratio, black=black))
    fusion = correction(frames, Fusion)
    assert fusion is not None
    assert fusion.gains[1] == pytest.approx(ratio, rel=0.03)
    assert fusion.black_counts == pytest.approx(black, abs=1.0)
    fused = whole_field(frames) / FULL
    for low, high in ((0.03, 0.06), (0.06, 0.2), (0.2, 0.6), (0.6, 0.9)):
        there = (light > low) & (light < high)
        assert np.mean(fused[there]) == pytest.approx(np.mean(light[there]) * 255 / (255 - black), rel=0.04, abs=0.003)


def test_dark_pixels_are_as_quiet_as_the_photons_of_all_exposures_allow(
    plane_stack: FieldStack, light: NDArray
) -> None:
    """The variance is that of the sum of both exposures where both hold, the shortest's own where it is alone."""
    level = np.full_like(light, 0.05)
    level[:, :, 64:] = 0.7
    fused = whole_field(prepare(bracketed(plane_stack, level, 1, 4))).astype(float) * 255 / FULL
    dark, bright = fused[:, :, :60], fused[:, :, 70:]
    dark_counts, bright_counts = 0.05 * 255, 0.7 * 255
    rounding = 1 / 12
    both = (GAIN * dark_counts * 5 + 2 * (READ_COUNTS**2 + rounding)) / 25
    assert dark.var() == pytest.approx(both, rel=0.1)
    assert bright.var() == pytest.approx(GAIN * bright_counts + READ_COUNTS**2 + rounding, rel=0.1)


def test_a_pixel_is_clipped_only_where_the_shortest_exposure_is(plane_stack: FieldStack, light: NDArray) -> None:
    stack = bracketed(plane_stack, 2 * light, 1, 4)
    frames = prepare(stack)
    np.testing.assert_array_equal(whole_field(frames) >= frames.clipped_counts, stack.images >= 250)
    assert np.mean(stack.brackets[0].images >= 250) > 2 * np.mean(stack.images >= 250)


def test_the_order_of_the_exposures_does_not_matter(plane_stack: FieldStack, light: NDArray) -> None:
    up = bracketed(plane_stack, light, 1, 4)
    short = Bracket(up.images, up.present, up.exposure_us)
    down = dataclasses.replace(up, images=up.brackets[0].images, exposure_us=400.0, brackets=(short,))
    np.testing.assert_array_equal(whole_field(prepare(up)), whole_field(prepare(down)))


@pytest.mark.slow
def test_sixteen_bits_and_three_exposures_are_fused_too(plane_stack: FieldStack, light: NDArray) -> None:
    frames = prepare(bracketed(plane_stack, light, 1, 2, 4, white=4095))
    there = (light > 0.1) & (light < 0.9)
    assert np.mean(whole_field(frames)[there]) / FULL == pytest.approx(np.mean(light[there]), rel=0.02)
    assert "x2, x4 as bright" in frames.notes[0]


@pytest.mark.slow
def test_a_stack_of_brackets_measures_more_than_either_exposure(
    plane_stack: FieldStack, plane_um: NDArray, light: NDArray
) -> None:
    """The trench is eighty times as bright as the die here."""
    uneven = 1.5 * light
    uneven[:, :, :64] /= 10
    stack = bracketed(plane_stack, uneven, 1, 8)
    fused = reconstruct(stack)
    alone = [reconstruct(dataclasses.replace(plane_stack, images=one.images)) for one in stack.exposures]
    assert fused.measured.mean() > 1.05 * max(one.measured.mean() for one in alone)
    assert np.sqrt(np.nanmean((fused.z_raw_um - plane_um) ** 2)) < 1.0
    assert fused.all_in_focus.dtype == np.uint16
    assert "2 exposures were fused" in fused.provenance.notes[0]


def test_a_slot_that_lacks_an_exposure_is_left_out(plane_stack: FieldStack, light: NDArray) -> None:
    stack = bracketed(plane_stack, light, 1, 2)
    present = np.arange(21) != 9
    torn = dataclasses.replace(stack, brackets=(dataclasses.replace(stack.brackets[0], present=present),))
    frames = prepare(torn)
    assert frames.n_frames == 20
    assert "1 of 21 frames" in frames.notes[0]


def test_exposures_that_share_no_pixel_go_by_their_times_or_are_refused(plane_stack: FieldStack) -> None:
    black = np.full(plane_stack.images.shape, 2, np.uint8)
    white = np.full(plane_stack.images.shape, 255, np.uint8)
    stack = dataclasses.replace(plane_stack, images=black, brackets=(Bracket(white, plane_stack.present),))
    with pytest.raises(ComputeError, match="at most 8 times apart") as fault:
        reconstruct(stack)
    assert str(fault.value).count("\n") == 0
    timed = Bracket(white, plane_stack.present, 300.0)
    frames = prepare(dataclasses.replace(stack, exposure_us=100.0, brackets=(timed,)))
    fusion = correction(frames, Fusion)
    assert fusion is not None
    assert fusion.gains == (1.0, 3.0)


def test_exposures_of_other_size_or_depth_are_refused(plane_stack: FieldStack) -> None:
    other = Bracket(plane_stack.images[:, :-1], plane_stack.present)
    with pytest.raises(DatasetError, match="must be alike"):
        dataclasses.replace(plane_stack, brackets=(other,))


def test_the_part_of_a_stack_keeps_its_brackets(plane_stack: FieldStack, light: NDArray) -> None:
    part = bracketed(plane_stack, light, 1, 2).part(slice(10, 50), slice(20, 90))
    assert {one.images.shape for one in part.exposures} == {(21, 40, 70)}
    assert wv.reconstruct(part).shape == (40, 70)
