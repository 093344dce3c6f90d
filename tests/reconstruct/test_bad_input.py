"""Stacks that are not as they should be: a result with the reasons in its origin, or one clear sentence."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray

import wafer_viewer as wv
from wafer_viewer.cli.app import main
from wafer_viewer.model.acquisition.focus_stack import FieldStack
from wafer_viewer.model.errors import ComputeError, DatasetError, WaferViewerError
from wafer_viewer.model.surface.height_map import HeightMap, Origin

MakeStack = Callable[..., FieldStack]


def changed(stack: FieldStack, **changes: object) -> FieldStack:
    return dataclasses.replace(stack, **changes)


def first(stack: FieldStack, n: int) -> FieldStack:
    return changed(stack, images=stack.images[:n], z_um=stack.z_um[:n], present=stack.present[:n])


def wrong(height: HeightMap, truth_um: NDArray, by_um: float = 4.0) -> float:
    """The share of what was measured that is further off."""
    return float(np.mean(np.abs(height.z_raw_um - truth_um)[height.measured] > by_um))


def reasons(height: HeightMap) -> set[Origin]:
    return {Origin(int(code)) for code in np.unique(height.origin)}


@pytest.mark.parametrize(("grey", "reason"), [(0, Origin.NO_TEXTURE), (90, Origin.NO_TEXTURE), (255, Origin.CLIPPED)])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_a_constant_stack_says_why_it_has_no_height(plane_stack: FieldStack, grey: int, reason: Origin, dtype) -> None:
    white = np.iinfo(dtype).max // 255
    height = wv.reconstruct(changed(plane_stack, images=np.full(plane_stack.images.shape, grey * white, dtype)))
    assert reasons(height) == {reason}
    assert np.isnan(height.z_um).all()


def test_a_missing_frame_in_the_middle_costs_little(make_stack: MakeStack, plane_um: NDArray) -> None:
    full = make_stack(plane_um, np.arange(20.0, 104.0, 2.0))
    present = np.arange(full.n_frames) != 17
    height = wv.reconstruct(changed(full, present=present))
    assert "1 of 42 frames" in height.provenance.notes[0]
    neighbour = np.abs(plane_um - full.z_um[17]) < 4
    error = np.abs(height.z_raw_um - plane_um)[neighbour & height.measured]
    assert height.measured[neighbour].mean() > 0.9
    assert np.sqrt(np.mean(error**2)) < 0.5
    assert error.max() < 3


@pytest.mark.slow
def test_the_order_of_the_frames_does_not_matter(plane_stack: FieldStack) -> None:
    order = np.random.default_rng(1).permutation(plane_stack.n_frames)
    expected = wv.reconstruct(plane_stack)
    for shuffled in (order, np.arange(plane_stack.n_frames)[::-1]):
        images, z_um = plane_stack.images[shuffled], plane_stack.z_um[shuffled].copy()
        np.testing.assert_array_equal(
            wv.reconstruct(changed(plane_stack, images=images, z_um=z_um)).z_um, expected.z_um
        )


def test_the_fewest_frames_give_a_map_or_reasons(plane_stack: FieldStack) -> None:
    height = wv.reconstruct(first(plane_stack, 3))
    assert height.shape == (96, 128)
    assert np.isnan(height.z_raw_um[~height.measured]).all()
    with pytest.raises(DatasetError, match="at least 3 are needed"):
        first(plane_stack, 2)


def test_twelve_bits_in_sixteen_clip_at_their_own_white(make_stack: MakeStack, plane_um: NDArray) -> None:
    twelve = make_stack(plane_um, np.arange(20.0, 104.0, 4.0), dtype=np.uint16)
    images = twelve.images.copy()
    images[:, 30:60, 40:80] = 4095
    height = wv.reconstruct(changed(twelve, images=images))
    assert (height.origin[38:52, 48:72] == Origin.CLIPPED).all()
    assert wrong(height, plane_um) < 0.02
    assert height.measured.mean() > 0.75


def test_one_row_of_pixels_is_a_map_of_one_row(plane_stack: FieldStack) -> None:
    for images in (plane_stack.images[:, 40:41], plane_stack.images[:, :, 40:41], plane_stack.images[:, 40:41, 40:41]):
        height = wv.reconstruct(changed(plane_stack, images=np.ascontiguousarray(images)))
        assert height.shape == images.shape[1:]


@pytest.mark.slow
def test_frames_shifted_at_random_are_put_right(make_stack: MakeStack) -> None:
    rows, cols = np.indices((290, 390))
    truth_um = 42 + 0.012 * cols + 0.008 * rows
    still = make_stack(truth_um, 40 + 0.6 * np.arange(25), noise_counts=1.0)
    at = np.random.default_rng(4).integers(-10, 11, (25, 2)) + 20
    images = np.stack([still.images[k, r : r + 250, c : c + 350] for k, (r, c) in enumerate(at)])
    height = wv.reconstruct(changed(still, images=images))
    error = (height.z_raw_um - truth_um[20:270, 20:370])[height.measured]
    assert "shifts by" in height.provenance.notes[0]
    assert Origin.TOO_FEW_FRAMES in reasons(height)
    assert height.measured.mean() > 0.6
    assert np.abs(error - np.median(error)).max() < 4


def nan_in_the_middle(z_um: NDArray) -> NDArray:
    return np.where(np.arange(len(z_um)) == 7, np.nan, z_um)


REFUSED: dict[str, tuple[Callable[[FieldStack], dict[str, object]], str]] = {
    "no z": (lambda s: {"z_um": nan_in_the_middle(s.z_um)}, "give every frame its z"),
    "endless z": (lambda s: {"z_um": np.where(np.arange(s.n_frames) == 7, np.inf, s.z_um)}, "give every frame its z"),
    "one z for two": (lambda s: {"z_um": np.maximum(s.z_um, s.z_um[1])}, "give every frame a z of its own"),
    "float images": (lambda s: {"images": s.images.astype(np.float32)}, "give 8- or 16-bit grey"),
    "signed images": (lambda s: {"images": s.images.astype(np.int16)}, "give 8- or 16-bit grey"),
    "colour images": (lambda s: {"images": np.repeat(s.images[..., None], 3, axis=3)}, "same number of frames"),
    "fewer z than frames": (lambda s: {"z_um": s.z_um[:-1]}, "same number of frames"),
}


@pytest.mark.parametrize("what", REFUSED)
def test_what_cannot_be_reconstructed_is_refused_in_one_sentence(plane_stack: FieldStack, what: str) -> None:
    changes, mend = REFUSED[what]
    with pytest.raises(WaferViewerError, match=mend) as fault:
        wv.reconstruct(changed(plane_stack, **changes(plane_stack)))
    assert isinstance(fault.value, ComputeError | DatasetError)
    assert "\n" not in str(fault.value)


def on_disk(folder: Path, images: NDArray) -> Path:
    path = folder / "stack.tif"
    tifffile.imwrite(path, images, photometric="minisblack")
    return path


def reconstructed(path: Path, *more: str) -> int:
    out = path.with_suffix(".npz")
    return main(["reconstruct", str(path), "--z-step-um", "4", "--pixel-um", "0.5", *more, "-o", str(out)])


@pytest.mark.parametrize("make", [np.zeros_like, lambda i: np.full_like(i, 255), lambda i: i[:3], lambda i: i[:, :1]])
def test_the_command_line_gives_a_map_of_poor_stacks(plane_stack: FieldStack, tmp_path: Path, make, capsys) -> None:
    path = on_disk(tmp_path, make(plane_stack.images))
    assert reconstructed(path) == 0
    height = wv.read_npz(path.with_suffix(".npz"))
    assert np.isnan(height.z_raw_um[~height.measured]).all()


@pytest.mark.parametrize(
    ("make", "words"),
    [(lambda i: i[:2], "at least 3"), (lambda i: i.astype(np.int32), "8 or 16 bits")],
    ids=["two frames", "32 bits"],
)
def test_the_command_line_refuses_in_one_sentence(
    plane_stack: FieldStack, tmp_path: Path, make, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = on_disk(tmp_path, make(plane_stack.images))
    assert reconstructed(path) == 2
    message = capsys.readouterr()
    assert words in message.err
    assert message.err.count("\n") == 1
    assert not path.with_suffix(".npz").exists()


def test_the_command_line_refuses_a_step_that_is_no_number(
    plane_stack: FieldStack, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = on_disk(tmp_path, plane_stack.images)
    assert main(["reconstruct", str(path), "--z-step-um", "nan", "--pixel-um", "1", "-o", str(tmp_path / "a.npz")]) == 2
    assert "z step is nan um" in capsys.readouterr().err
