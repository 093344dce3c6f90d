"""Stored datasets whose stitched surface is made up: a step of known height, on a wafer that is aligned."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tests.support.datasets.released import MARKS, SETTLED
from tests.support.datasets.samples import CALIBRATION, make_job, make_plan
from tests.support.surfaces import height_map
from wafer_viewer.model.acquisition.sample import Alignment, Sample
from wafer_viewer.model.job import Job
from wafer_viewer.model.measurement.feature import Dies, Feature
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.height_map import HeightMap
from wafer_viewer.model.surface.recipe import Stitching
from wafer_viewer.session.core.dataset_library import save_summary, summarise
from wafer_viewer.session.planning.verdicts import verdict_of
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.dataset.scan_record import JOURNAL, ScanRecord, write_record
from wafer_viewer.store.mosaic.zarr_mosaic import write_mosaic

RESULT = "default"
RECIPE = replace(SETTLED, stitching=Stitching(search_um=20.0, stage_error_um=2.0, z_error_um=1.0, tilt_error=1e-4))
CALIBRATED = replace(CALIBRATION, due="2099-01-01")
ROWS, COLS, PIXEL_UM = 160, 240, 0.5
STEP = Feature(
    name="die over street",
    nominal=12.0,
    lower_limit=11.0,
    upper_limit=13.0,
    places=(Region.rectangle(-50, -30, -10, 30), Region.rectangle(10, -30, 50, 30)),
)
ELSEWHERE = (STEP.places[1], STEP.places[0])
"""The same faces the wrong way round: the step is as high, and downwards."""


def surface(height_um: float, seed: int = 2) -> HeightMap:
    """The left half of the map lies so much higher than the right one."""
    x = np.mgrid[:ROWS, :COLS][1]
    noise = np.random.default_rng(seed).normal(0, 0.05, x.shape)
    z = (np.where(x < COLS / 2, height_um, 0.0) + noise).astype(np.float32)
    x0_um, y0_um = -PIXEL_UM * (COLS - 1) / 2, PIXEL_UM * (ROWS - 1) / 2
    return height_map(z, PIXEL_UM, x0_um, y0_um, grey=120, recipe=RECIPE, calibration=CALIBRATED)


def released_job(*features: Feature, dies: Dies | None = None) -> Job:
    """A released job with features, of no wafer yet."""
    job = replace(make_job(), product="coupon", revision="A", strategy="z_snake", marks=MARKS, recipe=RECIPE)
    return replace(job, features=features or (STEP,), dies=dies, released=True)


def judged_dataset(
    path: Path, height_um: float, job: Job, *, wafer: str = "W1", operator: str = "", taken: str = "", seed: int = 2
) -> Path:
    """A stitched dataset with its verdict."""
    path.mkdir()
    (path / JOURNAL).touch()
    sample = Sample(wafer_id=wafer, lot="L7", operator=operator)
    job = replace(job, sample=sample, alignment=Alignment(n_marks=2))
    record = ScanRecord(
        software_version="1",
        taken=taken or "2026-03-01T10:00:00",
        calibration=CALIBRATED,
        job=job,
        plan=make_plan(replace(job, alignment=None)),
    )
    write_record(path, record)
    result = Dataset.open(path).result(RESULT)
    write_mosaic(result.mosaic_path, surface(height_um, seed))
    save_summary(result, summarise(result.mosaic(), 2, RESULT))
    verdict_of(Dataset.open(path), result, keep=True)
    return path
