"""A field of which little is measured says why, and what to change."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from tests.truth.families import bare, metal, textbook
from wafer_viewer.model.acquisition.focus_stack import FieldStack
from wafer_viewer.model.surface.height_map import Origin
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.reconstruct.field_pipeline import ADVICE, FEW_HEIGHTS, few_heights, reconstruct

MakeStack = Callable[..., FieldStack]


def notes_of(stack: FieldStack, recipe: Recipe = Recipe()) -> tuple[float, list[str]]:
    """Share of the field that is measured, and its notes on few heights."""
    surface = reconstruct(stack, recipe, threads=1)
    share = float((surface.origin == Origin.MEASURED).mean())
    return share, [note for note in surface.provenance.notes if note.startswith("Under 30 %")]


@pytest.mark.slow
def test_saturated_metal_asks_for_a_shorter_exposure():
    stack = metal(1000).stack
    longer = np.minimum(4 * stack.images.astype(np.uint16), 255).astype(np.uint8)
    share, notes = notes_of(replace(stack, images=longer))
    assert share < FEW_HEIGHTS
    (note,) = notes
    assert "too bright" in note
    assert "shorten the exposure" in note


@pytest.mark.slow
def test_a_sweep_that_misses_the_sample_asks_for_a_longer_one(plane_stack: FieldStack):
    few = slice(0, len(plane_stack.z_um) // 2 - 1)
    short = replace(
        plane_stack, images=plane_stack.images[few], z_um=plane_stack.z_um[few], present=plane_stack.present[few]
    )
    share, (note,) = notes_of(short)
    assert share < FEW_HEIGHTS
    assert "sweep" in note


@pytest.mark.slow
def test_ground_without_texture_asks_for_light(plane_stack: FieldStack):
    rng = np.random.default_rng(3)
    blank = np.rint(128 + rng.normal(0, 2, plane_stack.images.shape)).astype(np.uint8)
    share, (note,) = notes_of(replace(plane_stack, images=blank))
    assert share < FEW_HEIGHTS
    assert "no texture" in note


@pytest.mark.slow
def test_enough_heights_need_no_note(plane_stack: FieldStack):
    share, notes = notes_of(plane_stack)
    assert share > FEW_HEIGHTS
    assert not notes


@pytest.mark.campaign(at_least_one=True)
@pytest.mark.parametrize("seed", range(8))
def test_no_field_of_few_heights_goes_without_a_note(seed: int):
    for family in (bare, textbook, metal):
        share, notes = notes_of(family(seed).stack)
        assert len(notes) == (share < FEW_HEIGHTS)


def test_every_reason_has_its_advice():
    for reason in Origin:
        if reason > Origin.NOT_COVERED:
            origin = np.full((4, 4), reason, np.uint8)
            origin[0, 0] = Origin.MEASURED
            assert few_heights(origin) == (f"Under 30 % of a field is measured; most of the rest {ADVICE[reason]}",)


def test_what_no_frame_covers_does_not_count():
    origin = np.full((4, 4), Origin.NOT_COVERED, np.uint8)
    origin[0] = Origin.OUTLIER, Origin.FILLED, Origin.MEASURED, Origin.MEASURED
    assert few_heights(origin) == ()
