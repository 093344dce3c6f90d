"""Read access to a dataset: the folder ``NAME.wafer`` with its plan, frames and journal; consistency of its passes.

The axis of a pass moves at constant speed, so the device times of its frames are linear in the scale counts of their
pulses. A frame in a neighbour's slot deviates by a full pulse period, which shows in the journal alone, also in
datasets of schema 1. The test does not apply to stop and shoot, and does not detect a constant shift of a pass.
"""

from __future__ import annotations

import dataclasses
import hashlib
import zlib
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from wafer_viewer.model.acquisition.calibration import ImageShading
from wafer_viewer.model.acquisition.devices import PulseSummary
from wafer_viewer.model.acquisition.focus_stack import Bracket, FieldStack, Image
from wafer_viewer.model.acquisition.plan import MIN_FRAMES, Field, Shot
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.progress import Progress, ShouldStop, never, silent, with_progress
from wafer_viewer.store.dataset.frame_lines import LONG_LINES, FrameLines, JournalIndex
from wafer_viewer.store.dataset.frame_pages import map_pages, tags_crc32c
from wafer_viewer.store.dataset.result import Result
from wafer_viewer.store.dataset.scan_record import (
    FLAT_FIELD,
    JOURNAL,
    RESULTS,
    FaultNoted,
    Finished,
    FocusAtEnd,
    FrameKept,
    FramesRemoved,
    Held,
    HoldEnded,
    JournalReader,
    Line,
    Missed,
    PassBegun,
    PassEnded,
    RetentionLine,
    ScanRecord,
    WindowChanged,
    frames_file,
    read_record,
)
from wafer_viewer.store.io.checksums import KnownGood, file_mark, remedy
from wafer_viewer.store.records.calibration_records import read_flat_field

if TYPE_CHECKING:
    from wafer_viewer.store.dataset.compression import CompressionReport
    from wafer_viewer.store.dataset.integrity import KindReport


_good_stacks = KnownGood()
"""Verified stacks, keyed by the frame file with its state and by the checksum of its journal entries."""
FILES_SHARE = 0.5
"""Share of the progress bar for the check of all files except the frames."""


@dataclass(frozen=True, slots=True)
class CheckReport:
    """Result of `Dataset.check`: number of good pages, missing slots, damaged pages, unreadable files."""

    n_good: int
    missing: tuple[Shot, ...]
    damaged: tuple[Shot, ...]
    faults: tuple[str, ...]
    """Frame files that cannot be read, one sentence each."""
    files: tuple[KindReport, ...] = ()
    """Reports on all other files, by kind."""
    n_removed: int = 0
    """Frame files that are not there because they were removed."""

    @property
    def ok(self) -> bool:
        """True if every slot has a frame with the right checksum and no file is damaged."""
        return not (self.missing or self.damaged or self.faults or any(kind.damaged for kind in self.files))


