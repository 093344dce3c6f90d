"""A small dataset with a file of every kind that the program writes into one."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tests.support.datasets.inspections import defect, inspection
from tests.support.datasets.samples import CALIBRATION, SUMMARY, make_frame
from tests.support.plans import plan_without_motion
from wafer_viewer.model.acquisition.plan import FieldGrid, FocusSweep, Shot
from wafer_viewer.model.findings import MeasurementResults
from wafer_viewer.model.job import Job, Notebook, SavedView
from wafer_viewer.model.measurement.feature import Feature
from wafer_viewer.model.progress import silent
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.comparison import SurfaceName
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.session.planning.verdicts import verdict_of
from wafer_viewer.session.surface.comparison_job import keep_difference
from wafer_viewer.session.surface.headless import make_surface
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.dataset.writer import DatasetWriter
from wafer_viewer.store.records.inspection_records import write_inspection, write_notebook

ROWS, COLS, N_FRAMES, PIXEL_UM = 80, 120, 12, 0.5
UPPER, LOWER = Region.rectangle(5, -15, 15, 15), Region.rectangle(25, -15, 35, 15)
STEP = Feature(name="step", nominal=0.0, lower_limit=-5.0, upper_limit=5.0, places=(UPPER, LOWER))


def complete_dataset(path: Path) -> Path:
    """Scanned, reconstructed, stitched, measured, judged, inspected and compared."""
    _scan(path)
    make_surface(path, Recipe(), "default", again=False, tell=silent, warn=print)
    data = Dataset.open(path)
    stored = data.result()
    stored.save_findings(MeasurementResults(items=(_measured(path),)))
    stored.save_thumbnail(1, b"\xff\xd8 a picture \xff\xd9")
    write_notebook(stored.path, Notebook(views=(SavedView(number=1, position_mm=(0, 0, 1), look_at_mm=(0, 0, 0)),)))
    write_inspection(stored.path, inspection(defect(1, "0,0", 100.0, 50.0)))
    verdict_of(data, stored, keep=True)
    name = SurfaceName(path=str(path))
    keep_difference(path, "kept", replace(name, heights="raw"), replace(name, heights="cleaned"), "none", False, silent)
    return path


def _scan(path: Path) -> None:
    job = _job()
    plan = plan_without_motion(job, (ROWS, COLS), PIXEL_UM)
    texture = np.random.default_rng(3).normal(0, 1, (ROWS, 2 * COLS))
    with DatasetWriter.create(path, plan, job, calibration=replace(CALIBRATION, due="2099-01-01")) as writer:
        for number, leg in enumerate(plan.fields, 1):
            start = round((leg.x_um - plan.fields[0].x_um) / PIXEL_UM)
            for k in range(N_FRAMES):
                sharp = 6 + 40 * np.exp(-(((k - N_FRAMES / 2) / 2) ** 2))
                image = (128 + sharp * texture[:, start : start + COLS]).clip(0, 255).astype(np.uint8)
                writer.frame(make_frame(Shot(leg.number, k), plan, image))
            writer.pass_ended(number, SUMMARY)
        writer.finish()


def _job() -> Job:
    return Job(
        grid=FieldGrid(rows=1, cols=2, field_width_um=COLS * PIXEL_UM, field_height_um=ROWS * PIXEL_UM),
        z_start_um=-10.0,
        sweep=FocusSweep(z_step_um=2.0, n_frames=N_FRAMES),
        exposures_us=(100.0,),
        features=(STEP,),
    )


def _measured(path: Path):
    from wafer_viewer import step_height

    found = step_height(Dataset.open(path).result().mosaic(), upper=UPPER, lower=LOWER)
    return replace(found, number=1, name="step")
