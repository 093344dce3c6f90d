"""Dataset writer: the destination of a scan's frames. Each page is written before its journal line.

The lines of a pass say that its frames count once the last of them, that of its end, is on the disk. It is written when
the frames and the lines before it are there; the line of a begin, and lines between passes, are waited for as well. So
a power cut costs the pass that runs, and nothing else: what it leaves of its lines is recognised, and ignored.
"""

from __future__ import annotations

import contextlib
import datetime
import re
import time
import zlib
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Self

import msgspec
import numpy as np

from wafer_viewer._version import __version__
from wafer_viewer.model.acquisition.calibration import Calibration, FlatField, OpticalSetup
from wafer_viewer.model.acquisition.devices import PulseSummary
from wafer_viewer.model.acquisition.focus_stack import Frame, FrameStatus, Image
from wafer_viewer.model.acquisition.plan import Field, Leg, ScanPlan, Shot
from wafer_viewer.model.acquisition.positioners import PositionerReading
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.job import Job
from wafer_viewer.model.spec import replace
from wafer_viewer.store.dataset import scan_record
from wafer_viewer.store.dataset.compression import decompress_fields, write_headers
from wafer_viewer.store.dataset.damaged_frames import find_damage, make_writable, sentence_of
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.dataset.frame_pages import PageWriter, create_pages, tags_crc32c
from wafer_viewer.store.dataset.lock import Lock
from wafer_viewer.store.dataset.scan_record import (
    FLAT_FIELD,
    FRAMES,
    JOURNAL,
    RECORD,
    RESULTS,
    ScanRecord,
    frames_file,
    write_record,
)
from wafer_viewer.store.io.atomic_files import os_errors_as_dataset_errors, remove, require_space, to_disk
from wafer_viewer.store.io.checksums import save_json
from wafer_viewer.store.io.file_lock import ANNOUNCEMENT
from wafer_viewer.store.io.format_version import raise_schema
from wafer_viewer.store.records.manifest import forget_marks, sign_scan

_OF_NEW_FOLDER = re.compile(
    rf"{FRAMES}|{RESULTS}|lock({ANNOUNCEMENT})?|{re.escape(JOURNAL)}|{re.escape(FLAT_FIELD)}|\..*\.part"
)
"""Names of what is made before the record of the scan."""
_MAKING_S = 2.0
"""Age of a folder, in s, before which its process may not have locked it yet."""
OnFieldComplete = Callable[[int], None]


