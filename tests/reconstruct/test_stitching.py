"""Stitching at the prompt: fields on a stage that errs become one surface, and what is odd is named."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import wafer_viewer as wv
from tests.truth.field_grid import PIXEL_UM, SMALL, make, simulated, truth_of
from wafer_viewer.model.errors import ComputeError
from wafer_viewer.model.surface.field_poses import RejectionReason
from wafer_viewer.model.surface.height_map import Provenance
from wafer_viewer.model.surface.recipe import Recipe, Stitching


@pytest.fixture(scope="module")
def made():
    return make(SMALL)


@pytest.fixture
def odd():
    """Grids of which something is wrong, thrown away afterwards."""
    grids = []

    def make_odd(**changes):
        grids.append(make(dataclasses.replace(SMALL, **changes)))
        return grids[-1]

    yield make_odd
    for grid in grids:
        grid.remove()


def test_fields_lie_where_they_truly_are_and_neighbours_meet(made):
    reported: list[float] = []
    mosaic = wv.stitch(made.heights, made.fields, progress=reported.append)
    poses = mosaic.poses
    assert max(reported) == pytest.approx(1.0)
    assert _off_px(poses, made).max() < 0.3
    assert poses.shifts.believed.all()
    assert np.median(np.abs(poses.seams.step_um)) < 0.02
    assert np.all(poses.u_x_um > 0)
    assert not poses.left_out.any()
    by_stage = wv.stitch(made.heights, made.fields, Recipe.paper())
    np.testing.assert_allclose(by_stage.poses.x_um, [f.x_um for f in made.fields])
    overlap, nominal = (np.nanmedian(m.window().overlap_um) for m in (mosaic, by_stage))
    assert overlap < 0.9 * nominal


@pytest.mark.slow
@pytest.mark.parametrize(
    ("what", "sentence"),
    [
        ("mirrored", "Field 6 is mirrored left to right and was left out"),
        ("turned", "Field 6 is turned by half a turn and was left out"),
        ("foreign", "Field 6 fits none of its"),
    ],
)
def test_a_field_that_fits_nowhere_is_named_and_left_out(odd, what, sentence):
    made = odd(**{what: (5,)})
    mosaic = wv.stitch(made.heights, made.fields)
    assert [n for n, out in zip(mosaic.poses.numbers, mosaic.poses.left_out, strict=True) if out] == [6]
    assert any(sentence in note for note in mosaic.provenance.notes)
    stored = ~mosaic.poses.left_out
    assert _off_px(mosaic.poses, made)[stored].max() < 0.4
    field = made.fields[5]
    middle = mosaic.window(wv.Region.rectangle(field.x_um, field.y_um, field.x_um + 2, field.y_um + 2))
    assert (middle.origin == wv.Origin.NOT_COVERED).all()


@pytest.mark.slow
def test_a_field_without_heights_is_named(odd):
    made = odd(empty=(5,))
    mosaic = wv.stitch(made.heights, made.fields)
    assert any("Field 6 has no height at all" in note for note in mosaic.provenance.notes)


def test_fields_that_overlap_nobody_stay_at_the_stage_and_are_named(made):
    picked = [0, 1, 8, 11]  # two neighbours, and two further down that touch no other but each other
    mosaic = wv.stitch([made.heights[n] for n in picked], [made.fields[n] for n in picked])
    poses = mosaic.poses
    assert poses.group[0] == poses.group[1]
    assert poses.group[2] == poses.group[3] != poses.group[0]
    alone = wv.stitch([made.heights[n] for n in (0, 1, 5)], [made.fields[n] for n in (0, 1, 5)])
    # field 6 overlaps none of the two beside it but diagonally, if at all
    assert alone.poses.numbers.tolist() == [1, 2, 6]


def test_one_field_is_a_surface_too(made):
    mosaic = wv.stitch(made.heights[:1], made.fields[:1])
    assert mosaic.shape == made.heights[0].shape
    assert mosaic.poses.shifts.first.size == 0
    assert mosaic.provenance.notes == made.heights[0].provenance.notes


def test_a_wrong_pixel_size_is_refused(made):
    wrong = [_with_pixel(h, f, 1.08 * PIXEL_UM) for h, f in zip(made.heights, made.fields, strict=True)]
    with pytest.raises(ComputeError, match=r"a pixel is 0\.46.* um, not 0\.50467 um"):
        wv.stitch(wrong, made.fields)


def test_fields_of_two_scans_are_distinguished(made):
    real = dataclasses.replace(made.heights[1], provenance=Provenance())
    notes = " ".join(wv.stitch([made.heights[0], real]).provenance.notes)
    assert "1 of the 2 fields are simulated" in notes
    assert "in steps of 0, 4 um" in notes


def test_pixel_sizes_do_not_mix(made):
    other = dataclasses.replace(made.heights[1], pixel_um=0.5)
    with pytest.raises(ComputeError, match="um per pixel cannot be stitched"):
        wv.stitch([made.heights[0], other])


def test_without_a_field_there_is_nothing_to_stitch():
    with pytest.raises(ComputeError, match="There is no field to stitch"):
        wv.stitch([])


def test_a_search_at_its_limit_is_rejected_for_the_stage_position(made):
    mosaic = wv.stitch(made.heights, made.fields, Recipe(stitching=Stitching(search_um=0.5)))
    doubt = mosaic.poses.shifts.doubt
    assert (doubt != RejectionReason.NONE).sum() > len(doubt) / 2


@pytest.mark.campaign
def test_the_uncertainties_of_small_overlaps_are_not_too_small_by_chance():
    """Their two or three displaced parts say little about how far parts of this scan are displaced."""
    normalised = []
    for seed in range(1040, 1045):
        grid = dataclasses.replace(SMALL, seed=seed)
        truth, fields = truth_of(grid), grid.plan.fields()
        poses = wv.stitch([simulated(truth, field, n) for n, field in enumerate(fields)], fields).poses
        shifts, moved_x, moved_y = poses.shifts, truth.x_um - poses.stage_x_um, truth.y_um - poses.stage_y_um
        off_x = shifts.x_um - (moved_x[shifts.second] - moved_x[shifts.first])
        off_y = shifts.y_um - (moved_y[shifts.second] - moved_y[shifts.first])
        normalised.append(np.column_stack((off_x / shifts.u_x_um, off_y / shifts.u_y_um))[shifts.believed])
    assert np.mean(np.abs(np.concatenate(normalised)) > 3) < 0.03
    assert 0.8 < np.sqrt(np.mean(np.square(np.concatenate(normalised)))) < 1.2


def _off_px(poses, made) -> np.ndarray:
    """How far each field lies from the truth; the whole, which only the stage knows, moved as well as possible."""
    off_x, off_y = poses.x_um - made.known.x_um, poses.y_um - made.known.y_um
    stored = ~poses.left_out
    return np.hypot(off_x - off_x[stored].mean(), off_y - off_y[stored].mean()) / PIXEL_UM


def _with_pixel(height, field, pixel_um):
    rows, cols = height.shape
    x0_um, y0_um = field.x_um - (cols - 1) / 2 * pixel_um, field.y_um + (rows - 1) / 2 * pixel_um
    return dataclasses.replace(height, pixel_um=pixel_um, x0_um=x0_um, y0_um=y0_um)
