"""Operator state: released jobs to choose from, and the verdict on the wafer."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from wafer_viewer.model.job.job import Job
from wafer_viewer.model.job.revision_trial import Trial
from wafer_viewer.model.job.verdict import WaferVerdict


@dataclass(frozen=True, slots=True)
class JobEntry:
    """Entry of the list of released jobs."""

    path: Path
    product: str
    revision: str
    n_fields: int
    n_features: int


@dataclass(frozen=True, slots=True)
class Operating:
    """Released jobs, wafer verdict and trial.

    judging: the features of the open dataset are being measured for their verdict. trial: result of a plan on stored
    wafers, `trial_of` that plan; trying: a trial is running.
    """

    jobs: tuple[JobEntry, ...] = ()
    verdict: WaferVerdict | None = None
    judging: bool = False
    trial: Trial | None = None
    trial_of: Job | None = None
    trying: bool = False