class DatasetWriter:
    """Exclusive writer of a dataset, a `ScanSink`; it holds the dataset's lock until it is closed.

    `on_field_complete` is called with the number of a field once its last frame counts.
    """

    def __init__(self, path: Path, record: ScanRecord, lock: Lock, on_field_complete: OnFieldComplete | None) -> None:
        self.path, self.record = path, record
        self.on_field_complete = on_field_complete
        self._lock = lock
        self._fields = {f.number: f for f in record.plan.fields}
        self._files: dict[int, PageWriter] = {}
        data = Dataset(path, record)
        self._journal = scan_record.JournalWriter(path / JOURNAL, data.journal_bytes)
        self._stored = data.kept()
        self._focus_at_end = data.focus_at_end()
        self._provisional: set[Shot] | None = None
        """Slots with a frame of the current pass; None between passes, where a frame counts at once."""
        self._changed: set[int] = set()
        """Numbers of the fields that got frames."""
        self._not_on_disk: set[int] = set()
        """Numbers of the fields that got frames which may not be on the disk yet."""
        self._n_stored_of_field = Counter(shot.field for shot in self._stored)

    @classmethod
    def create(
        cls,
        path: str | Path,
        plan: ScanPlan,
        job: Job,
        *,
        calibration: Calibration | None = None,
        setup: OpticalSetup = OpticalSetup(),
        rig: str = "",
        simulated: bool = False,
        imported_from: str = "",
        bits: int = 8,
        flat_field: FlatField | None = None,
        positioners: tuple[PositionerReading, ...] = (),
        on_field_complete: OnFieldComplete | None = None,
    ) -> Self:
        """Create a dataset with all its disk space, and lock it.

        flat_field: that of the calibration.

        Raises DatasetError, with everything removed, when the path exists, cannot be written to or has not enough
        space.
        """
        folder = Path(path)
        record = ScanRecord(
            software_version=__version__,
            taken=_now(),
            rig=rig,
            simulated=simulated,
            imported_from=imported_from,
            bits=bits,
            setup=setup,
            positioners=positioners,
            calibration=calibration,
            job=job,
            plan=plan,
        )
        _require_distinct_names(plan)
        _make_folder(folder)
        with contextlib.ExitStack() as undo:
            undo.callback(remove, folder)
            lock = Lock.take(folder)
            record = _create_files(folder, record, flat_field)
            if not _is_part(folder):
                forget_marks(folder)
                sign_scan(folder)
            made = cls(folder, record, lock, on_field_complete)
            undo.pop_all()
            return made

    @classmethod
    def resume(cls, path: str | Path, *, on_field_complete: OnFieldComplete | None = None) -> Self:
        """Lock a dataset to continue its scan; files that lack frames are decompressed.

        All frames are read: damaged ones lose their slots, and are to be taken again.

        Raises DatasetError when it is none or is locked, and when there is no space for what is decompressed.
        """
        folder = Path(path)
        data = Dataset.open(folder)
        data.require_frames("The scan cannot be continued")
        lock = Lock.take(folder)
        with contextlib.ExitStack() as undo:
            undo.callback(lock.release)
            raise_schema(folder)
            data.refresh()
            held = cls(folder, data.scan, lock, on_field_complete)
            held._mend_files()
            held._empty_damaged_slots(data)
            if data.scan.is_compressed:
                complete = data.complete_fields()
                decompress_fields(data, [field for field in data.fields if field.number not in complete])
            undo.pop_all()
            return held

    @property
    def kept(self) -> frozenset[Shot]:
        """Slots that have a frame, which a resumed scan may skip."""
        return frozenset(self._stored)

    @property
    def is_complete(self) -> bool:
        """True if every slot has a frame that counts."""
        return all(
            self._n_stored_of_field[field.number] == self.record.pages(field).n_pages
            for field in self.record.plan.fields
        )

    @property
    def n_arrived(self) -> int:
        """Number of slots that have a frame, including those of the current pass."""
        return len(self._stored) + len(self._provisional or ())

    def pass_begun(self, number: int, leg: Leg) -> None:
        """Start a leg; its frames count once it has ended."""
        begun = scan_record.PassBegun(number, leg.train.axis, leg.train.n_frames, _now(), provisional=True)
        self._note(begun)
        self._provisional = set()

    def frame(self, frame: Frame) -> None:
        """Write a frame: its page, then its journal line. A slot with a frame is not written again.

        Within a pass the frame counts once the pass has ended, unless its slot is reported as missed before. An
        incomplete image is recorded as missed. Raises DatasetError when the frame does not fit the plan.
        """
        if frame.image is None or frame.status is not FrameStatus.OK:
            self.missed(frame.shot, frame.pulse_count, f"the image was {frame.status.value}")
        elif frame.shot not in self._stored and frame.shot not in (self._provisional or ()):
            self._store(frame, self._checked(frame.shot, frame.image))

    def missed(self, shot: Shot, pulse_count: int, why: str) -> None:
        """Record an empty slot, or reject its frame of the current pass."""
        if self._provisional is not None:
            self._provisional.discard(shot)
        self._note(scan_record.Missed(shot, pulse_count, why))

    def repaired(self, shot: Shot) -> None:
        """Record that an empty slot now has its frame."""
        self._note(scan_record.Repaired(shot))

    def pass_ended(self, number: int, summary: PulseSummary) -> None:
        """End a leg; its frames are on the disk, and count from now on."""
        self._all_to_disk()
        shots, self._provisional = self._provisional or set[Shot](), None
        self._note(scan_record.PassEnded(number, summary, _now(), self._journal.sha256()))
        self._count(shots)

    @property
    def focus_at_end(self) -> dict[int, tuple[bool, bool]]:
        """Fields whose heights in focus touch the low or the high end of their window, by number."""
        return dict(self._focus_at_end)

    def note_focus_at_end(self, field_number: int, ends: tuple[bool, bool]) -> None:
        """Record that heights in focus touch the ends (low, high) of the window of a field."""
        self._note(scan_record.FocusAtEnd(field_number, *ends))
        self._focus_at_end[field_number] = ends

    def change_window(self, field: Field) -> None:
        """Give a field another z window: a new file replaces its frames, which no longer count."""
        path = frames_file(self.path, field)
        pages = self.record.pages(field)
        require_space(self.path, pages.file_bytes, self.path.name)
        new = _part(path)
        create_pages(new, pages, self.record.pixel_um, _description(self.record, field.number))
        changed = scan_record.WindowChanged(
            field.number, field.z_start_um, field.n_frames, tags_crc32c(new, pages), _now()
        )
        with os_errors_as_dataset_errors(path):
            to_disk(new)
            to_disk(new.parent)
            self._note(changed)
            new.replace(path)
            to_disk(path.parent)
        self.record = self.record.with_window(changed)
        self._fields[field.number] = field
        self._files.pop(field.number, None)
        self._focus_at_end.pop(field.number, None)
        self._stored = {shot for shot in self._stored if shot.field != field.number}
        self._n_stored_of_field[field.number] = 0

    def _mend_files(self) -> None:
        """Make the file of a window again that was changed when the program ended."""
        for field in self.record.plan.fields:
            path = frames_file(self.path, field)
            part = _part(path)
            if part.exists():
                with os_errors_as_dataset_errors(path):
                    part.unlink() if self._n_stored_of_field[field.number] else part.replace(path)
                    to_disk(path.parent)

    def _empty_damaged_slots(self, data: Dataset) -> None:
        """Void the frames that differ from their checksums, and make their files fit to be written."""
        damages = find_damage(data)
        for shot in (shot for damage in damages for shot in damage.shots):
            self._journal.write(scan_record.Missed(shot, 0, "its frame was damaged on the disk", voids=True))
            self._stored.discard(shot)
            self._n_stored_of_field[shot.field] -= 1
        self._journal.to_disk()
        if what := sentence_of(damages):
            self.fault(what)
        data.refresh()
        for damage in damages:
            self._changed.add(damage.field.number)
            make_writable(data, damage, _description(self.record, damage.field.number))

    def fault(self, what: str) -> None:
        """Record a fault for the operator."""
        self._note(scan_record.FaultNoted(what, _now()))

    def finish(self) -> None:
        """Mark the scan as finished; slots that are empty now stay empty."""
        self._note(scan_record.Finished(_now()))

    def close(self) -> None:
        """Describe the frames in their files, sign the scan and release the lock; idempotent.

        A description that cannot be written is left out: the frames and the journal are complete without it.
        """
        try:
            if self._lock.held:
                self._all_to_disk()
                self._journal.close()
                with contextlib.suppress(DatasetError, OSError):
                    write_headers(Dataset(self.path, self.record), self._changed)
                if not _is_part(self.path):
                    with contextlib.suppress(DatasetError, OSError):  # the check tells what was altered
                        sign_scan(self.path)
        finally:
            self._journal.close()
            self._lock.release()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, fault: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _store(self, frame: Frame, image: Image) -> None:
        shot = frame.shot
        self._changed.add(shot.field)
        self._not_on_disk.add(shot.field)
        self._file(shot.field).write(self.record.page_of(shot.k, shot.exposure), image)
        self._journal.write(
            scan_record.FrameKept(
                shot=shot,
                pulse_count=frame.pulse_count,
                x_um=frame.x_um,
                y_um=frame.y_um,
                z_um=frame.z_um,
                exposure_us=frame.exposure_us,
                device_time_us=frame.device_time_us,
                crc32=zlib.crc32(image.data),
            )
        )
        if self._provisional is not None:
            self._provisional.add(shot)
        else:
            self._count({shot})

    def _note(self, line: scan_record.Line) -> None:
        """Write a line that is no frame; between passes it is on the disk when this returns."""
        self._journal.write(line)
        if self._provisional is None:
            self._journal.to_disk()

    def _all_to_disk(self) -> None:
        """Wait until the frames that were written are on the disk, and then until the journal is."""
        with os_errors_as_dataset_errors(self.path):
            for number in sorted(self._not_on_disk):
                to_disk(frames_file(self.path, self._fields[number]))
        self._not_on_disk.clear()
        self._journal.to_disk()

    def _count(self, shots: set[Shot]) -> None:
        """Count frames as kept, and report the fields that they complete."""
        self._stored |= shots
        for number, n_new in Counter(shot.field for shot in shots).items():
            self._n_stored_of_field[number] += n_new
            n_pages = self.record.pages(self._fields[number]).n_pages
            if self._n_stored_of_field[number] == n_pages and self.on_field_complete is not None:
                self.on_field_complete(number)

    def _checked(self, shot: Shot, image: Image) -> Image:
        field = self._fields.get(shot.field)
        pages = self.record.pages(field or self.record.plan.fields[0])
        if field is None or not 0 <= self.record.page_of(shot.k, shot.exposure) < pages.n_pages:
            raise DatasetError(
                f"{shot} is not in the plan of {self.path.name}: continue with the plan it was started with."
            )
        if image.shape != (pages.rows, pages.cols) or image.dtype.itemsize != pages.dtype.itemsize:
            raise DatasetError(
                f"The frame of {shot} is {image.shape[1]} x {image.shape[0]} px of {image.dtype}, "
                f"{self.path.name} holds {pages.cols} x {pages.rows} px of {pages.dtype}: "
                "set the camera as the plan was made for."
            )
        return np.ascontiguousarray(image, pages.dtype)

    def _file(self, field_number: int) -> PageWriter:
        if field_number not in self._files:
            field = self._fields[field_number]
            self._files[field_number] = PageWriter(frames_file(self.path, field), self.record.pages(field))
        return self._files[field_number]


