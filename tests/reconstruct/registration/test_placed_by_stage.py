"""Stitching that decided nothing says so: patterns finer than the stage's error, and groups that hang on the stage."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
import tifffile
from scipy.ndimage import gaussian_filter

from tests.support.overlapping_tiles import PIXEL_UM, Sample, a_field, a_sample
from wafer_viewer.cli.app import main
from wafer_viewer.model.acquisition.plan import Field
from wafer_viewer.model.surface.field_poses import Poses
from wafer_viewer.model.surface.height_map import HeightMap
from wafer_viewer.model.surface.recipe import Recipe, Stitching
from wafer_viewer.reconstruct.registration.misplaced_fields import BY_STAGE_ALONE
from wafer_viewer.reconstruct.stitching import stitch
from wafer_viewer.session.surface.focus_evidence import stitching_info
from wafer_viewer.store.dataset.stack_import import import_dataset

SHAPE = (120, 140)
PITCH = (95, 112)


def dies(pitch_px: int, shape: tuple[int, int], seed: int = 0) -> Sample:
    """A wafer of equal dies, whose picture repeats in every `pitch_px`."""
    rng = np.random.default_rng(seed)
    cell, relief = (gaussian_filter(rng.normal(size=(pitch_px, pitch_px)), 1.5, mode="wrap") for _ in range(2))
    times = tuple(-(-n // pitch_px) for n in shape)
    grey, z = (np.tile(layer, times)[: shape[0], : shape[1]] for layer in (cell, relief))
    return Sample(110 + 18 * grey / grey.std(), z / z.std())


def scanned(samples: list[Sample], n: int, seed: int = 3) -> tuple[list[HeightMap], list[Field]]:
    """n x n fields, each of the sample of its column group, where a stage puts them that errs by 3 px."""
    rng = np.random.default_rng(seed)
    heights, fields = [], []
    for row in range(n):
        for col in range(n):
            sample = samples[col * len(samples) // n]
            at = 10 + row * PITCH[0], 10 + col * PITCH[1]
            height = a_field(sample, *at, SHAPE, off_px=tuple(rng.normal(0, 3, 2)), seed=len(heights))
            x_um = height.x0_um + (SHAPE[1] - 1) / 2 * PIXEL_UM
            y_um = height.y0_um - (SHAPE[0] - 1) / 2 * PIXEL_UM
            number = len(heights) + 1
            fields.append(Field(number=number, row=row, col=col, x_um=x_um, y_um=y_um, z_start_um=0.0))
            heights.append(height)
    return heights, fields


def wafer(n: int) -> tuple[int, int]:
    return 40 + n * PITCH[0] + SHAPE[0], 40 + n * PITCH[1] + SHAPE[1]


def stitched(samples: list[Sample], n: int, recipe: Recipe = Recipe()) -> tuple[Poses, tuple[str, ...]]:
    mosaic = stitch(*scanned(samples, n), recipe)
    assert mosaic.poses is not None
    return mosaic.poses, mosaic.provenance.notes


@pytest.mark.slow
def test_dies_finer_than_the_search_are_placed_by_all_overlaps_together():
    poses, notes = stitched([dies(30, wafer(4))], 4)
    assert poses.shifts.believed.all()
    (note,) = [note for note in notes if "repeating pattern" in note]
    assert note.startswith("24 of 24 overlaps show a repeating pattern: which period is right was decided by the stage")
    moved = np.random.default_rng(3).normal(0, 3, (16, 2)) * PIXEL_UM  # down and right, as the fields were taken
    off = np.column_stack((poses.y_um - poses.stage_y_um + moved[:, 0], poses.x_um - poses.stage_x_um - moved[:, 1]))
    assert np.abs(off - off.mean(axis=0)).max() < 0.05 * PIXEL_UM
    info = stitching_info(poses)
    assert info is not None
    assert (info.n_by_stage, info.n_periodic) == (0, 24)
    assert info.period_probability is not None
    assert info.period_probability > 0.98
    assert "each by more than 99.9 %" in note or "the least sure by" in note


@pytest.mark.slow
def test_dies_finer_than_the_stage_are_reported_to_lie_where_the_stage_says():
    poses, notes = stitched([dies(10, wafer(4))], 4)
    assert not poses.shifts.believed.any()
    (note,) = [note for note in notes if note.startswith(BY_STAGE_ALONE)]
    assert "24 of 24 overlaps ambiguous (repeating pattern)" in note
    assert "set search_um" in note
    (why,) = [note for note in notes if "no period was chosen" in note]
    told = re.search(r"a pattern that repeats every (.*) um, and the stage is off by", why)
    assert told is not None
    assert float(told[1]) == pytest.approx(5.0, rel=0.02)
    info = stitching_info(poses)
    assert info is not None
    assert info.n_by_stage == 16


@pytest.mark.slow
def test_a_wafer_that_its_overlaps_place_says_nothing_of_the_stage():
    poses, notes = stitched([a_sample(wafer(3))], 3)
    assert poses.shifts.believed.all()
    assert not any("stage" in note for note in notes)
    info = stitching_info(poses)
    assert info is not None
    assert info.n_by_stage == 0


@pytest.mark.slow
def test_the_mend_that_the_note_names_helps():
    poses, notes = stitched([dies(30, wafer(3))], 3, Recipe(stitching=Stitching(search_um=6.0)))
    assert poses.shifts.believed.mean() > 0.8
    assert not any(note.startswith(BY_STAGE_ALONE) for note in notes)


@pytest.mark.slow
def test_fields_that_hang_on_the_stage_next_to_others_are_named():
    """The left half is of random texture, the right half of dies too fine for the stage."""
    shape = wafer(4)
    left, right = a_sample(shape), dies(10, shape)
    textured = np.arange(shape[1]) < 10 + 2 * PITCH[1] - 14
    joint = Sample(np.where(textured, left.grey, right.grey), np.where(textured, left.z_um, right.z_um))
    poses, notes = stitched([joint], 4)
    info = stitching_info(poses)
    assert info is not None
    assert 4 <= info.n_by_stage <= 8
    (note,) = [note for note in notes if "placed by the stage alone" in note]
    assert note.startswith("Fields ")
    assert "ambiguous (repeating pattern)" in note


@pytest.mark.slow
def test_the_command_line_says_that_the_stage_alone_placed_the_fields(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    heights, fields = scanned([dies(10, wafer(2))], 2)
    (tmp_path / "images").mkdir()
    for height, field in zip(heights, fields, strict=True):
        sharp = height.all_in_focus.astype(float)
        frames = [gaussian_filter(sharp, 1.2 * abs(k - 3)).round().astype(np.uint8) for k in range(7)]
        tifffile.imwrite(tmp_path / "images" / f"r{field.row}c{field.col}.tif", np.stack(frames))
    overlap = 1 - PITCH[1] / SHAPE[1]
    data = import_dataset(
        tmp_path / "images", tmp_path / "dies.wafer", 2.0, PIXEL_UM, "r{row}c{col}.tif", overlap_fraction=overlap
    )
    assert main(["stitch", str(data.path), "--workers", "1"]) == 0
    observations = json.loads(capsys.readouterr().out)
    start = f"{BY_STAGE_ALONE}: 4 of 4 overlaps ambiguous (repeating pattern)."
    assert any(note.startswith(start) for note in observations["recipe_notes"])
    assert any(note.startswith(start) for note in observations["stitching"]["notes"])
    assert observations["stitching"]["n_by_stage"] == 4
