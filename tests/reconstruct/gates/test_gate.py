"""No height without evidence: what was not seen has a reason instead."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.support.campaigns import drawn_after
from tests.truth.unseen import drawn_scene
from wafer_viewer.model.acquisition.focus_stack import FieldStack
from wafer_viewer.model.surface.focus_measures import focus_measures
from wafer_viewer.model.surface.height_map import Origin
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.reconstruct.field_pipeline import prepare_field, reconstruct
from wafer_viewer.reconstruct.focus.peak import Peaks
from wafer_viewer.reconstruct.focus.peak_search import NoiseScores, Search, noise_scores, search_field
from wafer_viewer.reconstruct.frame_blocks import Frames
from wafer_viewer.reconstruct.gates.gate import MAX_DIP_PER_POWER, Gate, auto_min_confidence, checks, gate_of, origins
from wafer_viewer.reconstruct.preprocess.camera_noise import CameraNoise

MakeStack = Callable[..., FieldStack]


def _share(origin: NDArray, *codes: Origin) -> float:
    return float(np.isin(origin, codes).mean())


@pytest.mark.slow
@pytest.mark.parametrize("measure", focus_measures())
@pytest.mark.parametrize("n_frames", [10, 40])
@pytest.mark.parametrize("noise_counts", [0.5, 3.0])
def test_pure_noise_is_not_measured(make_stack: MakeStack, measure: str, n_frames: int, noise_counts: float) -> None:
    stack = make_stack(np.zeros((96, 128)), np.arange(n_frames) * 4.0, contrast=0.0, noise_counts=noise_counts, seed=5)
    height = reconstruct(stack, Recipe(focus_measure=measure))
    assert np.isfinite(height.z_raw_um).mean() < 0.01
    assert _share(height.origin, Origin.NO_TEXTURE, Origin.AMBIGUOUS, Origin.END_OF_RANGE, Origin.OUTLIER) > 0.97


@pytest.mark.parametrize("grey", [0, 90])
def test_a_constant_stack_is_unmeasured_throughout(plane_stack: FieldStack, grey: int) -> None:
    height = reconstruct(dataclasses.replace(plane_stack, images=np.full_like(plane_stack.images, grey)))
    assert np.isnan(height.z_um).all()
    assert np.isnan(height.z_raw_um).all()
    assert (height.origin == Origin.NO_TEXTURE).all()
    assert not height.confidence.any()


def test_a_white_stack_is_too_bright(plane_stack: FieldStack) -> None:
    height = reconstruct(dataclasses.replace(plane_stack, images=np.full_like(plane_stack.images, 255)))
    assert (height.origin == Origin.CLIPPED).all()


def test_a_band_without_texture_is_left_out_and_its_surroundings_are_not(make_stack: MakeStack) -> None:
    contrast = np.ones((96, 128))
    contrast[:, 40:90] = 0
    height = reconstruct(make_stack(np.full((96, 128), 40.0), np.arange(0.0, 84.0, 4.0), contrast=contrast))
    assert np.isnan(height.z_raw_um[:, 60:70]).mean() > 0.99
    assert np.isfinite(height.z_raw_um[:, :30]).mean() > 0.97


def test_a_surface_outside_of_the_sweep_has_no_height(make_stack: MakeStack) -> None:
    height = reconstruct(make_stack(np.full((96, 128), 85.0), np.arange(0.0, 84.0, 4.0)))
    assert _share(height.origin, Origin.END_OF_RANGE) > 0.95


def test_two_equal_peaks_are_ambiguous(make_stack: MakeStack) -> None:
    z_um = np.arange(0.0, 124.0, 4.0)
    low, high = make_stack(np.full((96, 128), 30.0), z_um), make_stack(np.full((96, 128), 90.0), z_um)
    mixed = (low.images.astype(float) + high.images) / 2
    height = reconstruct(dataclasses.replace(low, images=mixed.astype(np.uint8)))
    assert _share(height.origin, Origin.AMBIGUOUS) > 0.5


@pytest.mark.slow
@pytest.mark.parametrize(("apart_um", "width_um", "placed"), [(7.0, 6.0, False), (6.0, "auto", True)])
def test_of_two_tops_closer_than_rivals_only_the_middle_counts(
    make_stack: MakeStack, apart_um: float, width_um: float | str, placed: bool
) -> None:
    """As of curved grains that shine: the surface is between the tops, and a narrow window finds either of them."""
    z_um, truth = np.arange(0.0, 124.0, 1.0), np.full((96, 128), 60.0)
    low, high = (make_stack(truth + side * apart_um / 2, z_um, seed=2 + side) for side in (-1, 1))
    both = dataclasses.replace(low, images=((low.images.astype(float) + high.images) / 2).astype(np.uint8))
    one, two = (reconstruct(stack, Recipe(focus_width_um=width_um)) for stack in (low, both))
    assert _share(one.origin, Origin.MEASURED) > 0.95
    right = np.abs(two.z_raw_um - truth) < 0.25 * apart_um
    assert np.mean(np.isfinite(two.z_raw_um) & ~right) < 0.02
    assert right.mean() > 0.95 if placed else _share(two.origin, Origin.AMBIGUOUS) > 0.8


def test_noise_makes_no_second_top(make_stack: MakeStack) -> None:
    z_um = np.arange(0.0, 124.0, 2.0)
    stack = make_stack(np.full((96, 128), 60.0), z_um, noise_counts=4.0)
    peaks = search_field(prepare_field(stack).frames, Search("log_laplacian", 9, "centred", 12), threads=1)
    assert np.mean(peaks.dip > 3 * MAX_DIP_PER_POWER) < 0.01


@pytest.mark.slow
@pytest.mark.parametrize("seed", drawn_after(1, [461, 5_000_163]))
def test_grains_that_shine_have_few_false_heights(seed: int) -> None:
    scene = drawn_scene(seed)
    z_um = reconstruct(scene.stack).to_measure()
    off_um = np.abs(z_um - scene.truth_um)[np.isfinite(z_um) & np.isfinite(scene.truth_um)]
    assert np.mean(off_um > scene.limit_um) < 0.001


def test_ten_frames_are_enough(make_stack: MakeStack) -> None:
    rows, cols = np.indices((96, 128))
    truth = 14 + 0.04 * cols + 0.03 * rows
    height = reconstruct(make_stack(truth, np.arange(10) * 4.0))
    assert height.measured.mean() > 0.9
    assert np.nanmedian(np.abs(height.z_raw_um - truth)) < 0.4


def test_a_gate_of_zero_lets_everything_but_ends_through(plane_stack: FieldStack) -> None:
    flat = dataclasses.replace(
        plane_stack, images=np.random.default_rng(1).integers(90, 96, plane_stack.images.shape, np.uint8)
    )
    origin = reconstruct(flat, Recipe(min_confidence=0.0, window=9)).origin
    assert _share(origin, Origin.MEASURED, Origin.FILLED, Origin.OUTLIER, Origin.END_OF_RANGE) == 1


def test_noise_reaches_further_in_longer_stacks_and_smaller_windows() -> None:
    def lead(window: int, n_frames: int) -> float:
        return noise_scores(Search("tenengrad", window, "tent", 2), n_frames).lead

    assert lead(9, 60) > lead(17, 60)
    assert 0 < lead(9, 100) < 1


@pytest.mark.parametrize("measure", ["tenengrad", "log_laplacian"])
@pytest.mark.parametrize(("window", "n_frames"), [(5, 24), (9, 60), (13, 100)])
def test_noise_passes_a_gate_once_in_a_hundred_pixels(measure: str, window: int, n_frames: int) -> None:
    search = Search(measure, window, "tent", 4, camera=CameraNoise(1e-3, 144.0))
    rng = np.random.default_rng(4711)
    grey = rng.normal(128, 12, (n_frames, 200, 200)).round().clip(0, 255).astype(np.uint8)
    frames = Frames.of(grey, np.arange(n_frames), np.linspace(0, 4.0 * (n_frames - 1), n_frames), 256)
    noise = noise_scores(search, n_frames)
    peaks = search_field(frames, search, threads=1)
    gate = gate_of(noise, auto_min_confidence(noise), 0.3, window)
    inside = slice(search.margin_px, -search.margin_px)
    assert np.mean(peaks.fall[inside, inside] > noise.fall) < 0.025
    assert np.mean(origins(peaks, gate, n_frames) == Origin.MEASURED) < 0.01


def a_peak(**changes: float) -> Peaks:
    """One pixel that passes every gate, but for the changes."""
    peaks = Peaks.empty((1, 1), np.dtype(np.uint8))
    passing = {"z_um": 40, "lead": 3, "fall": 3, "contrast": 3, "dip": 0, "at_end": 0, "clipped": 0}
    for name, value in {**passing, **changes}.items():
        getattr(peaks, name)[:] = value
    return peaks


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({}, Origin.MEASURED),
        ({"z_um": 47}, Origin.WINDOWS_DISAGREE),
        ({"lead": 0.1, "z_um": 47}, Origin.AMBIGUOUS),
        ({"fall": 0.1}, Origin.AMBIGUOUS),
        ({"dip": 0.7}, Origin.AMBIGUOUS),
        ({"dip": 0.6}, Origin.MEASURED),
        ({"fall": 1.1, "contrast": 3.0}, Origin.AMBIGUOUS),
        ({"fall": 1.3, "contrast": 3.0}, Origin.MEASURED),
        ({"at_end": 1, "lead": 0.1}, Origin.END_OF_RANGE),
        ({"contrast": 0.1, "at_end": 1}, Origin.NO_TEXTURE),
        ({"clipped": 9, "contrast": 0.1}, Origin.CLIPPED),
    ],
)
def test_the_reason_that_explains_most_is_reported(changes: dict[str, float], reason: Origin) -> None:
    gate = Gate(0.5, 0.5, 0.5, 0.3, 9, window_tolerance_um=6.0, min_fall_share=0.4, max_dip=0.65)
    peaks, wide_um = a_peak(**changes), np.full((1, 1), 40.0, np.float32)
    assert origins(peaks, gate, 60, wide_um)[0, 0] == reason
    failed = [check.origin for check in checks(peaks, gate, 60, wide_um) if not check.passed[0, 0]]
    assert (failed or [Origin.MEASURED])[0] == reason


def test_a_gate_that_is_off_lets_everything_pass() -> None:
    noise = NoiseScores(0.2, 0.4, 0.6)
    gate = gate_of(noise, 0.0, 1.0, 9, window_tolerance_um=6.0)
    peaks = a_peak(lead=0, fall=-1, contrast=0, dip=2, z_um=90)
    requested = checks(peaks, gate, 60, np.full((1, 1), 40.0, np.float32))
    assert all(check.passed.all() for check in requested)
    assert [check.name for check in requested if not np.isfinite(check.limit)] == [
        "texture",
        "flanks",
        "width",
        "rival",
        "tops",
        "windows",
    ]


def test_windows_disagree_where_a_wider_one_sees_something_else(make_stack: MakeStack) -> None:
    truth = np.full((96, 128), 60.0)
    contrast = np.ones_like(truth)
    truth[44:59, 60:75], contrast[44:59, 60:75] = 30.0, 0.4
    stack = make_stack(truth, np.arange(0.0, 100.0, 4.0), contrast=contrast)
    height, off = (reconstruct(stack, Recipe(window=9, edges="none", compare_windows=c)) for c in (True, False))
    disagree = height.origin == Origin.WINDOWS_DISAGREE
    assert disagree[40:63, 56:79].sum() >= 8
    assert not disagree[:24].any()
    assert not (off.origin == Origin.WINDOWS_DISAGREE).any()
