"""A session as a person has it: on the virtual rig, with small jobs that are quickly taken."""

from __future__ import annotations

import multiprocessing

import pytest

from tests.support.kept_processes import kept_processes
from tests.support.patience import PATIENCE_S
from wafer_viewer.model.acquisition.plan import FieldGrid, FocusSweep
from wafer_viewer.model.acquisition.sample import Sample
from wafer_viewer.model.job import Job
from wafer_viewer.rigs.rig_config import RigConfig
from wafer_viewer.session.session import Session

__all__ = ["kept_processes"]


def small_job(cols=2, rows=1, n_frames=20, z_step_um=2.4):
    grid = FieldGrid(rows=rows, cols=cols, field_width_um=336.4488, field_height_um=252.3366)
    return Job(
        product="test",
        sample=Sample(name="die", lot="L1", wafer_id="W1"),
        grid=grid.centred_on(800.0, 560.0),
        z_start_um=-6.0,
        sweep=FocusSweep(z_step_um=z_step_um, n_frames=n_frames),
    )


def process_of(part):
    """The child process of a session that hosts the rig, or compute."""
    return next(p for p in multiprocessing.active_children() if p.name == f"wafer-viewer {part}")


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    made = Session(tmp_path_factory.mktemp("data"), RigConfig(seed=0))
    made.wait_until(lambda s: s.rig.state == "ready" and s.compute_ready, PATIENCE_S)
    yield made
    made.close()


@pytest.fixture(scope="session")
def job():
    return small_job


@pytest.fixture(scope="session")
def child():
    return process_of


@pytest.fixture(scope="session")
def surfaced():
    """Whether a scan is over, stitched and nothing is at work any more."""
    return lambda snapshot: snapshot.surface_is_whole
