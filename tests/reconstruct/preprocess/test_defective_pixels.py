"""Pixels of the sensor that do not see are found and mended."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.reconstruct.conftest import correction, whole_field
from wafer_viewer.model.acquisition.focus_stack import FieldStack
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.reconstruct.field_pipeline import reconstruct
from wafer_viewer.reconstruct.frame_blocks import StackWindow, developed, read_part
from wafer_viewer.reconstruct.preprocess.frames import prepare
from wafer_viewer.reconstruct.preprocess.sensor_faults import Flaws

FLAWS = {
    "hot column": (slice(None), 60, 255),
    "warm column": (slice(None), 60, "+25"),
    "dead column": (slice(None), 60, 0),
    "hot row": (40, slice(None), 255),
    "two hot columns": (slice(None), slice(60, 62), 255),
    "hot pixel": (30, 70, 255),
    "dead pixel": (30, 70, 0),
}


def flawed(stack: FieldStack, rows: slice | int, cols: slice | int, value: int | str) -> FieldStack:
    images = stack.images.copy()
    observed = images[:, rows, cols].astype(int)
    images[:, rows, cols] = np.clip(observed + int(value), 0, 255) if isinstance(value, str) else value
    return dataclasses.replace(stack, images=images)


@pytest.mark.parametrize("name", FLAWS)
def test_flaws_are_found_and_nothing_else(plane_stack: FieldStack, name: str) -> None:
    rows, cols, value = FLAWS[name]
    present = np.zeros(plane_stack.images.shape[1:], bool)
    present[rows, cols] = True
    flaws = correction(prepare(flawed(plane_stack, rows, cols, value)), Flaws)
    assert flaws is not None
    found = np.zeros_like(present)
    found[tuple(flaws.at.T)] = True
    assert np.mean(found[present]) > 0.95
    assert not found[~present].any()


@pytest.mark.parametrize("name", FLAWS)
def test_flaws_do_not_raise_ridges(plane_stack: FieldStack, plane_um: NDArray, name: str) -> None:
    height = reconstruct(flawed(plane_stack, *FLAWS[name]))
    error = np.abs(height.z_raw_um - plane_um)[height.measured]
    assert np.mean(error > 4) < 0.002
    assert height.measured.mean() > 0.9


def test_a_sound_sensor_has_none(plane_stack: FieldStack) -> None:
    assert correction(prepare(plane_stack), Flaws) is None


def test_blocks_and_parts_are_mended_alike(plane_stack: FieldStack) -> None:
    frames = prepare(flawed(plane_stack, slice(None), 60, 255))
    full = whole_field(frames)
    assert full[:, :, 60].max() < 255
    part = read_part(frames.part(slice(30, 60), slice(40, 100)), StackWindow(slice(5, 25), slice(10, 50)))
    np.testing.assert_array_equal(part, full[:, 35:55, 50:90])


@pytest.mark.parametrize("name", FLAWS)
def test_a_flawed_stack_gives_what_one_gives_whose_flaws_were_mended_before(plane_stack: FieldStack, name: str) -> None:
    stack = flawed(plane_stack, *FLAWS[name])
    found, clean = (reconstruct(one, Recipe(drift="none")) for one in (stack, mended_before(stack)))
    for of in ("z_um", "confidence", "all_in_focus", "origin"):
        np.testing.assert_array_equal(getattr(found, of), getattr(clean, of))


def test_rows_without_a_flaw_are_read_where_they_lie(plane_stack: FieldStack) -> None:
    frames = prepare(flawed(plane_stack, *FLAWS["hot pixel"]), Recipe(drift="none"))
    cols, stored = slice(0, frames.shape[1]), frames.stored[0].images
    parts = [StackWindow(rows, cols) for rows in (slice(0, 30), slice(36, 60), slice(0, 25), slice(0, 26))]
    near, far, above, touching = (block.images for _, block in developed(frames, parts, 5))
    assert not np.shares_memory(near, stored)
    assert np.shares_memory(far, stored)
    assert above.shape == stored.shape
    assert touching.shape == (frames.n_frames, 36, frames.shape[1] + 10)


def test_some_frames_and_downward_ones_are_mended_as_all_are(plane_stack: FieldStack) -> None:
    stack = flawed(plane_stack, *FLAWS["two hot columns"])
    turned = dataclasses.replace(stack, images=stack.images[::-1], z_um=stack.z_um[::-1])
    rows, cols = slice(10, 30), slice(50, 61)
    expected = mended_before(stack).images[4:9, rows, cols]
    for one in (stack, turned):
        part = read_part(prepare(one, Recipe(drift="none")), StackWindow(rows, cols, slice(4, 9)))
        np.testing.assert_array_equal(part, expected)


def mended_before(stack: FieldStack) -> FieldStack:
    """The stack with the mean of two sound pixels in each flaw's place, one after the other."""
    flaws, images = correction(prepare(stack), Flaws), stack.images.copy()
    assert flaws is not None
    for at, one, other in zip(flaws.at, flaws.one, flaws.other, strict=True):
        two = stack.images[:, *one].astype(int) + stack.images[:, *other]
        images[:, *at] = (two + 1) // 2
    return dataclasses.replace(stack, images=images)
