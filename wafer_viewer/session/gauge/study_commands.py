"""Gauge studies: repeatability and reproducibility from a table, or from repeat scans of a data folder."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from wafer_viewer.model.gauge.gauge_rr import GaugeRR, Method
from wafer_viewer.model.quantity import Unit


@dataclass(frozen=True, slots=True)
class Studied:
    """Result of a study of one quantity; unit None: a table's values have an unknown unit."""

    name: str
    found: GaugeRR
    unit: Unit | None = None
    simulated: bool = False


class Studies:
    """Gauge studies, which any thread can request and which change nothing.

    Methods raise WaferViewerError on failure.
    """

    def gauge_rr(self, path: Path, method: Method = "anova", tolerance: float | None = None) -> tuple[Studied, ...]:
        """Return the share of the gauge in the observed spread.

        path: a CSV with part, appraiser and value, or a folder of repeat scans, which are measured if they have no
        verdict: one study for each feature of their job. tolerance: of a table's values, in their unit; scans have
        those of their job.
        """
        from wafer_viewer.measure.gauge.gauge_rr import gauge_rr
        from wafer_viewer.store.tables.study_csv import read_study

        path = Path(path).expanduser()
        if path.is_dir():
            return _of_scans(path, method)
        return (Studied(path.name, gauge_rr(read_study(path), method=method, tolerance=tolerance)),)


def _of_scans(folder: Path, method: Method) -> tuple[Studied, ...]:
    from wafer_viewer.measure.gauge.gauge_rr import study_rr
    from wafer_viewer.session.gauge.repeat_scans import studies_of

    made = studies_of([folder])
    return tuple(Studied(study.feature, study_rr(study, method), study.unit, study.simulated) for study in made)
