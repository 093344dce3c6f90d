"""Defects of fields that were stitched by their overlaps, and defects that only stand out in height."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tests.truth.defects import Plan, field_of, first_um, make
from tests.truth.matching import Matched, capture, match, plain
from tests.truth.patterned import scene_of
from tests.truth.planted import PITCH_PX, PIXEL_UM, Planted, planted
from wafer_viewer.measure.defects.inspection import inspect
from wafer_viewer.measure.dies.die_lattice import find_dies
from wafer_viewer.model.acquisition.plan import Field
from wafer_viewer.model.surface.height_map import HeightMap, Mosaic
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.reconstruct.field_pipeline import reconstruct
from wafer_viewer.reconstruct.stitching import stitch

pytestmark = pytest.mark.slow
SIGMA_UM = 0.186
OVERLAP_PX = 110
STAGE_OFF_PX = 1.5
MOST_FALSE = 10
"""Stitched, on 16 dies, 0.33 mm2: 6 are known, two of them at the ragged border."""


def stitched(plan: Plan, what: tuple[Planted, ...]) -> Mosaic:
    """Two by two fields that overlap, each told by the stage to lie a little off where it was taken."""
    dice, scene = np.random.default_rng(plan.seed), scene_of(plan, what)
    heights: list[HeightMap] = []
    fields: list[Field] = []
    cuts = [((0, (n + OVERLAP_PX) // 2), ((n - OVERLAP_PX) // 2, n)) for n in plan.shape]
    for rows in cuts[0]:
        for cols in cuts[1]:
            stack, _ = field_of(plan, scene, slice(*rows), slice(*cols), len(fields))
            x0_um, y0_um = first_um(plan)
            off_um = dice.normal(0, STAGE_OFF_PX, 2) * PIXEL_UM
            at = {"x_um": x0_um + (sum(cols) - 1) / 2 * PIXEL_UM, "y_um": y0_um - (sum(rows) - 1) / 2 * PIXEL_UM}
            reported = {"x_um": at["x_um"] + off_um[0], "y_um": at["y_um"] + off_um[1], "number": len(fields) + 1}
            fields.append(
                Field(row=int(rows[0] > 0), col=int(cols[0] > 0), z_start_um=stack.field.z_start_um, **reported)
            )
            heights.append(reconstruct(dataclasses.replace(stack, field=fields[-1]), Recipe(), threads=1))
    return stitch(heights, fields, Recipe())


def matched_on(surface: Mosaic, what: tuple[Planted, ...]) -> Matched:
    return match(what, inspect(surface, find_dies(surface)).found)


@pytest.mark.campaign
def test_stitched_fields_show_what_is_plain_and_little_else():
    plan = Plan(cols=4, rows=4, seed=41, odd_dies=False)
    what = planted(plan, SIGMA_UM)
    surface = stitched(plan, what)
    grid = find_dies(surface)
    assert (grid.pitch_x_um / PIXEL_UM, grid.pitch_y_um / PIXEL_UM) == pytest.approx(PITCH_PX, abs=0.1)
    matched = matched_on(surface, what)
    assert capture([matched], plain).share >= 0.8
    assert len(matched.false) <= MOST_FALSE


@pytest.mark.campaign
def test_defects_visible_only_in_height_are_found_if_large():
    """About six in ten: on single wafers it is two of five to six of seven."""
    wafers = [make(Plan(cols=6, rows=5, seed=seed, seen=False, odd_dies=False), SIGMA_UM) for seed in (31, 33)]
    matched = [matched_on(made.surface, made.planted) for made in wafers]
    large = capture(matched, lambda one: one.height_sigma >= 6 and one.diameter_px >= 20)
    assert large.of >= 10
    assert large.share >= 0.5
    assert sum(len(one.false) for one in matched) <= 3
