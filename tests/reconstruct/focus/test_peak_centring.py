"""A centred peak does not follow the place of the frames: planes blurred by a lens's transfer, without noise."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tests.truth.phase import Stairs, Tilted, errors_of, phase_error, stairs
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.reconstruct.auto_tuning import SIGMA_WIDTHS
from wafer_viewer.reconstruct.focus.peak_centring import LEAST_SIGMA
from wafer_viewer.reconstruct.focus.peak_interpolation import PEAKS
from wafer_viewer.reconstruct.focus.peak_search import Search, search_field
from wafer_viewer.reconstruct.preprocess.frames import prepare

PLANE = Tilted(full_well_e=None)
DEFAULT = Recipe().peak


def heights(seen: Stairs, peak: str = DEFAULT):
    """Heights with the default measure and a focus width of 1.2 depths of field."""
    width = 1.2 / seen.scene.step_dof
    sigma = max(LEAST_SIGMA, SIGMA_WIDTHS * width / 3**0.5)
    blend = max(1, round(0.33 * width)) if PEAKS[peak].blended else 0
    search = Search("log_laplacian", 9, peak, 4, max(1, round(0.55 * width)), blend, True, sigma=sigma)
    return search_field(prepare(seen.stack), search, threads=1).z_um.astype(float)


@pytest.mark.parametrize("step_dof", [0.3, 0.45, 0.75])
def test_the_default_peak_does_not_follow_the_frames(step_dof: float) -> None:
    seen = stairs(dataclasses.replace(PLANE, step_dof=step_dof))
    found = phase_error(*errors_of(seen, heights(seen)))
    assert found.rms < 0.005
    assert found.false_share == 0


def test_three_points_follow_the_frames() -> None:
    """The measure of the test above is not blind."""
    seen = stairs(dataclasses.replace(PLANE, step_dof=0.3))
    assert phase_error(*errors_of(seen, heights(seen, "blur_law"))).rms > 0.02


@pytest.mark.campaign(at_least_one=True)
@pytest.mark.parametrize("peak", ["blur_law", DEFAULT])
def test_frames_at_uneven_distances_are_allowed_for(peak: str) -> None:
    seen = stairs(dataclasses.replace(PLANE, jitter=0.3))
    found = phase_error(*errors_of(seen, heights(seen, peak)))
    assert (found.noise < 0.04) == (peak == DEFAULT)


def test_sixteen_bits_are_centred_as_well() -> None:
    seen = stairs(dataclasses.replace(PLANE, bits=16))
    assert phase_error(*errors_of(seen, heights(seen))).rms < 0.005


def test_a_peak_near_an_end_is_neither_pulled_nor_outside() -> None:
    seen = stairs(PLANE)
    middle = len(seen.stack.z_um) // 2
    short = dataclasses.replace(
        seen.stack,
        images=seen.stack.images[middle - 1 :],
        z_um=seen.stack.z_um[middle - 1 :],
        present=seen.stack.present[middle - 1 :],
    )
    cut = heights(dataclasses.replace(seen, stack=short))
    assert cut.min() >= np.float32(short.z_um[0])
    inside = seen.truth_um > short.z_um[1]
    error = np.abs(cut - seen.truth_um)[16:-16, inside][:, :-16] / seen.scene.step_um
    assert np.quantile(error, 0.99) < 0.15
