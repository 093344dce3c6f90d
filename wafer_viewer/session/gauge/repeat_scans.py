"""Repeatability studies from a table or from repeat scans: a wafer is a part, its operator the appraiser."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.gauge import GaugeRR, Method, Study
from wafer_viewer.model.job import Job
from wafer_viewer.model.measurement.feature import Die, Feature
from wafer_viewer.model.quantity import Quantity, Unit
from wafer_viewer.session.core.commands import query
from wafer_viewer.session.core.dataset_library import DEFAULT_RESULT
from wafer_viewer.session.planning.job_releases import read_job
from wafer_viewer.session.planning.revision_trial import datasets_of, judged_places
from wafer_viewer.session.planning.verdicts import stored_verdict
from wafer_viewer.store.dataset.dataset import Dataset

NOBODY = "not named"
"""Appraiser of scans without an operator name."""
Cells = Mapping[tuple[str, str], list[float]]
"""Trials in order of time, by part and appraiser."""


@dataclass(frozen=True, slots=True)
class _Scan:
    """Dataset of a study, with the name of its result."""

    data: Dataset
    result: str

    @property
    def part(self) -> str:
        """Wafer id. Raises MeasureError if there is none."""
        sample = self.data.scan.job.sample
        if not (name := sample.wafer_id.strip() or sample.name.strip()):
            raise MeasureError(f"{self.data.path.name} names no wafer: without its id the part is not known.")
        return name

    @property
    def appraiser(self) -> str:
        """Operator of the scan."""
        return self.data.scan.job.sample.operator.strip() or NOBODY


def studies_of(paths: Sequence[Path], job: Path | Job | None = None, result: str = DEFAULT_RESULT) -> tuple[Study, ...]:
    """Return a repeatability study of every feature of a job.

    A wafer is a part, its operator the appraiser, and each scan a trial. Features measured per die have one part for
    each die of each wafer.

    Parameters
    ----------
    paths : sequence of Path
        Datasets, or folders of them.
    job : Path or Job, optional
        Job with the features, or its ``PLAN.toml``. Default: the job of the first dataset by time of the scan.
    result : str, default "default"
        Name of the result of each dataset whose stitched surface is used.

    Returns
    -------
    tuple of Study
        One study for each feature with a place, in the order of the job; values [part][appraiser][trial] in the unit of
        the feature, trials in order of time.

    Raises
    ------
    MeasureError
        When the job has no feature with a place, a dataset names no wafer, a feature was not measured everywhere, or
        not every part was measured equally often by every appraiser.
    DatasetError
        When no dataset is found, or a dataset or its stitched surface cannot be opened.
    PlanError
        When the file of the job cannot be read or is invalid.

    Notes
    -----
    Values stored in a verdict on the same surface are used if they are of the same feature; the others are measured
    now. Scans without an operator count as those of one appraiser.

    References
    ----------
    .. [1] AIAG, Measurement Systems Analysis (MSA) reference manual.
    """
    scans = [_Scan(Dataset.open(path), result) for path in datasets_of(paths)]
    scans.sort(key=lambda scan: (scan.data.scan.taken, scan.data.path.name))
    studied_job = read_job(job) if isinstance(job, Path) else job or scans[0].data.scan.job
    studied = [feature for feature in studied_job.features if feature.has_place]
    if not studied:
        raise MeasureError("The job has no feature with a place: there is nothing to study.")
    return tuple(study_of(scans, feature, studied_job) for feature in studied)


def study_of(scans: Sequence[_Scan], feature: Feature, job: Job) -> Study:
    """Return the study of one feature over scans."""
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
    """Return the values of a feature in a scan, by die; a stored value is used if it belongs to the same feature."""
    result = scan.data.result(scan.result)
    verdict, dies_then = stored_verdict(scan.data, result), scan.data.scan.job.dies
    values = {
        item.die: item.measured
        for item in (verdict.items if verdict is not None and (not feature.per_die or dies_then == job.dies) else ())
        if item.measured is not None and item.feature.name == feature.name and item.feature.measures == feature.measures
    }
    dies = [die for other, die in judged_places(job) if other is feature]
    return {(die.name if die else ""): values.get(die.name if die else "") or _now(scan, feature, die) for die in dies}


def _now(scan: _Scan, feature: Feature, die: Die | None) -> Quantity:
    """Return the value of a feature, measured now. Raises MeasureError with the dataset's name if that fails."""
    from wafer_viewer.measure.verdict import measured_feature, quantity_of

    data = scan.data
    try:
        surface = data.result(scan.result).mosaic()
        measurement = measured_feature(surface, feature, die, data.scan.job.alignment, calibration_valid=True)
        return quantity_of(measurement, feature)
    except MeasureError as fault:
        on = f" on die {die.name}" if die is not None else ""
        raise MeasureError(f"'{feature.name}' was not measured{on} in {data.path.name}. {fault}") from fault


def _require_balanced(cells: Cells, name: str, parts: Sequence[str], appraisers: Sequence[str]) -> None:
    """Raise MeasureError if the numbers of trials per part and appraiser differ."""
    most = max(len(trials) for trials in cells.values())
    for part in parts:
        for appraiser in appraisers:
            if (n := len(cells.get((part, appraiser), ()))) < most:
                raise MeasureError(
                    f"The study of '{name}' is not balanced: part {part} has {n} {'scan' if n == 1 else 'scans'} by "
                    f"{appraiser} where others have {most}: scan it again, or leave others out."
                )


Values = Sequence[Sequence[Sequence[float]]]


@dataclass(frozen=True, slots=True)
class Studied:
    """Result of a study of one quantity; unit None: a table's values have an unknown unit.

    values: [part][appraiser][trial].
    """

    name: str
    found: GaugeRR
    values: Values
    unit: Unit | None = None
    simulated: bool = False


class Studies:
    """Gauge studies, which any thread can request and which change nothing.

    Methods raise WaferViewerError on failure.
    """

    @query
    def gauge_rr(self, path: Path, method: Method = "anova", tolerance: float | None = None) -> tuple[Studied, ...]:
        """Return the share of the gauge in the observed spread.

        path: a CSV with part, appraiser and value, or a folder of repeat scans, which are measured if they have no
        verdict: one study for each feature of their job. tolerance: of a table's values, in their unit; scans have
        those of their job.
        """
        from wafer_viewer.measure.gauge.gauge_studies import gauge_rr
        from wafer_viewer.store.tables.csv_tables import read_study

        path = Path(path).expanduser()
        if path.is_dir():
            return _of_scans(path, method)
        values = read_study(path)
        return (Studied(path.name, gauge_rr(values, method=method, tolerance=tolerance), values.tolist()),)


def _of_scans(folder: Path, method: Method) -> tuple[Studied, ...]:
    from wafer_viewer.measure.gauge.gauge_studies import study_rr

    made = studies_of([folder])
    return tuple(
        Studied(study.feature, study_rr(study, method), study.values, study.unit, study.simulated) for study in made
    )
