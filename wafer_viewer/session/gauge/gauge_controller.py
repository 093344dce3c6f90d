"""Gauge-block check of the snapshot, and its commands for the page and the prompt, ``session.gauge``."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from datetime import date
from pathlib import Path
from typing import Any

from wafer_viewer.model.acquisition.calibration import Calibration
from wafer_viewer.model.errors import DatasetError, MeasureError
from wafer_viewer.model.gauge import (
    Certificate,
    GaugeCheck,
    GaugeRecord,
    GaugeRepeat,
    GaugeTerms,
    RunChart,
    ScaleCorrection,
)
from wafer_viewer.model.region import Region
from wafer_viewer.session.core.command_queue import CommandQueue
from wafer_viewer.session.core.commands import command, query
from wafer_viewer.session.core.dataset_library import NOTHING_OPEN, Library, today
from wafer_viewer.session.gauge import gauge_check as work
from wafer_viewer.session.measurement.dataset_queries import DatasetQueries
from wafer_viewer.session.measurement.results import ResultsStore
from wafer_viewer.session.state.inspection_state import Faces, GaugeState, Tick
from wafer_viewer.session.state.snapshot import Snapshot

NO_CERTIFICATE = "There is no certificate: load the one of the blocks first."


class GaugeController:
    """Controller of the gauge-block check, ``session.gauge``; commands return futures.

    `find_faces` and `check` run on the calling thread and block it; a repeat is measured on a separate thread.
    """

    def __init__(
        self,
        command_queue: CommandQueue,
        library: Library,
        results: ResultsStore,
        questions: DatasetQueries,
        folder: Path,
    ) -> None:
        self._command_queue, self._library, self._book, self._questions, self._folder = (
            command_queue,
            library,
            results,
            questions,
            folder,
        )
        self._at_work = ThreadPoolExecutor(1, thread_name_prefix="gauge")
        self._source: object = None
        command_queue.subscribe(self._look)

    @property
    def state(self) -> GaugeState:
        """State as seen by the running command."""
        return self._command_queue.now.gauge

    def close(self) -> None:
        """End the thread of the measurements."""
        self._at_work.shutdown(wait=True, cancel_futures=True)

    @command
    def put_certificate(self, certificate: Certificate | None) -> None:
        """Set the certificate, None removes it; repeats against another certificate are removed."""
        if certificate != self.state.certificate:
            self._show(certificate=certificate, repeats=(), faces=None, signed=None)

    @command
    def load_certificate(self, path: Path, expires: date | None = None, blocks: tuple[str, ...] = ()) -> Certificate:
        """Load the certificate in a TOML or XML file. Raises MeasureError if it lacks what a check needs.

        expires, blocks: last day and blocks of an XML file (DCC) that does not settle them.
        """
        from wafer_viewer.store.records.calibration_records import read_certificate

        certificate = read_certificate(Path(path), expires=expires, blocks=blocks)
        self.put_certificate.run(certificate)
        return certificate

    @command
    def set_terms(self, terms: GaugeTerms) -> None:
        """Set limit, temperature, tolerance and interval."""
        self._show(terms=terms)

    @command
    def tick(self, point: str, done: bool = True) -> None:
        """Mark a step of the preparation as done, or as not done."""
        others = tuple(tick for tick in self.state.ticks if tick.point != point)
        self._show(ticks=(*others, Tick(point, work.now())) if done else others)

    @command
    def add_repeat(
        self, upper: Region | None = None, lower: Region | None = None, show: int = 0
    ) -> Future[GaugeRepeat]:
        """Measure the open dataset as one repeat, without regions at detected faces.

        The future is done when the repeat is added.
        """
        _certificate(self.state)
        self._command_queue.change(gauge=replace(self.state, busy=True))
        measured = self._at_work.submit(self._measured, _faces(upper, lower), show)
        counted = self._command_queue.then(measured, self._count)
        return self._command_queue.afterwards(
            counted, lambda: self._command_queue.change(gauge=replace(self.state, busy=False))
        )

    @command
    def drop_repeat(self, n: int) -> None:
        """Remove a repeat, by its index from 0."""
        repeats = self.state.repeats
        if not 0 <= n < len(repeats):
            raise MeasureError(f"The check has {len(repeats)} repeats and no number {n + 1}: choose one of them.")
        self._show(repeats=(*repeats[:n], *repeats[n + 1 :]), signed=None)

    @command
    def clear(self) -> None:
        """Remove all repeats and start again with the same certificate and terms."""
        self._show(repeats=(), ticks=(), faces=None, signed=None)

    @command.audited("Gauge check signed")
    def sign(self, operator: str) -> GaugeRecord:
        """Sign the check and store it in the log of the data folder and as a result of the open dataset."""
        from wafer_viewer.store.records.calibration_records import sign

        state, shown = self.state, self._library.shown
        if state.signed is not None:
            raise MeasureError("This check is signed: scan the blocks again for another one.")
        if state.check is None:
            raise MeasureError(state.refusal or "There is nothing to sign: measure a repeat first.")
        if all(repeat.dataset != shown.name for repeat in state.repeats):
            raise MeasureError(f"{shown.name} is not a repeat of this check: open one of its scans to sign it.")
        if shown.read_only is not None:
            raise MeasureError(f"The check cannot be kept: {shown.read_only}")
        operator = self._command_queue.now.control.author(operator)
        check = work.signed(state.check, operator, state.records)
        record = work.record_of(check, self._library.dataset.scan.rig, self._library.result_name)
        sign(self._folder, record)
        self._book.keep.run(check)
        self._show(signed=check)
        return record

    @command.audited("Scale of z corrected")
    def correct_scale(self, operator: str, why: str = "") -> Calibration:
        """Set the rig's z scale from the signed check, for its next scans; existing scans do not change."""
        from wafer_viewer.session.gauge.gauge_check import correct

        record, rig = self._signed_record(), self._command_queue.now.rig
        if record is None:
            raise MeasureError("The z scale is corrected by a signed check: sign it first.")
        if record.rig != rig.name or rig.calibration is None:
            raise MeasureError(f"The check is of {record.rig or 'no rig'} and {rig.name} is here: correct it there.")
        if self._command_queue.now.scanning:
            raise MeasureError("A scan is running: correct the z scale when it has ended.")
        control = self._command_queue.now.control
        control.require_reason(why)
        after = correct(self._folder, record, rig.calibration, control.author(operator), why).calibration
        self._command_queue.change(rig=replace(rig, calibration=after))
        self._show()
        return after

    @query
    def find_faces(self, show: int = 0) -> Faces:
        """Return the upper and the lower face of the blocks on a surface. Raises MeasureError if there are none."""
        return work.find_faces(self._questions.surface_source(show))

    @query
    def check(self, upper: Region, lower: Region, show: int = 0) -> GaugeCheck:
        """Return the check with the open dataset measured at these faces. Raises MeasureError."""
        state, repeat = self._command_queue.snapshot.gauge, self._measured((upper, lower), show)
        before = () if state.signed is not None else state.repeats
        others = tuple(other for other in before if not other.is_scan_of(repeat))
        return work.check_of((*others, repeat), _certificate(state), state.terms, state.records)

    def _measured(self, faces: Faces | None, show: int) -> GaugeRepeat:
        """Measure the open dataset, on any thread."""
        certificate, shown = _certificate(self._command_queue.snapshot.gauge), self._command_queue.snapshot.dataset
        if shown is None:
            raise DatasetError(NOTHING_OPEN)
        surface = self._questions.surface_source(show)
        source = work.GaugeSource(surface, shown.name, shown.taken, shown.calibration_problem, show)
        return work.measure_repeat(source, certificate, faces)

    def _count(self, repeat: GaugeRepeat) -> GaugeRepeat:
        """Add a repeat; the first one after a signed check starts a new check."""
        from wafer_viewer.measure.gauge.gauge_check import require_new

        before = () if self.state.signed is not None else self.state.repeats
        require_new(repeat, before)
        work.check_of((*before, repeat), _certificate(self.state), self.state.terms, self.state.records)
        self._show(repeats=(*before, repeat), faces=(repeat.upper, repeat.lower), signed=None)
        return repeat

    def _look(self, now: Snapshot) -> None:
        """Update the state if another dataset is open or another rig is connected; called after every change."""
        data, rig = now.dataset, now.rig
        source = (data and (data.path, data.calibration_problem), rig.name, rig.calibration)
        if source != self._source:
            self._source = source
            self._command_queue.note(self._show)

    def _show(self, **changes: Any) -> None:
        """Publish the state with its derived values."""
        state = replace(self.state, **changes)
        records = self._records(state.certificate)
        self._command_queue.change(gauge=replace(state, records=records))
        check = _check(state, records)
        self._command_queue.change(
            gauge=replace(
                self.state,
                refusal=self._refusal(state.certificate),
                check=check,
                chart=_chart(records),
                capability=work.capability_of(records, state.terms.tolerance_um, check),
                correction=self._correction(),
            )
        )

    def _records(self, certificate: Certificate | None) -> tuple[GaugeRecord, ...]:
        from wafer_viewer.session.gauge.gauge_check import trusted_checks

        if certificate is None:
            return ()
        shown, records = self._command_queue.now.dataset, trusted_checks(self._folder, certificate.serials)
        rig = self._command_queue.now.rig.name if shown is None else self._library.dataset.scan.rig
        return tuple(record for record in records if record.rig == rig)

    def _refusal(self, certificate: Certificate | None) -> str | None:
        from wafer_viewer.measure.gauge.gauge_check import refusal

        shown = self._command_queue.now.dataset
        if certificate is None or shown is None:
            return None
        scan = self._library.dataset.scan
        return refusal(certificate, scan.calibration, shown.calibration_problem, scan.taken[:10] or today())

    def _signed_record(self) -> GaugeRecord | None:
        signed = self.state.signed
        return next((r for r in reversed(self.state.records) if signed is not None and r.check.at == signed.at), None)

    def _correction(self) -> ScaleCorrection | None:
        from wafer_viewer.session.gauge.gauge_check import offered

        record, rig = self._signed_record(), self._command_queue.now.rig
        in_force = rig.calibration
        if record is None or in_force is None or record.rig != rig.name:
            return None
        try:
            correction = offered(record, in_force)
        except MeasureError:
            return None
        return correction if correction.calibration.z_scale != in_force.z_scale else None


def _check(state: GaugeState, records: tuple[GaugeRecord, ...]) -> GaugeCheck | None:
    if state.certificate is None or not state.repeats:
        return None
    if state.signed is not None:
        return state.signed
    return work.check_of(state.repeats, state.certificate, state.terms, records)


def _chart(records: tuple[GaugeRecord, ...]) -> RunChart | None:
    from wafer_viewer.measure.gauge.gauge_studies import run_chart

    return run_chart(records)


def _certificate(state: GaugeState) -> Certificate:
    if state.certificate is None:
        raise MeasureError(NO_CERTIFICATE)
    return state.certificate


def _faces(upper: Region | None, lower: Region | None) -> Faces | None:
    return (upper, lower) if upper is not None and lower is not None else None
