"""A dataset whose fields have surfaces already: those of a simulated grid, of which the truth is known."""

from __future__ import annotations

from pathlib import Path

from tests.truth.field_grid import Made
from wafer_viewer.model.acquisition.plan import FocusSweep, ScanPlan
from wafer_viewer.model.job import Job
from wafer_viewer.model.surface.recipe import Recipe, Stitching
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.dataset.result import Result
from wafer_viewer.store.dataset.scan_record import JOURNAL, ScanRecord, write_record

REGISTERED = Recipe(stitching=Stitching(poses="registered", blend="confidence"))
RESULT = "default"


def make_dataset(path: Path, made: Made) -> Path:
    """A dataset of the fields of a grid, none of which has a surface yet."""
    rows, cols = made.heights[0].shape
    sweep = FocusSweep(z_step_um=4.0, n_frames=5)
    plan = ScanPlan(
        fields=made.fields,
        sweep=sweep,
        exposures_us=(100.0,),
        strategy="z_up",
        legs=(),
        predicted_s=1.0,
        prices=(),
        rows=rows,
        cols=cols,
        pixel_um=made.heights[0].pixel_um,
    )
    path.mkdir()
    job = Job(fields=made.fields, sweep=sweep)
    (path / JOURNAL).touch()
    write_record(path, ScanRecord(software_version="test", taken="2026-01-01T00:00:00", job=job, plan=plan))
    return path


def add_surfaces(path: Path, made: Made, places: range | list[int]) -> Result:
    """Give some fields, by their places in the list, their surfaces."""
    stored = Dataset.open(path).result(RESULT)
    for place in places:
        stored.save_surface(made.fields[place], made.heights[place])
    return stored
