"""Repeat scans as studies of repeatability: a wafer is a part, its operator the appraiser, each scan of it a trial."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.gauge.gauge_rr import Study
from wafer_viewer.model.job.job import Job
from wafer_viewer.model.measurement.feature import Die, Feature
from wafer_viewer.model.quantity import Quantity
from wafer_viewer.session.core.dataset_library import DEFAULT_RESULT
from wafer_viewer.session.planning.plan_editor import read_job
from wafer_viewer.session.planning.revision_trial import datasets_of, judged_places
from wafer_viewer.session.planning.verdicts import kept_verdict
from wafer_viewer.store.dataset.dataset import Dataset

NOBODY = "not named"
"""The appraiser of scans whose operator was not given."""
Cells = Mapping[tuple[str, str], list[float]]
"""By part and appraiser, the trials in order of time."""


@dataclass(frozen=True, slots=True)
class _Scan:
    """One dataset of a study."""

    data: Dataset
    result: str

    @property
    def part(self) -> str:
        """The wafer's id. Raises MeasureError where it has none."""
        sample = self.data.scan.job.sample
        if not (name := sample.wafer_id.strip() or sample.name.strip()):
            raise MeasureError(f"{self.data.path.name} names no wafer: without its id the part is not known.")
        return name

    @property
    def appraiser(self) -> str:
        """Its operator."""
        return self.data.scan.job.sample.operator.strip() or NOBODY


def studies_of(paths: Sequence[Path], job: Path | Job | None = None, result: str = DEFAULT_RESULT) -> tuple[Study, ...]:
    """A study of every feature of a job, and of every die where it has some: each die of each wafer is a part.

    paths: datasets, or folders of them; job: that of the first dataset where left out. What was kept in a verdict is
    taken from there, the rest is measured now. Raises MeasureError for a feature that was not measured everywhere, and
    where not every part was measured equally often by everyone.
    """
    scans = [_Scan(Dataset.open(path), result) for path in datasets_of(paths)]
    scans.sort(key=lambda scan: (scan.data.scan.taken, scan.data.path.name))
    asked = read_job(job) if isinstance(job, Path) else job or scans[0].data.scan.job
    studied = [feature for feature in asked.features if feature.has_place]
    if not studied:
        raise MeasureError("The job has no feature with a place: there is nothing to study.")
    return tuple(study_of(scans, feature, asked) for feature in studied)


def study_of(scans: Sequence[_Scan], feature: Feature, job: Job) -> Study:
    """The study of one feature over scans."""
    cells: dict[tuple[str, str], list[float]] = defaultdict(list)
    for scan in scans:
        for die, quantity in _measured(scan, feature, job).items():
            part = f"{scan.part}, die {die}" if die else scan.part
            cells[part, scan.appraiser].append(quantity.value)
    parts, appraisers = (tuple(dict.fromkeys(key[k] for key in cells)) for k in range(2))
    _require_balanced(cells, feature.name, parts, appraisers)
    return Study(
        feature=feature.name,
        unit=feature.unit,
        parts=parts,
        appraisers=appraisers,
        values=tuple(tuple(tuple(cells[part, appraiser]) for appraiser in appraisers) for part in parts),
        tolerance=feature.tolerance,
        simulated=any(scan.data.simulated for scan in scans),
    )


def _measured(scan: _Scan, feature: Feature, job: Job) -> dict[str, Quantity]:
    """What a feature came to in a scan, by die; the kept number where the same one was kept."""
    result = scan.data.result(scan.result)
    verdict, dies_then = kept_verdict(result), scan.data.scan.job.dies
    kept = {
        item.die: item.measured
        for item in (verdict.items if verdict is not None and (not feature.per_die or dies_then == job.dies) else ())
        if item.measured is not None and item.feature.name == feature.name and item.feature.measures == feature.measures
    }
    dies = [die for of, die in judged_places(job) if of is feature]
    return {(die.name if die else ""): kept.get(die.name if die else "") or _now(scan, feature, die) for die in dies}


def _now(scan: _Scan, feature: Feature, die: Die | None) -> Quantity:
    """Raises MeasureError naming the dataset where the feature cannot be measured."""
    from wafer_viewer.measure.verdict import measured_feature, quantity_of

    data = scan.data
    try:
        surface = data.result(scan.result).mosaic()
        found = measured_feature(surface, feature, die, data.scan.job.alignment, calibration_valid=True)
        return quantity_of(found, feature)
    except MeasureError as fault:
        on = f" on die {die.name}" if die is not None else ""
        raise MeasureError(f"'{feature.name}' was not measured{on} in {data.path.name}. {fault}") from fault


def _require_balanced(cells: Cells, name: str, parts: Sequence[str], appraisers: Sequence[str]) -> None:
    """Raise MeasureError where somebody measured a part more often than somebody another."""
    most = max(len(trials) for trials in cells.values())
    for part in parts:
        for appraiser in appraisers:
            if (n := len(cells.get((part, appraiser), ()))) < most:
                raise MeasureError(
                    f"The study of '{name}' is not balanced: part {part} has {n} {'scan' if n == 1 else 'scans'} by "
                    f"{appraiser} where others have {most}: scan it again, or leave others out."
                )
