"""z jitter of single frames: seen on tilted ground, told, and in the budget of every height."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import wafer_viewer as wv
from tests.reconstruct.conftest import MakeStack
from tests.truth.families import family_scene
from wafer_viewer.measure.base.measurement_context import FLICKER, Z_JITTER, frame_lines_um
from wafer_viewer.model.acquisition.focus_stack import FieldStack
from wafer_viewer.model.surface.frame_health import FrameHealth, jitter_u_um
from wafer_viewer.model.surface.height_map import HeightMap, Provenance
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.reconstruct.blending.stitched_mosaic import mosaic_provenance
from wafer_viewer.reconstruct.field_pipeline import reconstruct

Z_UM = np.arange(0, 56, 1.5)


def tilted(make_stack: MakeStack, seed: int, jitter_um: float) -> FieldStack:
    rows, cols = np.indices((160, 256))
    off_um = np.random.default_rng(seed + 50).normal(0, 1, len(Z_UM)) * jitter_um
    stack = make_stack(8 + 0.16 * cols + 0.02 * rows, Z_UM + off_um, seed=seed, contrast=0.5)
    return dataclasses.replace(stack, z_um=Z_UM)


def u_um(surface: HeightMap) -> float:
    return surface.provenance.frame_health.u_jitter_um


@pytest.mark.parametrize("seed", [1, 1002])  # of eight seeds it shows in seven
def test_jitter_shows_on_tilted_ground_and_is_told(make_stack: MakeStack, seed: int):
    surface = reconstruct(tilted(make_stack, seed, 0.3), threads=1)
    expected_um = jitter_u_um(0.3, 1.5, surface.provenance.recipe.focus_width_um / 1.2)
    assert 0.25 * expected_um < u_um(surface) < 1.5 * expected_um  # a lower bound: the fit absorbs slow deviations
    assert any("jitters by" in note for note in surface.provenance.notes)
    assert not any("order of their z" in note for note in surface.provenance.notes)
    assert frame_lines_um(surface.provenance)[Z_JITTER] == pytest.approx(2**0.5 * u_um(surface))


@pytest.mark.parametrize("seed", [1001, 1002])
def test_exact_frames_have_no_jitter(make_stack: MakeStack, seed: int):
    surface = reconstruct(tilted(make_stack, seed, 0.0), threads=1)
    assert u_um(surface) == 0
    assert Z_JITTER not in frame_lines_um(surface.provenance)
    assert not any("jitters by" in note or "order of their z" in note for note in surface.provenance.notes)


N = len(Z_UM)
WRONG_ORDERS = {
    "two exchanged": ([*range(18), 19, 18, *range(20, N)], "1 to 18, 20 to 19, 21 to 38"),
    "signs are not read": ([*range(18, -1, -1), *range(19, N)], "19 to 1, 20 to 38"),
    "a counter that began anew": ([*range(12, N), *range(12)], "27 to 38, 1 to 26"),
    "sorted as text": (sorted(range(N), key=str), "1 to 2, 24, 33 to 38, 3 to 12, 14 to 23, 25 to 32"),
}
"""Orders, and the mended ones; frame 13 of those sorted as text is left out, as one that resembles no neighbour."""


@pytest.mark.parametrize(("order", "right"), WRONG_ORDERS.values(), ids=WRONG_ORDERS)
def test_frames_out_of_order_are_not_taken_for_vibration(make_stack: MakeStack, order: list[int], right: str):
    stack = tilted(make_stack, 1001, 0.0)
    surface = wv.reconstruct(dataclasses.replace(stack, images=stack.images[order]), threads=1)
    told = [note for note in surface.provenance.notes if "order of their z" in note]
    assert len(told) == 1
    assert f"in another order, {right} (frames from 1)" in told[0]
    assert not any("vibration" in note for note in surface.provenance.notes)


def test_frames_in_order_that_pass_the_focus_in_few_steps_are_not_put_in_another():
    scene = family_scene("metal", 4)  # cut in the middle, the frames that change most would be at the ends
    surface = reconstruct(scene.stack, threads=1)
    assert not any("order of their z" in note for note in surface.provenance.notes)
    right = np.abs(surface.to_measure() - scene.truth_um) <= scene.right_um
    assert right.mean() > 0.8


def test_a_mosaic_has_the_worst_of_its_fields():
    parts = [Provenance(frame_health=FrameHealth(u_jitter_um=j, u_flicker_um=f)) for j, f in ((0.1, 0.0), (0.0, 0.2))]
    joint = mosaic_provenance(parts, Recipe()).frame_health
    assert joint == FrameHealth(u_jitter_um=0.1, u_flicker_um=0.2)
    assert set(frame_lines_um(mosaic_provenance(parts, Recipe()))) >= {Z_JITTER, FLICKER}