def _is_part(folder: Path) -> bool:
    """Return whether a folder gets its own name when it is complete."""
    return folder.name.startswith(".")


def _part(path: Path) -> Path:
    """Return the path of a frame file that is not in force yet."""
    return path.with_name(f".{path.name}.window")


def _make_folder(folder: Path) -> None:
    remove_half_made(folder)
    if folder.exists():
        raise DatasetError(f"{folder} exists already: choose another name, or continue its scan.")
    with os_errors_as_dataset_errors(folder):
        folder.mkdir()


def remove_half_made(folder: Path) -> None:
    """Remove a folder whose process was killed before it was a dataset: no record, no frame, and nobody makes it.

    A folder that is younger than `_MAKING_S` is waited for: its process may be about to lock it. Raises DatasetError
    when a process makes it.
    """
    if not folder.is_dir() or any(not _OF_NEW_FOLDER.fullmatch(path.name) for path in folder.iterdir()):
        return
    journal, results = folder / JOURNAL, folder / RESULTS
    if (journal.exists() and journal.stat().st_size) or (results.is_dir() and any(results.iterdir())):
        return
    age_s = time.time() - folder.stat().st_mtime
    if 0 <= age_s < _MAKING_S:
        time.sleep(_MAKING_S - age_s)
    lock = Lock.take(folder)
    if not (folder / RECORD).exists():  # nor has it become a dataset meanwhile
        remove(folder)
    lock.release()


