"""Which frames are used, in which order, and what is refused."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.reconstruct.conftest import whole_field
from wafer_viewer.model.acquisition.focus_stack import FieldStack
from wafer_viewer.model.errors import ComputeError
from wafer_viewer.reconstruct.field_pipeline import reconstruct
from wafer_viewer.reconstruct.focus.sml_tenengrad_glv import focus_block
from wafer_viewer.reconstruct.frame_blocks import StackWindow, read_part
from wafer_viewer.reconstruct.preprocess.frames import prepare


def test_absent_slots_are_skipped(plane_stack: FieldStack) -> None:
    present = np.arange(21) % 5 != 2
    frames = prepare(dataclasses.replace(plane_stack, present=present))
    assert frames.n_frames == np.count_nonzero(present)
    np.testing.assert_array_equal(whole_field(frames), plane_stack.images[present])


def test_a_black_frame_in_an_absent_slot_changes_nothing(plane_stack: FieldStack) -> None:
    present = np.ones(21, bool)
    present[9] = False
    blackened = plane_stack.images.copy()
    blackened[9] = 0
    left_out = dataclasses.replace(plane_stack, present=present)
    black = dataclasses.replace(left_out, images=blackened)
    np.testing.assert_array_equal(reconstruct(black).z_um, reconstruct(left_out).z_um)
    assert "1 of 21 frames" in reconstruct(black).provenance.notes[0]


def test_a_sweep_downward_gives_the_same_map(plane_stack: FieldStack) -> None:
    down = dataclasses.replace(plane_stack, images=plane_stack.images[::-1], z_um=plane_stack.z_um[::-1].copy())
    np.testing.assert_array_equal(reconstruct(down).z_um, reconstruct(plane_stack).z_um)


def test_a_read_only_file_is_read_without_compiling_again(plane_stack: FieldStack, tmp_path: Path) -> None:
    np.save(tmp_path / "stack.npy", plane_stack.images)
    in_memory = reconstruct(plane_stack)
    compiled = len(focus_block.signatures)
    on_disk = dataclasses.replace(plane_stack, images=np.load(tmp_path / "stack.npy", mmap_mode="r"))
    np.testing.assert_array_equal(reconstruct(on_disk).z_um, in_memory.z_um)
    assert len(focus_block.signatures) == compiled


@pytest.mark.slow
def test_other_byte_orders_and_strides_are_read(plane_stack: FieldStack) -> None:
    wide = plane_stack.images.astype(np.uint16) * 16
    pages = np.zeros((42, *wide.shape[1:]), ">u2")
    pages[::2] = wide
    expected = reconstruct(dataclasses.replace(plane_stack, images=wide))
    found = reconstruct(dataclasses.replace(plane_stack, images=pages[::2]))
    np.testing.assert_array_equal(found.z_um, expected.z_um)
    assert found.all_in_focus.dtype == np.uint16


def test_border_pixels_repeat_beyond_the_frame(plane_stack: FieldStack) -> None:
    frames = prepare(plane_stack)
    padded = np.pad(plane_stack.images, ((0, 0), (5, 5), (5, 5)), mode="edge")
    for rows, cols in ((slice(0, 20), slice(0, 30)), (slice(80, 96), slice(100, 128)), (slice(40, 50), slice(60, 70))):
        block = read_part(frames, StackWindow(rows, cols), 5)
        np.testing.assert_array_equal(block, padded[:, rows.start : rows.stop + 10, cols.start : cols.stop + 10])


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"z_um": np.full(21, 3.0)}, "two frames at z = 3.000 um"),
        ({"z_um": np.full(21, np.nan)}, "without a z position"),
        ({"images": np.zeros((21, 96, 128), np.float32)}, "float32"),
    ],
)
def test_what_cannot_be_is_refused_in_one_sentence(
    plane_stack: FieldStack, changes: dict[str, NDArray], words: str
) -> None:
    with pytest.raises(ComputeError, match=words) as fault:
        reconstruct(dataclasses.replace(plane_stack, **changes))
    assert str(fault.value).count("\n") == 0


def test_white_of_a_12_bit_camera_is_found(make_stack: Callable[..., FieldStack]) -> None:
    images = np.full((5, 40, 40), 700, np.uint16)
    images[:, :, :20] = 4095
    stack = make_stack(np.zeros((40, 40)), np.arange(5.0), dtype=np.uint16)
    assert 4000 < prepare(dataclasses.replace(stack, images=images)).clipped_counts <= 4095
