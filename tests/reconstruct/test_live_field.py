"""A field that is measured while its frames come gives the map of the finished stack."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable

import numpy as np
import pytest
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.focus_stack import FieldStack
from wafer_viewer.model.errors import ComputeError
from wafer_viewer.model.surface.height_map import HeightMap
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.reconstruct import live_field
from wafer_viewer.reconstruct.field_pipeline import reconstruct, settled_recipe
from wafer_viewer.reconstruct.live_field import LiveField
from wafer_viewer.reconstruct.preprocess import drift

MakeStack = Callable[..., FieldStack]
Z_UM = np.arange(20.0, 104.0, 4.0)
FROM_BELOW = [(0, 1), (1, 8), (8, 20), (20, 21)]
FROM_THE_MIDDLE = [(8, 20), (1, 8), (20, 21), (0, 1)]


@pytest.fixture(scope="module")
def stack(make_stack: MakeStack, plane_um: NDArray) -> FieldStack:
    return make_stack(plane_um, Z_UM)


def live(stack: FieldStack, recipe: Recipe, chunks: Iterable[tuple[int, int]]) -> HeightMap:
    pages = np.zeros_like(stack.images)
    field = LiveField(pages, 4.0, recipe)
    for first, stop in chunks:
        pages[first:stop] = stack.images[first:stop]
        field.take(first, stop)
    return field.surface(dataclasses.replace(stack, images=pages))


@pytest.mark.parametrize("measure", ["tenengrad", "log_laplacian"])
@pytest.mark.parametrize(
    "chunks",
    [FROM_BELOW, FROM_BELOW[::-1], FROM_THE_MIDDLE],
    ids=["from below", "from above", "from the middle"],
)
def test_it_is_the_same_map_bit_for_bit(
    stack: FieldStack, measure: str, chunks: list[tuple[int, int]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(live_field, "LIVE_STRIPE_ROWS", 40)  # 96 rows are two stripes and a part of one
    recipe = settled_recipe(stack, Recipe(focus_measure=measure))
    full, grown = reconstruct(stack, recipe), live(stack, recipe, chunks)
    for layer in ("z_um", "z_raw_um", "confidence", "origin", "all_in_focus", "u_um"):
        np.testing.assert_array_equal(getattr(grown, layer), getattr(full, layer), layer)
    assert grown.provenance == full.provenance


def test_of_equal_frames_the_lowest_counts_in_any_order(stack: FieldStack) -> None:
    pages = stack.images.copy()
    pages[8:] = pages[8]
    fields = [LiveField(pages, 4.0, settled_recipe(stack)) for _ in range(3)]
    for field, chunks in zip(fields, (FROM_BELOW, FROM_BELOW[::-1], FROM_THE_MIDDLE), strict=True):
        for first, stop in chunks:
            field.take(first, stop)
    assert all(field._silhouette.frame.max() <= 8 for field in fields)
    assert all(curves.peak.max() <= 8 for field in fields for curves in field._wide.curves)
    for layers in zip(*(field._silhouette for field in fields), strict=True):
        np.testing.assert_array_equal(layers[1:], [layers[0]] * 2)


def test_most_of_the_motion_between_frames_is_known_before_the_last_one(
    stack: FieldStack, monkeypatch: pytest.MonkeyPatch
) -> None:
    frames = list[int]()
    spectra = drift._spectra
    monkeypatch.setattr(drift, "_spectra", lambda images: frames.append(len(images)) or spectra(images))
    field = LiveField(stack.images, 4.0, settled_recipe(stack))
    frames.clear()
    field.take(0, 20)
    ahead = sum(frames)
    field.take(20, 21)
    field.surface(stack)
    assert ahead > 0
    assert sum(frames) - ahead <= ahead / 10


def test_with_a_frame_missing_it_is_the_map_of_what_is_there(stack: FieldStack) -> None:
    recipe = settled_recipe(stack)
    present = np.arange(len(Z_UM)) != 9
    partial = dataclasses.replace(stack, present=present)
    grown = live(partial, recipe, [(0, 9), (10, 21)])
    np.testing.assert_array_equal(grown.z_um, reconstruct(partial, recipe).z_um)


def test_what_cannot_be_live_says_why(stack: FieldStack) -> None:
    with pytest.raises(ComputeError, match="automatic values have been chosen"):
        LiveField(stack.images, 4.0, Recipe())
    recipe = settled_recipe(stack)
    with pytest.raises(ComputeError, match="8-bit grey, not uint16"):
        LiveField(stack.images.astype(np.uint16), 4.0, recipe)
    field = LiveField(stack.images, 4.0, recipe)
    field.take(3, 5)
    assert np.flatnonzero(field.came).tolist() == [3, 4]
    with pytest.raises(ComputeError, match="added already"):
        field.take(4, 6)