def _create_files(folder: Path, record: ScanRecord, flat_field: FlatField | None) -> ScanRecord:
    """Create everything except the frames and return the record with the checksums of their files.

    ``scan.json`` is last, when all others are on the disk, so that a partial folder is no dataset.
    """
    require_space(folder, sum(record.pages(field).file_bytes for field in record.plan.fields), folder.name)
    with os_errors_as_dataset_errors(folder):
        (folder / FRAMES).mkdir()
        (folder / RESULTS).mkdir()
        (folder / JOURNAL).touch()
    if flat_field is not None:
        save_json(folder / FLAT_FIELD, flat_field)
    tags: list[int] = []
    for field in record.plan.fields:
        path, pages = frames_file(folder, field), record.pages(field)
        create_pages(path, pages, record.pixel_um, _description(record, field.number))
        tags.append(tags_crc32c(path, pages))
    with os_errors_as_dataset_errors(folder):
        for path in (folder / FRAMES).iterdir():
            to_disk(path)
        for place in (folder / FRAMES, folder, folder.parent):
            to_disk(place)
    complete = replace(record, frame_tag_checksums=tuple(tags))
    write_record(folder, complete)
    return complete


def _description(record: ScanRecord, field_number: int) -> bytes:
    """Return the metadata for the first page of a TIFF that is being scanned, as ASCII JSON, for other readers."""
    about = {
        "field": field_number,
        "page": "k * n_exposures + exposure",
        "n_exposures": record.n_exposures,
        "z_step_um": record.plan.sweep.z_step_um,
        "pixel_um": record.pixel_um,
        "calibrated": record.calibration is not None,
        "SIMULATED": record.simulated,
        "software": f"Wafer Viewer {record.software_version}",
    }
    return msgspec.json.encode(about)


def _require_distinct_names(plan: ScanPlan) -> None:
    """Raise DatasetError when two fields share a grid position, and hence a file, or a number."""
    for property_name, names in (
        ("place in the grid", [f.name for f in plan.fields]),
        ("number", [f.number for f in plan.fields]),
    ):
        twice = [name for name, count in Counter(names).items() if count > 1]
        if twice:
            raise DatasetError(
                f"Two fields have the same {property_name}, {twice[0]}: give each its own row, column and number."
            )


def _now() -> str:
    return datetime.datetime.now().astimezone().isoformat(timespec="seconds")
