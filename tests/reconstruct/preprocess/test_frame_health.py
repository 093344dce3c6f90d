"""Flashes and dead frames: left out and told; what light and focus do to a sound stack is left alone."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.reconstruct.conftest import MakeStack
from tests.truth.bleeding import drawn, seen
from wafer_viewer.model.acquisition.focus_stack import Bracket, FieldStack
from wafer_viewer.reconstruct.field_pipeline import reconstruct
from wafer_viewer.reconstruct.preprocess.frames import prepare

N_FRAMES = 34
STEP_UM = 2.0
Z_UM = STEP_UM * np.arange(N_FRAMES)
SHAPE = (96, 128)


@pytest.fixture(scope="module")
def sound(make_stack: MakeStack) -> FieldStack:
    """A plane that rises through the middle of the sweep, by a third of it."""
    return make_stack(plane_um(), Z_UM)


def plane_um() -> NDArray:
    return np.linspace(22.0, 44.0, SHAPE[1])[None, :] * np.ones(SHAPE)


def changed(stack: FieldStack, change: Callable[[NDArray], NDArray]) -> FieldStack:
    """The stack with what `change` makes of its greys, float64 [k, row, col], as whole counts."""
    counts = np.clip(np.rint(change(stack.images.astype(np.float64))), 0, 255)
    return dataclasses.replace(stack, images=counts.astype(np.uint8))


def with_frame(stack: FieldStack, k: int, frame: NDArray | float) -> FieldStack:
    def put(grey: NDArray) -> NDArray:
        grey[k] = frame
        return grey

    return changed(stack, put)


def reported(stack: FieldStack) -> list[str]:
    return [note for note in prepare(stack).notes if "left out" in note]


def false_share(stack: FieldStack) -> tuple[float, float]:
    """(measured share, share of those more than a step off)."""
    z_um = reconstruct(stack, threads=1).z_raw_um
    stored = np.isfinite(z_um)
    return float(stored.mean()), float((np.abs(z_um - plane_um())[stored] > STEP_UM).mean())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("frame", "words"),
    [(255.0, "far brighter"), (0.0, "far darker"), (110.0, "shows nothing")],
    ids=["flash", "black", "blank"],
)
@pytest.mark.parametrize("k", [8, 17, 30])
def test_one_faulty_frame_costs_no_field_and_is_reported(sound: FieldStack, k: int, frame: float, words: str):
    stack = with_frame(sound, k, frame)
    (note,) = reported(stack)
    assert note.startswith(f"Frame {k + 1} of {N_FRAMES} of field 1")
    assert words in note
    stored, wrong = false_share(stack)
    assert stored > 0.9 * false_share(sound)[0]
    assert wrong < 0.002


def test_a_flash_that_does_not_saturate_is_reported_with_its_greys(sound: FieldStack):
    (note,) = reported(with_frame(sound, 12, 1.7 * sound.images[12].astype(float)))
    assert "Frame 13 of 34" in note
    assert "mean grey 186 against 109 of 255" in note


def test_two_faulty_frames_side_by_side_are_both_left_out(sound: FieldStack):
    stack = with_frame(with_frame(sound, 15, 255.0), 16, 255.0)
    assert [note[:8] for note in reported(stack)] == ["Frame 16", "Frame 17"]


def test_a_flash_in_one_exposure_takes_its_slot_out(sound: FieldStack):
    longer = changed(sound, lambda grey: 1.5 * grey)
    flashed = with_frame(longer, 9, 255.0)
    stack = dataclasses.replace(sound, brackets=(Bracket(flashed.images, sound.present, 2.0),), exposure_us=1.0)
    assert [note[:8] for note in reported(stack)] == ["Frame 10"]
    assert prepare(stack).n_frames == N_FRAMES - 1


def test_absent_frames_keep_the_numbers_of_the_slots(sound: FieldStack):
    present = sound.present.copy()
    present[[3, 4]] = False
    stack = dataclasses.replace(with_frame(sound, 20, 0.0), present=present)
    assert [note[:8] for note in reported(stack)] == ["Frame 21"]


def flickering(sigma: float) -> Callable[[NDArray], NDArray]:
    gains = 1 + np.random.default_rng(5).normal(0, sigma, N_FRAMES)
    return lambda grey: grey * np.clip(gains, 0.3, None)[:, None, None]


def along_z(gains: NDArray) -> Callable[[NDArray], NDArray]:
    return lambda grey: grey * gains[:, None, None]


K = np.arange(N_FRAMES)
SOUND_CHANGES = {
    "none": lambda grey: grey,
    "flicker 5 %": flickering(0.05),
    "flicker 20 %": flickering(0.20),
    "lamp fades": along_z(np.linspace(1.6, 0.3, N_FRAMES)),
    "lamp switched": along_z(np.where(K < 15, 0.4, 1.0)),
    "every second frame darker": along_z(np.where(K % 2, 0.6, 1.0)),
    "bright about one focus": along_z(0.2 + np.exp(-((K - 17) ** 2) / 4.5)),
    "first frame darker": along_z(np.where(K == 0, 0.5, 1.0)),
    "last frame brighter": along_z(np.where(K == N_FRAMES - 1, 1.8, 1.0)),
    "constant dark": lambda grey: np.full_like(grey, 3.0),
    "black": np.zeros_like,
    "white": lambda grey: np.full_like(grey, 255.0),
    "half of the frames black": lambda grey: grey * (K % 3 > 0)[:, None, None],
    "noise alone": lambda grey: np.random.default_rng(3).normal(20, 4, grey.shape),
}


@pytest.mark.parametrize("change", SOUND_CHANGES.values(), ids=SOUND_CHANGES)
def test_what_light_does_to_a_sound_stack_is_no_fault(sound: FieldStack, change: Callable[[NDArray], NDArray]):
    assert reported(changed(sound, change)) == []


@pytest.mark.parametrize("step", [1, 2, 4, 5])
def test_coarse_steps_through_a_level_surface_are_no_fault(make_stack: MakeStack, step: int):
    for seed in range(5):
        level = make_stack(np.full(SHAPE, 30.0 + seed), 2.0 * step * np.arange(30 // step), seed=seed, noise_counts=0.0)
        assert reported(level) == []


def test_a_slit_of_light_that_is_in_focus_in_one_frame_is_no_fault(make_stack: MakeStack):
    """As a confocal microscope sees a level surface: nearly all light comes in the frame that is in focus."""
    level = make_stack(np.full(SHAPE, 30.0), 6.0 * np.arange(11))
    light = 0.1 + np.exp(-((6.0 * np.arange(11) - 30.0) ** 2) / (2 * 3.0**2))
    assert reported(changed(level, along_z(light))) == []


@pytest.mark.campaign(at_least_one=True)
@pytest.mark.parametrize("seed", range(20, 32))
def test_bleeding_and_clipped_light_is_no_fault(seed: int):
    assert reported(seen(drawn(seed), (64, 96)).stack) == []


def torn(stack: FieldStack, k: int, other: int) -> FieldStack:
    """The stack with the lower rows of frame k from another frame."""
    images = stack.images.copy()
    images[k, 40:] = images[other, 40:]
    return dataclasses.replace(stack, images=images)


@pytest.mark.parametrize(("k", "other"), [(5, 11), (12, 18), (30, 21), (12, 11), (17, 18)])
def test_a_torn_frame_is_left_out_and_named(sound: FieldStack, k: int, other: int):
    (note,) = reported(torn(sound, k, other))
    assert note.startswith(f"Frame {k + 1} of {N_FRAMES} of field 1 is torn")


def test_a_blank_frame_with_noise_is_found_beside_a_black_one(sound: FieldStack):
    noise = np.random.default_rng(1).normal(0, 3, SHAPE)
    stack = with_frame(with_frame(sound, 9, 0.0), 20, 110.0 + noise)
    dark, blank = reported(stack)
    assert dark.startswith("Frame 10")
    assert blank.startswith("Frame 21")
    assert "shows nothing" in blank


@pytest.mark.parametrize(("k", "other"), [(11, 12), (12, 14), (17, 15), (14, 17), (20, 3), (1, 32)])
def test_rows_of_another_frame_are_found_and_no_other_frame_is_named(sound: FieldStack, k: int, other: int):
    (note,) = reported(torn(sound, k, other))
    assert note.startswith(f"Frame {k + 1} of")


@pytest.mark.parametrize("k", [5, 12, 17])
def test_a_frame_whose_rows_slipped_is_left_out(sound: FieldStack, k: int):
    images = sound.images.copy()
    images[k, 40:] = np.roll(images[k], 6, axis=0)[40:]
    (note,) = reported(dataclasses.replace(sound, images=images))
    assert note.startswith(f"Frame {k + 1} of {N_FRAMES}")
    assert "torn" in note


def test_frames_that_tremble_by_a_pixel_are_not_torn(sound: FieldStack):
    rng = np.random.default_rng(0)
    images = np.stack([np.roll(frame, int(rng.integers(-1, 2)), axis=0) for frame in sound.images])
    assert reported(dataclasses.replace(sound, images=images)) == []