class Dataset:
    """Dataset opened for reading, also while another process writes to it; `refresh` reads new journal lines."""

    def __init__(self, path: Path, scan: ScanRecord) -> None:
        self.path, self.scan = path, scan
        self._journal = JournalReader(path / JOURNAL)
        self._frames = FrameLines()
        self._provisional = FrameLines()
        """Frames of the current pass, which count only once the pass has ended."""
        self._is_provisional = False
        self._missed: dict[Shot, Missed] = {}
        self._faults: list[str] = []
        self._focus_at_end: dict[int, tuple[bool, bool]] = {}
        self.held: Held | None = None
        """Hold that keeps the frames, None without one."""
        self.removed: FramesRemoved | None = None
        """Removal of the frames, None if they were not removed."""
        self._ended = False
        self._indexed: tuple[Field, ...] = ()
        self._by_number: dict[int, Field] = {}
        self._others: list[Line] = []
        """Lines that tell more than that a frame was kept."""
        self._read_index()
        before = self._journal.n_lines
        self.refresh()
        if self._journal.n_lines - before >= LONG_LINES and not self._is_provisional:
            self._write_index()

    @classmethod
    def open(cls, path: str | Path) -> Dataset:
        """Open a folder. Raises DatasetError when it is no dataset, is damaged, or has a newer format."""
        folder = Path(path)
        return cls(folder, read_record(folder))

    def _read_index(self) -> None:
        """Take over what the index knows of the journal, if there is one."""
        index = JournalIndex.read(self.path / JOURNAL)
        if index is not None:
            for line in index.others:
                self._apply(line)
            self._frames, self._ended = FrameLines(index.table), index.ended
            self._journal.skip(index.n_bytes, index.n_lines)

    def _write_index(self) -> None:
        """Write the index of a long journal, where the folder can be written to."""
        at = self._journal
        with suppress(DatasetError, OverflowError):
            table = self._frames.table()
            JournalIndex(at.n_bytes, at.n_lines, self._ended, tuple(self._others), table).write(self.path / JOURNAL)

    def refresh(self) -> None:
        """Read the journal's new lines."""
        for line in self._journal.new_lines():
            if type(line) is FrameKept:
                (self._provisional if self._is_provisional else self._frames).add(line)
            else:
                self._apply(line)

    def _apply(self, line: Line) -> None:
        match line:
            case PassEnded():
                self._frames.add_all(self._provisional)
                self._provisional, self._is_provisional = FrameLines(), False
            case PassBegun():
                self._provisional, self._is_provisional = FrameLines(), line.provisional
                self._ended = False
            case Finished():
                self._ended = True
            case Missed():
                self._missed[line.shot] = line
                self._provisional.drop(line.shot)
                if line.voids:
                    self._frames.drop(line.shot)
                    self._ended = False
            case FaultNoted():
                self._faults.append(line.what)
            case FocusAtEnd():
                self._focus_at_end[line.field] = line.low, line.high
            case WindowChanged():
                self._change_window(line)
            case Held():
                self.held = line
            case HoldEnded():
                self.held = None
            case FramesRemoved():
                self.removed = line
            case _:
                pass
        if isinstance(line, Missed | FaultNoted | FocusAtEnd | WindowChanged | RetentionLine):
            self._others.append(line)

    def _change_window(self, line: WindowChanged) -> None:
        self.scan = self.scan.with_window(line)
        self._focus_at_end.pop(line.field, None)
        self._frames.drop_field(line.field)
        self._provisional.drop_field(line.field)
        for shot in [shot for shot in self._missed if shot.field == line.field]:
            del self._missed[shot]

    @property
    def journal_bytes(self) -> int:
        """Size of the journal without what a power cut left of an unfinished pass."""
        return self._journal.n_bytes

    @property
    def name(self) -> str:
        """Folder name without its suffix."""
        return self.path.stem

    @property
    def fields(self) -> tuple[Field, ...]:
        """Planned fields."""
        return self.scan.plan.fields

    @property
    def n_exposures(self) -> int:
        """Number of frames at each z."""
        return self.scan.n_exposures

    @property
    def simulated(self) -> bool:
        """True if a virtual rig took the frames."""
        return self.scan.simulated

    @property
    def faults(self) -> tuple[str, ...]:
        """Faults reported during the scan, or what was found in imported files, in order."""
        return tuple(self._faults)

    def require_frames(self, what: str) -> None:
        """Raise DatasetError, which begins with `what`, if the frames were removed."""
        if self.removed is not None:
            raise DatasetError(f"{what}: {self.removed.sentence(self.path.name)}")

    @property
    def finished(self) -> bool:
        """True if no frame is missing, or the scan ended without the missing ones."""
        return self._ended or all(map(self._is_complete, self.fields))

    def field(self, number: int) -> Field:
        """Return the field with a number. Raises DatasetError when there is none."""
        field = self._field_of.get(number)
        if field is None:
            raise DatasetError(
                f"{self.path.name} has {len(self.fields)} fields and no field {number}: choose one of them."
            )
        return field

    @property
    def _field_of(self) -> dict[int, Field]:
        """Fields by their numbers, of the present plan."""
        if self._indexed is not self.fields:
            self._indexed, self._by_number = self.fields, {field.number: field for field in self.fields}
        return self._by_number

    def calibration_problem(self, today: str) -> str | None:
        """Return why lengths are uncalibrated, or None if calibrated. `today`: ISO 8601 date."""
        return self.scan.calibration_problem(today)

    def focus_at_end(self) -> dict[int, tuple[bool, bool]]:
        """Return the fields whose heights in focus touch the low or the high end of their window, by number."""
        return dict(self._focus_at_end)

    def kept_of(self, field: Field) -> list[Shot]:
        """Return the slots of a field that have a frame, without those of the current pass."""
        return list(self._frames.of(field.number))

    def kept(self) -> set[Shot]:
        """Return the slots that have a frame, without those of the current pass."""
        return self._frames.shots()

    def arrived(self) -> set[Shot]:
        """Return the slots that have a frame, including those of the current pass."""
        return self._frames.shots() | self._provisional.shots()

    def ever_missed(self) -> set[Shot]:
        """Return the slots that were empty, or whose frame was rejected, at any time."""
        return set(self._missed)

    def missing(self) -> set[Shot]:
        """Return the slots without a frame, whether pending or missed."""
        incomplete = (field for field in self.fields if not self._is_complete(field))
        return {shot for field in incomplete for shot in self._shots(field) if shot not in self._frames}

    def missed(self) -> dict[Shot, str]:
        """Return the slots without a frame that the scan has passed, and the reason for each."""
        return {shot: line.why for shot, line in self._missed.items() if shot not in self._frames}

    def complete_fields(self) -> set[int]:
        """Return the numbers of the fields that have all their frames, without those of the current pass."""
        return {f.number for f in self.fields if self._is_complete(f)}

    def _is_complete(self, field: Field) -> bool:
        return self._frames.count(field.number) == self.scan.plan.sweep.frames_of(field) * self.n_exposures

    def stack(self, field_number: int, exposure: int | None = None, *, verify: bool = True) -> FieldStack:
        """Return the focus stack of a field, memory-mapped; z is the recorded z times the calibrated z scale.

        exposure: index of a single exposure. By default the stack holds all exposures, the first as its images and the
        others as its brackets, at the mean of their z. Frames of the current pass are included.
        verify: compare every frame with its checksum in the journal, which reads all of them; an unchanged file is
        verified once.

        Raises DatasetError when the field, its file or the exposure is missing, a frame is damaged, or fewer than three
        frames exist.
        """
        self.require_frames("There are no frames to look at")
        field = self.field(field_number)
        wanted = range(self.n_exposures) if exposure is None else (self._exposure(exposure),)
        lines = [self._lines(field_number, e) for e in wanted]
        pages = map_pages(frames_file(self.path, field), self.scan.pages(field))
        first, *others = (self._bracket(pages, e, exposed) for e, exposed in zip(wanted, lines, strict=True))
        self._require_frames(field, int(first.present.sum()))
        present = [line for exposed in lines for line in exposed if line is not None]
        checksum = _checksum(present)
        z_um = [self._z_um(field, exposed) for exposed in lines]
        if verify:
            self._require_valid_pages(field, pages, present, checksum)
        return FieldStack(
            field=field,
            images=first.images,
            z_um=np.mean(z_um, axis=0),
            present=first.present,
            pixel_um=self.scan.pixel_um,
            calibration=self.scan.calibration,
            simulated=self.simulated,
            checksum=checksum,
            source=f"{self.path.name}, field {field_number}",
            exposure_us=first.exposure_us,
            brackets=tuple(others),
            depth_of_field_um=self.scan.plan.depth_of_field_um,
            exposure_z_um=tuple(z_um) if others else (),
            shading=self.shading,
            notes=self.faults if self.scan.imported_from else (),
            positions_assumed=self.scan.assumed_overlap is not None,
        )

    @cached_property
    def shading(self) -> ImageShading | None:
        """Shading of the camera by the flat field of the calibration, None without one.

        Raises
        ------
        DatasetError
            If its file is missing, was changed, or has another size than the frames.
        """
        digest = None if self.scan.calibration is None else self.scan.calibration.flat_field_digest
        if digest is None:
            return None
        path, plan = self.path / FLAT_FIELD, self.scan.plan
        found = read_flat_field(path, digest)
        if (found.rows, found.cols) != (plan.rows, plan.cols):
            raise DatasetError(
                f"{path} is of frames of {found.cols} x {found.rows} pixels, these have {plan.cols} x {plan.rows}: "
                "restore it from a copy."
            )
        return found.shading()

    def check(self, progress: Progress | None = None, should_stop: ShouldStop | None = None) -> CheckReport:
        """Verify the checksum of every page against the journal, and the checksums of all other files."""
        from wafer_viewer.store.dataset.integrity import check_files

        files = check_files(self.path, _partial_progress(progress, 0.0, FILES_SHARE), should_stop)
        progress = _partial_progress(progress, FILES_SHARE, 1.0)
        tags = self.scan.tags_crc32c()
        good, n_removed, damaged, faults = 0, 0, list[Shot](), list[str]()
        for field in with_progress(self.fields, len(self.fields), "The check", progress, should_stop):
            if self._is_removed(field):
                n_removed += 1
                continue
            try:
                self._require_good_tags(field, tags.get(field.number))
                bad = self.damaged_slots(field)
            except DatasetError as fault:
                faults.append(str(fault))
                continue
            damaged += bad
            good += self._frames.count(field.number) - len(bad)
        missing = sorted(self.missing(), key=lambda s: (s.field, s.k, s.exposure))
        return CheckReport(good, tuple(missing), tuple(damaged), tuple(faults), files, n_removed)

    def _is_removed(self, field: Field) -> bool:
        """Return whether the frame file of a field is not there because it was removed."""
        return self.removed is not None and not frames_file(self.path, field).exists()

    def journal_lines(self, field: Field) -> list[FrameKept]:
        """Return the journal lines of a field's frames, including those of the current pass."""
        return [line for e in range(self.n_exposures) for line in self._lines(field.number, e) if line is not None]

    def frame_bytes(self) -> int:
        """Return the size of all frame files in bytes; a missing file counts 0."""
        paths = [frames_file(self.path, field) for field in self.fields]
        return sum(path.stat().st_size for path in paths if path.exists())

    def compress(
        self, codec: str = "zstd", progress: Progress | None = None, should_stop: ShouldStop | None = None
    ) -> CompressionReport:
        """Compress the frames without loss, or decompress them with the codec "none", as `compression.compress`."""
        from wafer_viewer.store.dataset.compression import compress

        return compress(Dataset.open(self.path), codec, progress or silent, should_stop or never)

    def results(self) -> tuple[str, ...]:
        """Return the names of the reconstructions."""
        return tuple(sorted(result.name for result in self._results() if not result.is_difference))

    def differences(self) -> tuple[str, ...]:
        """Return the names of the results that compare two surfaces, oldest first."""
        results = [result for result in self._results() if result.is_difference]
        return tuple(result.name for result in sorted(results, key=lambda result: result.path.stat().st_mtime))

    def result(self, name: str = "default") -> Result:
        """Return a reconstruction by name; its folder is created on the first save."""
        return Result.of(self.path / RESULTS, name)

    def _results(self) -> list[Result]:
        """Return all results, without those that are still being written."""
        folder = self.path / RESULTS
        folders = [p for p in folder.iterdir() if p.is_dir()] if folder.is_dir() else []
        return [Result(p) for p in folders if not p.name.startswith(".")]

    def _lines(self, field_number: int, exposure: int) -> list[FrameKept | None]:
        n_frames = self.scan.plan.sweep.frames_of(self.field(field_number))
        lines = {**self._frames.of(field_number), **self._provisional.of(field_number)}
        return [lines.get(Shot(field_number, k, exposure)) for k in range(n_frames)]

    def _bracket(self, pages: Image, exposure: int, lines: list[FrameKept | None]) -> Bracket:
        present = np.array([line is not None for line in lines])
        return Bracket(pages[exposure :: self.n_exposures], present, self.scan.plan.exposures_us[exposure])

    def _exposure(self, exposure: int) -> int:
        if not 0 <= exposure < self.n_exposures:
            raise DatasetError(
                f"{self.path.name} has {self.n_exposures} exposures at each z and no number {exposure}: "
                f"choose 0 to {self.n_exposures - 1}."
            )
        return exposure

    def _shots(self, field: Field) -> list[Shot]:
        n_frames = self.scan.plan.sweep.frames_of(field)
        return [Shot(field.number, k, e) for k in range(n_frames) for e in range(self.n_exposures)]

    def _z_um(self, field: Field, lines: list[FrameKept | None]) -> np.ndarray:
        planned = [self.scan.plan.sweep.z_um(field, k) for k in range(len(lines))]
        z_um = [line.z_um if line is not None else z for line, z in zip(lines, planned, strict=True)]
        return np.array(z_um) * self.scan.z_scale

    def _require_frames(self, field: Field, n_present: int) -> None:
        if n_present < MIN_FRAMES:
            raise DatasetError(
                f"Field {field.number} of {self.path.name} has {n_present} of "
                f"{self.scan.plan.sweep.frames_of(field)} frames and at least {MIN_FRAMES} are needed: continue the "
                "scan."
            )

    def _require_good_tags(self, field: Field, expected: int | None) -> None:
        """Raise DatasetError when the bytes around the pages changed; in schema 1 it may have no checksum."""
        path = frames_file(self.path, field)
        if expected is not None and tags_crc32c(path, self.scan.pages(field)) != expected:
            raise DatasetError(
                f"{path} is damaged, the checksum of its tags differs: restore it from a copy, or have it written "
                f"again from its frames (wafer-viewer compress {self.path.name} --codec none)."
            )

    def damaged_slots(self, field: Field) -> list[Shot]:
        """Return the slots of a field whose frame differs from its checksum.

        Raises DatasetError when its file cannot be read.
        """
        lines = [] if self._is_removed(field) else list(self._frames.of(field.number).values())
        pages = map_pages(frames_file(self.path, field), self.scan.pages(field)) if lines else None
        return self._differing(pages, lines) if pages is not None else []

    def _differing(self, pages: Image, lines: Iterable[FrameKept]) -> list[Shot]:
        """Return the slots of the journal lines whose checksum differs from that of their page."""
        page_of = self.scan.page_of
        return [
            line.shot for line in lines if zlib.crc32(pages[page_of(line.shot.k, line.shot.exposure)]) != line.crc32
        ]

    def _require_valid_pages(self, field: Field, pages: Image, lines: Iterable[FrameKept], checksum: str) -> None:
        """Raise DatasetError when a page differs from its checksum in the journal; a file is read once."""
        path = frames_file(self.path, field)
        key = file_mark(path), checksum
        if key in _good_stacks:
            return
        if bad := self._differing(pages, lines):
            raise DatasetError(
                f"{path} is damaged, the checksum of frame {bad[0].k} differs"
                f"{f', and of {len(bad) - 1} others' if len(bad) > 1 else ''}: {remedy(path)}."
            )
        _good_stacks.add(key)


