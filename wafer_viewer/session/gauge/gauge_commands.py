"""Gauge-block check commands for the page and the prompt, ``session.gauge``; `snapshot.gauge` is the current state."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from typing import Any

from wafer_viewer.model.acquisition.calibration import Calibration
from wafer_viewer.model.errors import DatasetError, MeasureError
from wafer_viewer.model.gauge.gauge_check import Certificate, GaugeCheck, GaugeRecord, GaugeRepeat, GaugeTerms
from wafer_viewer.model.region import Region
from wafer_viewer.session.core.dataset_library import NOTHING_OPEN
from wafer_viewer.session.gauge import gauge_check as work
from wafer_viewer.session.gauge.gauge_controller import NO_CERTIFICATE, GaugeKeeper
from wafer_viewer.session.measurement.dataset_queries import DatasetQueries
from wafer_viewer.session.state.gauge_state import Faces
from wafer_viewer.session.state.snapshot import Snapshot


class GaugeVerbs:
    """Gauge-block check commands, which return futures.

    `find_faces` and `check` run on the calling thread and block it.
    """

    def __init__(
        self,
        do: Callable[..., Future[Any]],
        keeper: GaugeKeeper,
        questions: DatasetQueries,
        snapshot: Callable[[], Snapshot],
    ) -> None:
        self._do, self._keeper, self._questions, self._snapshot = do, keeper, questions, snapshot

    def load_certificate(self, path: Path) -> Future[Certificate]:
        """Load the certificate in a TOML file. MeasureError if it lacks what a check needs."""
        return self._do(self._keeper.load_certificate, Path(path))

    def put_certificate(self, certificate: Certificate | None) -> Future[None]:
        """Set the certificate; None removes it."""
        return self._do(self._keeper.put_certificate, certificate)

    def set_terms(self, terms: GaugeTerms) -> Future[None]:
        """Set limit, temperature, tolerance and interval."""
        return self._do(self._keeper.set_terms, terms)

    def tick(self, point: str, done: bool = True) -> Future[None]:
        """Mark a step of the preparation as done, or as not done."""
        return self._do(self._keeper.tick, point, done)

    def add_repeat(
        self, upper: Region | None = None, lower: Region | None = None, show: int = 0
    ) -> Future[GaugeRepeat]:
        """Measure the open dataset as one repeat; without regions the faces are detected."""
        return self._do(self._keeper.add_repeat, self._measured, _faces(upper, lower), show)

    def drop_repeat(self, n: int) -> Future[None]:
        """Remove a repeat, by its index from 0."""
        return self._do(self._keeper.drop_repeat, n)

    def clear(self) -> Future[None]:
        """Remove all repeats and start again."""
        return self._do(self._keeper.clear)

    def sign(self, operator: str) -> Future[GaugeRecord]:
        """Sign the check and store it in the log and as a result of the open dataset."""
        return self._do(self._keeper.sign, operator)

    def correct_scale(self, operator: str, why: str = "") -> Future[Calibration]:
        """Set the rig's z scale from the signed check, for its next scans; existing scans do not change."""
        return self._do(self._keeper.correct_scale, operator, why)

    def find_faces(self, show: int = 0) -> Faces:
        """Return the upper and the lower face of the blocks on a surface. Raises MeasureError if there are none."""
        return work.find_faces(self._questions.surface_source(show))

    def check(self, upper: Region, lower: Region, show: int = 0) -> GaugeCheck:
        """Return the check with the open dataset measured at these faces. Raises MeasureError."""
        state, repeat = self._snapshot().gauge, self._measured((upper, lower), show)
        if state.certificate is None:
            raise MeasureError(NO_CERTIFICATE)
        before = () if state.signed is not None else state.repeats
        others = tuple(other for other in before if not other.is_scan_of(repeat))
        return work.check_of((*others, repeat), state.certificate, state.terms, state.records)

    def _measured(self, faces: Faces | None, show: int) -> GaugeRepeat:
        certificate, shown = self._snapshot().gauge.certificate, self._snapshot().dataset
        if certificate is None:
            raise MeasureError(NO_CERTIFICATE)
        if shown is None:
            raise DatasetError(NOTHING_OPEN)
        surface = self._questions.surface_source(show)
        source = work.GaugeSource(surface, shown.name, shown.taken, shown.calibration_problem, show)
        return work.measure_repeat(source, certificate, faces)


def _faces(upper: Region | None, lower: Region | None) -> Faces | None:
    return (upper, lower) if upper is not None and lower is not None else None
