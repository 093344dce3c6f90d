"""Two datasets of one wafer: taken, and taken again after it was laid down anew and something was added to it."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from tests.support.compared_surfaces import taken, tilted, with_bump
from tests.support.plans import plan_without_motion
from wafer_viewer.model.acquisition.plan import Field, FocusSweep
from wafer_viewer.model.job import Job
from wafer_viewer.model.surface.height_map import HeightMap, Provenance
from wafer_viewer.model.surface.recipe import Recipe, Stitching
from wafer_viewer.session.surface.stitching_job import bring_up_to_date
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.dataset.scan_record import JOURNAL, ScanRecord, write_record

RECIPE = Recipe(stitching=Stitching(poses="stage"))
SHIFT_UM, BUMP_UM = (6.0, -4.0), 2.0


def dataset_of(path: Path, height: HeightMap, checksum: str, when: str) -> Path:
    """A dataset with one field, which has its surface."""
    x0, y0, x1, y1 = height.bounds_um
    field = Field(number=1, row=0, col=0, x_um=(x0 + x1) / 2, y_um=(y0 + y1) / 2, z_start_um=-10.0)
    sweep = FocusSweep(z_step_um=2.0, n_frames=5)
    job = Job(fields=(field,), sweep=sweep)
    plan = plan_without_motion(job, height.shape, height.pixel_um)
    path.mkdir(parents=True)
    (path / JOURNAL).touch()
    write_record(path, ScanRecord(software_version="test", taken=when, job=job, plan=plan, simulated=True))
    smooth = height.z_um.copy()
    smooth[1:-1] = (height.z_um[:-2] + height.z_um[1:-1] + height.z_um[2:]) / 3
    provenance = Provenance(recipe=RECIPE, input_checksum=checksum, simulated=True, z_step_um=2.0)
    stored = Dataset.open(path).result()
    stored.save_recipe(RECIPE)
    stored.save_surface(field, dataclasses.replace(height, z_um=smooth.astype(np.float32), provenance=provenance))
    bring_up_to_date(path, "default", RECIPE)
    return path


def two_datasets(folder: Path) -> tuple[Path, Path]:
    """Before and after: laid down by (6, -4) um off, 1 um higher and a little tilted, with a pad more of 60 x 40 um."""
    after = tilted(with_bump(taken(*SHIFT_UM, seed=1), slice(200, 240), slice(300, 360), BUMP_UM), 1.0, 0.5)
    return (
        dataset_of(folder / "before.wafer", taken(), "before", "2026-01-01T08:00:00"),
        dataset_of(folder / "after.wafer", after, "after", "2026-01-02T08:00:00"),
    )