def _partial_progress(progress: Progress | None, begin: float, end: float) -> Progress | None:
    """Return a progress callback for a part of the work, from `begin` to `end` of the total."""
    return None if progress is None else lambda done: progress(begin + (end - begin) * done)


def _checksum(lines: Iterable[FrameKept]) -> str:
    """Return one checksum of a stack, computed from the checksums of its pages at acquisition."""
    digest = hashlib.sha256()
    for line in lines:
        digest.update(f"{line.shot.k} {line.z_um!r} {line.crc32:08x}\n".encode())
    return digest.hexdigest()


LEAST_FRAMES = 8
"""Least number of frames from which the speed of a pass is estimated."""
OFF_PERIODS = 0.5
"""Deviation, in pulse periods, above which a frame time belongs to another pulse."""


@dataclass(frozen=True, slots=True)
class PassReport:
    """Consistency report on the passes of a dataset.

    n_passes: passes with frames that count; n_timed: those whose frame times were compared with the pulses;
    doubts: one sentence for each pass whose frames may be in the wrong slots or at the wrong height;
    noted: faults reported by the scan, in order.
    """

    n_passes: int
    n_timed: int
    doubts: tuple[str, ...]
    noted: tuple[str, ...]

    @property
    def ok(self) -> bool:
        """True if no pass is in doubt."""
        return not self.doubts


