"""Imported grids whose overlap was assumed: the images tell the pitch, and the pixel size is not blamed."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest

from tests.support.plans import plan_without_motion
from tests.truth.drawn_grids import PIXEL_UM, drawn, made
from wafer_viewer.model.acquisition.plan import Field, FocusSweep
from wafer_viewer.model.errors import ComputeError
from wafer_viewer.model.job import Job
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.recipe import Recipe, Stitching
from wafer_viewer.reconstruct.stitching import stitch
from wafer_viewer.session.surface.stitching_inputs import StitchingInputs
from wafer_viewer.session.surface.stitching_job import bring_up_to_date
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.dataset.scan_record import JOURNAL, ScanRecord, write_record

RESULT = "default"
TILES = {"kind": "random", "rows": 3, "cols": 4, "shape": (150, 200), "stage_px": 2.0, "backlash_px": 0.0}
TILES |= {"drift_px": 0.0, "turn": 0.0, "scale": 0.0, "blank": 0.0, "noise": 2.0, "dust": 0.0, "missing": ()}
TILES |= {"misfits": ()}


def imported(path, overlap, assumed, seed=1000, **changes):
    """Return the folder of a dataset as an import leaves it behind, and the grid that it holds."""
    asked = {"overlap": overlap, "stated_overlap": assumed, **changes}
    grid = made(dataclasses.replace(drawn(seed), **(TILES | asked)))
    rows, cols = grid.drawn.shape
    pitch_um = cols * PIXEL_UM * (1 - assumed), rows * PIXEL_UM * (1 - assumed)
    fields, heights = [], []
    for n, height in enumerate(grid.heights):
        row, col = divmod(n, grid.drawn.cols)
        x_um, y_um = col * pitch_um[0], -row * pitch_um[1]
        fields.append(Field(number=n + 1, row=row, col=col, x_um=x_um, y_um=y_um, z_start_um=0.0))
        corner = {"x0_um": x_um - (cols - 1) / 2 * PIXEL_UM, "y0_um": y_um + (rows - 1) / 2 * PIXEL_UM}
        heights.append(dataclasses.replace(height, **corner))
    job = Job(fields=tuple(fields), sweep=FocusSweep(z_step_um=4.0, n_frames=5))
    plan = plan_without_motion(job, grid.drawn.shape, PIXEL_UM)
    path.mkdir()
    (path / JOURNAL).touch()
    when = {"software_version": "test", "taken": "2026-01-01T00:00:00"}
    write_record(path, ScanRecord(imported_from="tiles", job=job, plan=plan, **when))
    stored = Dataset.open(path).result(RESULT)
    for field, height in zip(fields, heights, strict=True):
        stored.save_surface(field, height)
    return path, grid


def off_px(poses, grid):
    """Return how far fields are from where they truly are, apart from the place of the whole, in pixels."""
    off = np.column_stack((poses.x_um, poses.y_um)) - grid.true_um
    return np.abs(off - off.mean(axis=0)).max() / PIXEL_UM


@pytest.mark.campaign(at_least_one=True)
@pytest.mark.parametrize(("overlap", "assumed"), [(0.12, 0.1), (0.15, 0.3), (0.4, 0.1)])
def test_images_tell_the_overlap_of_an_import(tmp_path, overlap, assumed):
    path, grid = imported(tmp_path / "a.wafer", overlap, assumed)
    bring_up_to_date(path, RESULT, Recipe())
    stored = Dataset.open(path).result(RESULT)
    poses = stored.poses()
    assert off_px(poses, grid) < 0.1
    assert poses.shifts.believed.all()
    (note,) = stored.mosaic().provenance.notes
    told = [float(share) / 100 for share in re.findall(r"([\d.]+)%", note)]
    assert told == pytest.approx([*mean_overlap(grid), assumed], abs=1e-3)
    window = stored.mosaic().window()
    assert np.isfinite(window.z_raw_um).sum() > 0.95 * covered_px(grid)


def mean_overlap(grid):
    """Return the true overlap along rows and along columns, on average."""
    true = grid.true_um.reshape(grid.drawn.rows, grid.drawn.cols, 2) / PIXEL_UM
    rows, cols = grid.drawn.shape
    at_row, at_col = np.arange(grid.drawn.rows), np.arange(grid.drawn.cols)
    right, down = (
        np.polyfit(at_col, true[..., 0].mean(axis=0), 1)[0],
        -np.polyfit(at_row, true[..., 1].mean(axis=1), 1)[0],
    )
    return 1 - right / cols, 1 - down / rows


def covered_px(grid):
    (rows, cols), overlap = grid.drawn.shape, grid.drawn.overlap
    return (rows + 2 * rows * (1 - overlap)) * (cols + 3 * cols * (1 - overlap))


@pytest.mark.slow
def test_fields_stay_where_they_were_found(tmp_path):
    path, _ = imported(tmp_path / "a.wafer", 0.2, 0.1)
    stored = Dataset.open(path).result(RESULT)
    bring_up_to_date(path, RESULT, Recipe())
    shown = {file: file.stat().st_mtime_ns for file in stored.mosaic_path.rglob("*/0/c/*/*")}
    before = stored.poses()
    assert StitchingInputs.open(path, RESULT, Recipe()).previous_solution().unchanged.all()
    bring_up_to_date(path, RESULT, Recipe())
    assert {file: file.stat().st_mtime_ns for file in stored.mosaic_path.rglob("*/0/c/*/*")} == shown
    assert stored.poses().notes == before.notes
    bring_up_to_date(path, RESULT, Recipe(stitching=Stitching(poses="stage")))
    planned_um = [field.x_um for field in Dataset.open(path).fields]
    np.testing.assert_array_equal(stored.poses().x_um, planned_um)


def test_stated_positions_are_not_estimated(tmp_path):
    path, _ = imported(tmp_path / "a.wafer", 0.12, 0.1)
    record = Dataset.open(path).scan
    assert record.assumed_overlap == 0.1
    *others, last = record.plan.fields
    moved = replace(record.plan, fields=(*others, replace(last, x_um=last.x_um + 0.01)))
    assert replace(record, plan=moved).assumed_overlap is None
    assert replace(record, imported_from="").assumed_overlap is None


def test_pixel_size_is_not_blamed_in_memory(tmp_path):
    path, grid = imported(tmp_path / "a.wafer", 0.12, 0.2)
    data = Dataset.open(path)
    stated = [data.result(RESULT).surface(field) for field in data.fields]
    with pytest.raises(ComputeError, match="a pixel is"):
        stitch(stated)
    assumed = [dataclasses.replace(h, provenance=replace(h.provenance, positions_assumed=True)) for h in stated]
    poses = stitch(assumed).poses
    assert not poses.notes
    assert off_px(poses, grid) < 0.1


@pytest.mark.slow
def test_overlap_is_not_guessed_from_a_pattern(tmp_path):
    dies = {"kind": "dies", "pitch_px": (30.0, 30.0), "angle": 0.0, "stage_px": 1.0}
    path, _ = imported(tmp_path / "a.wafer", 0.16, 0.1, **dies)
    bring_up_to_date(path, RESULT, Recipe())
    notes = Dataset.open(path).result(RESULT).mosaic().provenance.notes
    assert notes[0].startswith("The images do not tell by how much the fields overlap, and the 10.0% of the import may")
    assert not any("a pixel is" in note for note in notes)
