"""Two gauge blocks wrung to a platen, as a surface in memory and as datasets on disk; a certificate for them."""

from __future__ import annotations

import dataclasses
import datetime
from pathlib import Path

import numpy as np
from scipy import ndimage

from tests.support.page_stand_in import height_map
from tests.support.plans import plan_without_motion
from wafer_viewer.model.acquisition.calibration import Calibration
from wafer_viewer.model.acquisition.plan import Field, FocusSweep
from wafer_viewer.model.gauge import Certificate, GaugeBlock
from wafer_viewer.model.job import Job
from wafer_viewer.model.surface.height_map import HeightMap, Provenance
from wafer_viewer.model.surface.recipe import Recipe, Stitching
from wafer_viewer.rigs.virtual.rig import SETUP
from wafer_viewer.session.surface.stitching_job import bring_up_to_date
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.dataset.scan_record import JOURNAL, ScanRecord, write_record

ROWS, COLS, PIXEL_UM = 480, 700, 1.1
STEP_UM, NOISE_UM = 399.92, 0.4
GAP_PX, EDGE_PX, OFFSET_PX = 24, 20, 60
RECIPE = Recipe(stitching=Stitching(poses="stage"))
CALIBRATION = Calibration(
    pixel_um=PIXEL_UM, u_pixel_um=0.0004, u_z_scale=0.0003, setup=SETUP, made="2026-01-12", due="2099-01-12",
    against="laser interferometer", simulated=True,
)  # fmt: skip
RIG_NAME = "Virtual rig"


def certificate(expires: str = "2099-03-14") -> Certificate:
    """Of the two blocks: 399.880 um with U 0.060 um."""
    blocks = (
        GaugeBlock(serial_number="21-0447", nominal_um=1400.0, value_um=1399.94, expanded_um=0.042),
        GaugeBlock(serial_number="21-0448", nominal_um=1000.0, value_um=1000.06, expanded_um=0.042),
    )
    return Certificate(
        number="K-2231", laboratory="an example", issued=datetime.date(2025, 3, 14),
        expires=datetime.date.fromisoformat(expires), blocks=blocks, grade="0",
    )  # fmt: skip


CERTIFICATE_TOML = """
number = "K-2231"
laboratory = "an example"
issued = 2025-03-14
expires = {expires}
nominal_um = 400.0
value_um = 399.88
expanded_um = 0.06
serial_numbers = ["21-0447", "21-0448"]
variation_um = 0.05
"""


def blocks(step_um: float = STEP_UM, seed: int = 1) -> HeightMap:
    """The lower block on the left, the upper one on the right and further up; round them nothing is measured."""
    rng = np.random.default_rng(seed)
    row, col = np.mgrid[:ROWS, :COLS]
    middle = COLS // 2
    lower = (col > EDGE_PX) & (col < middle - GAP_PX) & (row > OFFSET_PX) & (row < ROWS - EDGE_PX)
    upper = (col > middle + GAP_PX) & (col < COLS - EDGE_PX) & (row > EDGE_PX) & (row < ROWS - OFFSET_PX)
    lay = ndimage.gaussian_filter1d(rng.normal(0, 1, (ROWS, COLS)), 18, axis=1)
    z = NOISE_UM * ndimage.gaussian_filter(rng.normal(0, 1, (ROWS, COLS)), 1.2) * 3 + 0.3 * lay
    z = z + 2e-4 * PIXEL_UM * col + np.where(upper, step_um, 0.0)
    z[~(upper | lower)] = np.nan
    grey = np.clip(128 + 120 * lay, 0, 255).astype(np.uint8)
    provenance = Provenance(
        recipe=RECIPE, calibration=CALIBRATION, input_checksum=f"scan {seed}", z_step_um=4.0, simulated=True
    )
    made = height_map(z, PIXEL_UM, -(COLS - 1) / 2 * PIXEL_UM, (ROWS - 1) / 2 * PIXEL_UM, grey)
    return dataclasses.replace(made, provenance=provenance)


def dataset_of_blocks(path: Path, step_um: float, seed: int, taken: str) -> Path:
    """A dataset with one field of the blocks, which has its surface."""
    height = blocks(step_um, seed)
    field = Field(number=1, row=0, col=0, x_um=0.0, y_um=0.0, z_start_um=-10.0)
    sweep = FocusSweep(z_step_um=4.0, n_frames=5)
    job = Job(fields=(field,), sweep=sweep)
    plan = plan_without_motion(job, (ROWS, COLS), PIXEL_UM)
    path.mkdir(parents=True)
    (path / JOURNAL).touch()
    record = ScanRecord(
        software_version="test", taken=taken, job=job, plan=plan, simulated=True,
        calibration=CALIBRATION, setup=SETUP, rig=RIG_NAME,
    )  # fmt: skip
    write_record(path, record)
    kept = Dataset.open(path).result()
    kept.save_recipe(RECIPE)
    kept.save_surface(field, height)
    bring_up_to_date(path, "default", RECIPE)
    return path
