"""A dataset whose fields have surfaces already: those of a simulated grid, of which the truth is known."""

from __future__ import annotations

from pathlib import Path

from tests.support.plans import plan_without_motion
from tests.truth.field_grid import Made
from wafer_viewer.model.acquisition.plan import FocusSweep
from wafer_viewer.model.job import Job
from wafer_viewer.model.surface.recipe import Recipe, Stitching
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.dataset.result import Result
from wafer_viewer.store.dataset.scan_record import JOURNAL, ScanRecord, write_record

REGISTERED = Recipe(stitching=Stitching(poses="registered", blend="confidence"))
RESULT = "default"


def make_dataset(path: Path, made: Made) -> Path:
    """A dataset of the fields of a grid, none of which has a surface yet."""
    sweep = FocusSweep(z_step_um=4.0, n_frames=5)
    job = Job(fields=made.fields, sweep=sweep)
    plan = plan_without_motion(job, made.heights[0].shape, made.heights[0].pixel_um)
    path.mkdir()
    (path / JOURNAL).touch()
    write_record(path, ScanRecord(software_version="test", taken="2026-01-01T00:00:00", job=job, plan=plan))
    return path


def add_surfaces(path: Path, made: Made, places: range | list[int]) -> Result:
    """Give some fields, by their places in the list, their surfaces."""
    stored = Dataset.open(path).result(RESULT)
    for place in places:
        stored.save_surface(made.fields[place], made.heights[place])
    return stored
