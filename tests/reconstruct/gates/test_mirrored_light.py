"""Print is told from walls by the symmetry of its light about the height of the surface."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from tests.truth.families import family_scene
from wafer_viewer.model.surface.height_map import Origin
from wafer_viewer.reconstruct.field_pipeline import reconstruct
from wafer_viewer.reconstruct.frame_blocks import Frames
from wafer_viewer.reconstruct.gates.mirrored_light import mirrored_light
from wafer_viewer.reconstruct.preprocess.camera_noise import CameraNoise

SIDE, CELLS = 96, 24
Z_UM = np.arange(30.0)
CAMERA = CameraNoise(gain_counts=0.005, floor_counts2=4.0)


def stack(bars_um: float, ground_um: float, z_um: NDArray[np.float64] = Z_UM) -> Frames:
    """Bright bars at heights of their own on dark ground, each blurred about its own height, in noise."""
    rng = np.random.default_rng(5)
    bars = np.kron(np.arange(8)[None] % 2, np.ones((SIDE, 12))) * 140.0
    ground = 40.0 + 10 * rng.standard_normal((SIDE, SIDE)).round() * (bars == 0)
    frames = [
        sum(gaussian_filter(part, 0.4 + 0.4 * abs(z - at)) for part, at in ((bars, bars_um), (ground, ground_um)))
        for z in z_um
    ]
    counts = np.stack(frames) + rng.normal(0, 2, (len(z_um), SIDE, SIDE))
    images = counts.round().clip(0, 255).astype(np.uint8)
    return Frames.of(images, np.arange(len(z_um)), z_um, 255)


def symmetric_share(frames: Frames, height_um: float) -> float:
    """Share of the cells, away from the border, around which light is symmetric about a height."""
    heights_um = np.full((CELLS, CELLS), height_um, np.float32)
    return float(mirrored_light(frames, heights_um, 8, CAMERA, threads=1)[4:-4, 4:-4].mean())


def test_light_of_one_height_is_symmetric_about_it_and_about_no_other() -> None:
    frames = stack(14.3, 14.3)
    assert symmetric_share(frames, 14.3) == 1
    assert symmetric_share(frames, 15.8) == 0


def test_light_of_two_heights_is_symmetric_about_neither() -> None:
    frames = stack(17.0, 11.0)
    assert symmetric_share(frames, 11.0) < 0.1
    assert symmetric_share(frames, 17.0) < 0.1


def test_symmetry_is_one_of_heights_where_frames_are_missing() -> None:
    present = np.isin(np.arange(30), [9, 16, 17], invert=True)
    assert symmetric_share(stack(14.3, 14.3, Z_UM[present]), 14.3) == 1


def test_nothing_is_told_without_heights_or_without_light_that_changes() -> None:
    frames = stack(14.3, 14.3)
    assert symmetric_share(frames, np.nan) == 0
    flat = Frames.of(np.full_like(frames.stored[0].images, 90), np.arange(30), Z_UM, 255)
    assert symmetric_share(flat, 14.3) == 0


@pytest.mark.slow
@pytest.mark.parametrize("seed", [2, 6])  # polygons of grey, and letters; without symmetry .46 and .01 are kept
def test_print_with_hard_edges_in_noise_is_no_wall(seed: int) -> None:
    scene = family_scene("print", seed)
    height = reconstruct(scene.stack, threads=1)
    error_um = np.abs(height.z_raw_um - scene.truth_um)
    assert np.mean(height.origin == Origin.BLEEDING_EDGE) < 0.06
    assert np.isfinite(error_um).mean() > 0.8
    assert np.mean(error_um[np.isfinite(error_um)] > scene.step_um) < 0.02
