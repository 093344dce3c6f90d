"""The picture across ground without texture: no patches of single frames, and nothing else changes."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from scipy.ndimage import uniform_filter

from tests.reconstruct.conftest import MakeStack
from wafer_viewer.model.surface.height_map import UNMEASURED_FROM
from wafer_viewer.reconstruct.field_pipeline import prepare_field, reconstruct, search_peaks
from wafer_viewer.reconstruct.focus.smooth_depth import membrane

Z_UM = 2.0 * np.arange(30)
LIGHT = np.linspace(1.25, 0.75, len(Z_UM))
ROWS, COLS = np.indices((128, 192))
RAMP_UM = 12 + 0.18 * COLS
MIDDLE = (slice(36, 92), slice(64, 128))


def bare_in_the_middle(make_stack: MakeStack, **changes: Any):
    """A ramp in light that fades along z, without texture in the middle."""
    contrast = np.ones(RAMP_UM.shape)
    contrast[16:112, 44:148] = 0.0
    stack = make_stack(RAMP_UM, Z_UM, contrast=contrast, noise_counts=1.0, **changes)
    images = np.clip(np.rint(stack.images * LIGHT[:, None, None]), 0, 255).astype(np.uint8)
    return dataclasses.replace(stack, images=images)


def test_bare_ground_has_no_terraces(make_stack: MakeStack):
    stack = bare_in_the_middle(make_stack)
    surface = reconstruct(stack, threads=1)
    assert (surface.origin[MIDDLE] >= UNMEASURED_FROM).mean() > 0.9
    seen = uniform_filter(surface.all_in_focus.astype(float), 5)[MIDDLE]
    expected = 110 * np.interp(RAMP_UM, Z_UM, LIGHT)[MIDDLE]
    assert float(np.sqrt(np.mean((seen - expected) ** 2))) < 3.0


def test_measured_pixels_are_those_of_their_sharpest_frame(make_stack: MakeStack):
    stack = bare_in_the_middle(make_stack)
    surface = reconstruct(stack, threads=1)
    sharpest = search_peaks(prepare_field(stack), threads=1).all_in_focus
    np.testing.assert_array_equal(surface.all_in_focus[surface.measured], sharpest[surface.measured])


@pytest.mark.parametrize("shape", [(40, 60), (37, 1), (5, 9)])
def test_a_membrane_keeps_what_is_known_and_continues_a_plane(shape: tuple[int, int]):
    rows, cols = np.indices(shape)
    plane = (2 + 0.1 * rows + 0.3 * cols).astype(np.float32)
    holed = plane.copy()
    holed[shape[0] // 3 : shape[0] // 2, shape[1] // 3 : 2 * shape[1] // 3] = np.nan
    filled = membrane(holed)
    known = np.isfinite(holed)
    np.testing.assert_array_equal(filled[known], holed[known])
    assert np.abs(filled - plane).max() < 0.25 * np.ptp(plane) + 1e-6
