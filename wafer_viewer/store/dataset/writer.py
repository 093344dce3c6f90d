"""Dataset writer: the destination of a scan's frames. Each page is written before its journal line."""

from __future__ import annotations

import contextlib
import datetime
import zlib
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Self

import msgspec
import numpy as np

from wafer_viewer._version import __version__
from wafer_viewer.model.acquisition.calibration import Calibration, OpticalSetup
from wafer_viewer.model.acquisition.devices import PulseSummary
from wafer_viewer.model.acquisition.focus_stack import Frame, FrameStatus, Image
from wafer_viewer.model.acquisition.plan import Leg, ScanPlan, Shot
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.job import Job
from wafer_viewer.model.spec import replace
from wafer_viewer.store.dataset import scan_record
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.dataset.frame_pages import PageWriter, create_pages, tags_crc32c
from wafer_viewer.store.dataset.lock import Lock
from wafer_viewer.store.dataset.scan_record import FRAMES, JOURNAL, RESULTS, ScanRecord, frames_file, write_record
from wafer_viewer.store.io.atomic_files import os_errors_as_dataset_errors, remove, require_space

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
        self._journal = scan_record.JournalWriter(path / JOURNAL)
        self._stored = Dataset(path, record).kept()
        self._provisional: set[Shot] | None = None
        """Slots with a frame of the current pass; None between passes, where a frame counts at once."""
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
        on_field_complete: OnFieldComplete | None = None,
    ) -> Self:
        """Create a dataset with all its disk space, and lock it.

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
            calibration=calibration,
            job=job,
            plan=plan,
        )
        _require_distinct_names(plan)
        _make_folder(folder)
        with contextlib.ExitStack() as undo:
            undo.callback(remove, folder)
            lock = Lock.take(folder)
            _create_files(folder, record)
            made = cls(folder, record, lock, on_field_complete)
            undo.pop_all()
            return made

    @classmethod
    def resume(cls, path: str | Path, *, on_field_complete: OnFieldComplete | None = None) -> Self:
        """Lock a dataset to continue its scan. Raises DatasetError when it is none or is locked."""
        folder = Path(path)
        record = Dataset.open(folder).scan
        lock = Lock.take(folder)
        with contextlib.ExitStack() as undo:
            undo.callback(lock.release)
            held = cls(folder, record, lock, on_field_complete)
            undo.pop_all()
            return held

    @property
    def kept(self) -> frozenset[Shot]:
        """Slots that have a frame, which a resumed scan may skip."""
        return frozenset(self._stored)

    @property
    def n_arrived(self) -> int:
        """Number of slots that have a frame, including those of the current pass."""
        return len(self._stored) + len(self._provisional or ())

    def pass_begun(self, number: int, leg: Leg) -> None:
        """Start a leg; its frames count once it has ended."""
        self._provisional = set()
        begun = scan_record.PassBegun(number, leg.train.axis, leg.train.n_frames, _now(), provisional=True)
        self._journal.write(begun)

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
        self._journal.write(scan_record.Missed(shot, pulse_count, why))

    def repaired(self, shot: Shot) -> None:
        """Record that an empty slot now has its frame."""
        self._journal.write(scan_record.Repaired(shot))

    def pass_ended(self, number: int, summary: PulseSummary) -> None:
        """End a leg; its frames count from now on."""
        self._journal.write(scan_record.PassEnded(number, summary, _now()))
        shots, self._provisional = self._provisional or set[Shot](), None
        self._count(shots)

    def fault(self, what: str) -> None:
        """Record a fault for the operator."""
        self._journal.write(scan_record.FaultNoted(what, _now()))

    def finish(self) -> None:
        """Mark the scan as finished; slots that are empty now stay empty."""
        self._journal.write(scan_record.Finished(_now()))

    def close(self) -> None:
        """Close the journal and release the lock; idempotent."""
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

    def _count(self, shots: set[Shot]) -> None:
        """Count frames as kept, and report the fields that they complete."""
        self._stored |= shots
        for number, n_new in Counter(shot.field for shot in shots).items():
            self._n_stored_of_field[number] += n_new
            if self._n_stored_of_field[number] == self.record.pages.n_pages and self.on_field_complete is not None:
                self.on_field_complete(number)

    def _checked(self, shot: Shot, image: Image) -> Image:
        pages = self.record.pages
        if shot.field not in self._fields or not 0 <= self.record.page_of(shot.k, shot.exposure) < pages.n_pages:
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
            path = frames_file(self.path, self._fields[field_number])
            self._files[field_number] = PageWriter(path, self.record.pages)
        return self._files[field_number]


def _make_folder(folder: Path) -> None:
    if folder.exists():
        raise DatasetError(f"{folder} exists already: choose another name, or continue its scan.")
    with os_errors_as_dataset_errors(folder):
        folder.mkdir()


def _create_files(folder: Path, record: ScanRecord) -> None:
    """Create everything except the frames; ``scan.json`` is last, so that a partial folder is no dataset."""
    pages = record.pages
    require_space(folder, pages.file_bytes * len(record.plan.fields), folder.name)
    with os_errors_as_dataset_errors(folder):
        (folder / FRAMES).mkdir()
        (folder / RESULTS).mkdir()
        (folder / JOURNAL).touch()
    tags: list[int] = []
    for field in record.plan.fields:
        path = frames_file(folder, field)
        create_pages(path, pages, record.pixel_um, _description(record, field.number))
        tags.append(tags_crc32c(path, pages))
    write_record(folder, replace(record, frame_tag_checksums=tuple(tags)))


def _description(record: ScanRecord, field_number: int) -> str:
    """Return the metadata for the first page of the TIFF, as ASCII JSON, for other TIFF readers."""
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
    return msgspec.json.encode(about).decode()


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
