"""Datasets of scans of gauge blocks: one field each, whose surface is there already."""

from __future__ import annotations

from pathlib import Path

from tests.support.plans import plan_without_motion
from tests.support.surfaces import PIXEL_UM, STEP_UM, gauge_blocks
from wafer_viewer.model.acquisition.calibration import Calibration
from wafer_viewer.model.acquisition.plan import Field, FocusSweep
from wafer_viewer.model.job import Job
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.height_map import HeightMap
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.dataset.scan_record import JOURNAL, ScanRecord, write_record

RIG, RESULT = "Virtual rig", "default"
UPPER, LOWER = Region.rectangle(-150, -50, -10, 50), Region.rectangle(10, -50, 150, 50)
CORNERS = ("--upper", "-150", "-50", "-10", "50", "--lower", "10", "-50", "150", "50")
CALIBRATION = Calibration(
    pixel_um=PIXEL_UM, u_pixel_um=0.0, u_z_scale=1e-4, made="2026-01-01", due="2999-12-31", against="a ruler"
)


def surface(seed: int, error_um: float = 0.0, calibration: Calibration | None = CALIBRATION) -> HeightMap:
    """The blocks with their step wrong by an error, and noise of 0.2 um that is correlated over 2 px."""
    return gauge_blocks(
        seed,
        noise_um=0.2,
        correlation_px=2.0,
        tilt=0.0,
        scale_error=error_um / STEP_UM,
        calibration=calibration,
        simulated=True,
        input_checksum=f"{seed}",
    )


def scan_of_blocks(folder: Path, seed: int, error_um: float = 0.0, calibration=CALIBRATION, taken="2026-06-01") -> Path:
    """A finished scan ``scan-SEED.wafer`` in a data folder."""
    path, heights = folder / f"scan-{seed}.wafer", surface(seed, error_um, calibration)
    sweep = FocusSweep(z_step_um=4.0, n_frames=5)
    field = Field(number=1, row=0, col=0, x_um=0.0, y_um=0.0, z_start_um=0.0)
    job = Job(fields=(field,), sweep=sweep)
    plan = plan_without_motion(job, heights.shape, PIXEL_UM)
    path.mkdir(parents=True)
    (path / JOURNAL).touch()
    facts = {"software_version": "test", "taken": f"{taken}T10:00:00", "rig": RIG, "simulated": True}
    write_record(path, ScanRecord(**facts, calibration=calibration, job=job, plan=plan))
    Dataset.open(path).result(RESULT).save_surface(field, heights)
    return path
