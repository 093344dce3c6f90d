"""Results of the conformance checks of a rig, and the report of them that a lab signs."""

from __future__ import annotations

from collections import Counter
from typing import Any, ClassVar, Literal

from wafer_viewer.model.acquisition.devices import DeviceIdentity
from wafer_viewer.model.errors import DatasetError, WaferViewerError
from wafer_viewer.model.spec import NonNegative, Spec

ConformanceVerdict = Literal["passed", "failed", "not run"]
ConformanceSubject = Literal["pulse box", "stage", "camera", "together"]


class CheckFigure(Spec, frozen=True, kw_only=True):
    """One number that a check measured, with its unit; 1 is the unit of numbers of things and of ratios."""

    error: ClassVar[type[WaferViewerError]] = DatasetError
    name: str
    value: float
    unit: str

    @property
    def text(self) -> str:
        """Name, value and unit."""
        unit = "" if self.unit == "1" else f" {self.unit}"
        return f"{self.name} {round(self.value, 3):.10g}{unit}"


class ConformanceResult(Spec, frozen=True, kw_only=True):
    """Result of one check.

    demand: what a rig has to do; why: reason for a failure or for not running it, empty if it passed; figures: what
    was measured.
    """

    error: ClassVar[type[WaferViewerError]] = DatasetError
    name: str
    title: str
    subject: ConformanceSubject
    demand: str
    verdict: ConformanceVerdict
    why: str = ""
    figures: tuple[CheckFigure, ...] = ()
    duration_s: NonNegative = 0.0


class ConformanceReport(Spec, frozen=True, kw_only=True):
    """All results of one run of the checks on a rig.

    rig_file: name of its file, empty for the default rig; config: all settings of the rig as TOML; at: ISO 8601;
    by: lab or person, as given; motions: ranges of the axes, empty if nothing was moved.
    """

    error: ClassVar[type[WaferViewerError]] = DatasetError
    rig: str
    simulated: bool
    rig_file: str
    config: str
    devices: tuple[DeviceIdentity, ...]
    program_version: str
    at: str
    by: str
    motions: tuple[str, ...]
    results: tuple[ConformanceResult, ...]

    @property
    def counts(self) -> dict[ConformanceVerdict, int]:
        """Number of results with each verdict."""
        counted = Counter(result.verdict for result in self.results)
        return {"passed": counted["passed"], "failed": counted["failed"], "not run": counted["not run"]}

    @property
    def conforms(self) -> bool:
        """True if every check ran and passed."""
        return bool(self.results) and all(result.verdict == "passed" for result in self.results)

    @property
    def summary(self) -> str:
        """Number of results with each verdict, in words."""
        return ", ".join(f"{n} {verdict}" for verdict, n in self.counts.items())


class ReportSignature(Spec, frozen=True, kw_only=True):
    """Signature of a report: the public key of the data folder that it was made in, and the signature, both hex."""

    error: ClassVar[type[WaferViewerError]] = DatasetError
    algorithm: Literal["Ed25519"] = "Ed25519"
    key: str
    value: str


class SignedConformance(Spec, frozen=True, kw_only=True):
    """Contents of a report file: the report, the SHA-256 of the page beside it, and the signature of both."""

    error: ClassVar[type[WaferViewerError]] = DatasetError
    report: dict[str, Any]
    page_sha256: str
    signature: ReportSignature
