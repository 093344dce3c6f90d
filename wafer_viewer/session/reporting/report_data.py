"""Input data of the report's parts, read once from a dataset's folder."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from wafer_viewer.model.findings import AnyResult
from wafer_viewer.model.gauge.gauge_check import GaugeCheck
from wafer_viewer.model.inspection.defect import Inspection
from wafer_viewer.model.job.review_notes import Notebook
from wafer_viewer.model.job.verdict import FeatureVerdict, WaferVerdict
from wafer_viewer.model.region import Region
from wafer_viewer.session.planning.verdicts import kept_verdict
from wafer_viewer.session.reporting.report_text import regions
from wafer_viewer.session.state.snapshot import SurfaceInfo

if TYPE_CHECKING:
    from wafer_viewer.store.dataset.dataset import Dataset
    from wafer_viewer.store.dataset.result import Result


@dataclass(frozen=True, slots=True)
class Material:
    """Input data of the report's parts."""

    dataset: Dataset
    result: Result
    info: SurfaceInfo | None
    findings: tuple[AnyResult, ...]
    notebook: Notebook
    verdict: WaferVerdict | None = None
    inspection: Inspection | None = None

    @property
    def day(self) -> str:
        """Day of the scan, ISO 8601."""
        return self.dataset.scan.taken[:10]

    @property
    def uncalibrated(self) -> str | None:
        """Reason why lengths are not calibrated, or None."""
        return self.dataset.calibration_problem(self.day)

    @property
    def features(self) -> tuple[FeatureVerdict, ...]:
        """Features of the verdict; empty if there is none."""
        return self.verdict.items if self.verdict is not None else ()

    @property
    def asks_for_a_verdict(self) -> bool:
        """True if the job has features to be judged."""
        return any(feature.has_place for feature in self.dataset.scan.job.features)

    @property
    def gauge_checks(self) -> tuple[GaugeCheck, ...]:
        """Gauge-block checks among the results."""
        return tuple(finding for finding in self.findings if isinstance(finding, GaugeCheck))

    @property
    def lines(self) -> tuple[tuple[AnyResult, Region], ...]:
        """Results measured along a line of the surface or of a field, each with its line."""
        found = ((f, next((r for r in regions(f) if r.kind == "line"), None)) for f in self.findings if f.show >= 0)
        return tuple((finding, line) for finding, line in found if line is not None)

    @property
    def pictures(self) -> list[Path]:
        """Pictures next to the dataset, in the order of their numbers."""
        from wafer_viewer.store.io.atomic_files import natural_sort_key

        path = self.dataset.path
        return sorted(path.parent.glob(f"{path.stem}-picture-*.png"), key=lambda p: natural_sort_key(p.name))


def gather(folder: Path, result_name: str) -> Material:
    """Read the report data of a dataset. Raises DatasetError when the folder is no dataset."""
    from wafer_viewer.session.core.surface_summary import load_summary
    from wafer_viewer.store.dataset.dataset import Dataset
    from wafer_viewer.store.records.inspection_file import read_inspection
    from wafer_viewer.store.records.review_notes import read_notebook

    dataset = Dataset.open(folder)
    result = dataset.result(result_name)
    info = load_summary(result) if result.has_mosaic else None
    return Material(
        dataset,
        result,
        info,
        result.findings().items,
        read_notebook(result.path),
        kept_verdict(result),
        read_inspection(result.path),
    )