@dataclass(slots=True)
class _Pass:
    begun: PassBegun
    frames: list[FrameKept] = dataclasses.field(default_factory=list[FrameKept])
    summary: PulseSummary | None = None


def check_passes(data: Dataset) -> PassReport:
    """Compare the frames of every pass with its counts and times. Raises DatasetError for a damaged journal."""
    passes = [one for one in _passes(JournalReader(data.path / JOURNAL).new_lines()) if one.frames]
    moving = data.scan.plan.strategy != "stop_and_shoot"
    timed = [one for one in passes if moving and len(one.frames) >= LEAST_FRAMES]
    doubts = [doubt for one in passes for doubt in (*_count_doubts(one), *(_time_doubts(one) if one in timed else ()))]
    return PassReport(len(passes), len(timed), tuple(doubts), data.faults)


def _passes(lines: Iterable[Line]) -> list[_Pass]:
    """Return the passes with the frames that count."""
    passes: list[_Pass] = []
    now: _Pass | None = None
    for line in lines:
        match line:
            case PassBegun():
                if now is not None and now.begun.provisional:
                    passes.pop()
                now = _Pass(line)
                passes.append(now)
            case FrameKept() if now is not None:
                now.frames.append(line)
            case Missed() if now is not None and now.begun.provisional:
                now.frames = [frame for frame in now.frames if frame.shot != line.shot]
            case PassEnded() if now is not None:
                now.summary, now = line.summary, None
            case _:
                pass
    if now is not None and now.begun.provisional:
        passes.pop()
    return passes


def _count_doubts(one: _Pass) -> Iterable[str]:
    if (summary := one.summary) is None:
        return
    counted = {
        "quadrature errors": summary.quadrature_errors,
        "suppressed pulses": summary.suppressed,
        "exposures more than pulses": max(0, summary.exposures - summary.emitted),
    }
    for kind, number in counted.items():
        if number:
            yield (
                f"{_name(one)}: {len(one.frames)} frames were kept although the pulse box reported {number} {kind}: "
                "their heights may be off; scan these fields again."
            )


def _time_doubts(one: _Pass) -> Iterable[str]:
    frames = sorted(one.frames, key=lambda frame: frame.device_time_us)
    times_us = np.array([frame.device_time_us for frame in frames], np.float64)
    counts = np.array([frame.pulse_count for frame in frames], np.float64)
    gaps_us, steps = np.diff(times_us), np.abs(np.diff(counts))
    if not steps.all():
        yield f"{_name(one)}: two frames have the same scale count: scan these fields again."
        return
    us_per_count = float(np.median(gaps_us / steps))
    off_periods = (gaps_us - us_per_count * steps) / (us_per_count * float(steps.min()))
    wrong = np.flatnonzero(np.abs(off_periods) > OFF_PERIODS)
    if wrong.size:
        first = frames[int(wrong[0]) + 1].shot
        yield (
            f"{_name(one)}: the times of the frames leave their pulses in {wrong.size} places, first at field "
            f"{first.field}, frame {first.k}, by {off_periods[wrong[0]]:+.1f} pulses: frames stand in slots of their "
            "neighbours; scan these fields again."
        )


def _name(one: _Pass) -> str:
    return f"Pass {one.begun.number + 1}, from field {one.frames[0].shot.field}"
