"""Session restore: reopens the dataset, its result and the plan, finished or not, after a restart.

The state is stored in ``.wafer-viewer/session.json`` of the data folder. If the file is damaged or of another version,
the program starts with nothing open. One program at a time owns it by a lock, like a dataset (store/lock.py): a second
one on the same folder starts with nothing open and does not change the first one's file.
"""

from __future__ import annotations

import logging
import socket
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from wafer_viewer.model.errors import DatasetError, WaferViewerError, parser_errors_as
from wafer_viewer.model.job import Job
from wafer_viewer.model.spec import decode, encode
from wafer_viewer.session.state.snapshot import Snapshot, Typed

if TYPE_CHECKING:
    from wafer_viewer.store.dataset.lock import Holder, Lock

KEPT_IN, NAME = ".wafer-viewer", "session.json"
VERSION = 1
REST_S = 0.5
"""Time in seconds without changes after which the file is written."""
LARGEST_BYTES = 20_000_000
log = logging.getLogger(__name__)


class RestorePoint(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """Stored session state: dataset path and result name, the plan, and plan input that makes no plan yet."""

    version: int
    dataset: str | None = None
    result: str | None = None
    job: Any = None
    typed: Typed | None = None

    @property
    def is_empty(self) -> bool:
        """True if nothing was open."""
        return self.dataset is None and self.job is None and self.typed is None

    def plan(self) -> Job | None:
        """Return the job. Raises PlanError when it is not of this version."""
        return None if self.job is None else decode(msgspec.json.encode(self.job), Job, "The plan", "json")


def restore_point_of(snapshot: Snapshot, result: str) -> RestorePoint:
    """Return the restore point of a snapshot; `result` is the name of the displayed result."""
    draft, data = snapshot.draft, snapshot.dataset
    return RestorePoint(
        version=VERSION,
        dataset=None if data is None else str(data.path),
        result=None if data is None else result,
        job=None if draft.job is None else msgspec.json.decode(encode(draft.job, "json")),
        typed=draft.typed,
    )


class SessionRestore:
    """Restore file: read once at the start, written after each change with a short delay.

    Changes are reported on one thread, and written on others. A file that was not claimed is not written.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / KEPT_IN / NAME
        self._last_key: tuple[object, ...] = ()
        self._waiting: RestorePoint | None = None
        self._timer: threading.Timer | None = None
        self._writing = threading.Lock()
        self._held: Lock | None = None

    def claim(self) -> str | None:
        """Lock the file until the end; return the reason as a sentence if another program holds it.

        A folder that cannot be written to is no reason; the state is then not stored, and the log says so.
        """
        from wafer_viewer.store.dataset.lock import Lock, holder_of
        from wafer_viewer.store.io.atomic_files import os_errors_as_dataset_errors

        folder = self._path.parent
        try:
            with os_errors_as_dataset_errors(folder):
                folder.mkdir(exist_ok=True)
            self._held = Lock.take(folder)
        except DatasetError as fault:
            if (holder := holder_of(folder)) is not None:
                return _taken(folder, holder)
            log.warning("What is open will not be remembered: %s", fault)
        return None

    def read(self) -> RestorePoint:
        """Return the state at the end of the last run; empty at the first start.

        Raises DatasetError, with the sentence to show, if the file cannot be read.
        """
        from wafer_viewer.store.io.guarded_reading import read_content

        if not self._path.exists():
            return RestorePoint(version=VERSION)
        try:
            with parser_errors_as(lambda fault: DatasetError(str(fault))):
                point = msgspec.json.decode(read_content(self._path, most=LARGEST_BYTES), type=RestorePoint)
                if point.version != VERSION:
                    raise DatasetError(f"it is of version {point.version}, this program writes {VERSION}")
                point.plan()
        except WaferViewerError as fault:
            raise DatasetError(
                f"{self._path} cannot be read ({' '.join(str(fault).split()).rstrip('.')}): the program starts with "
                "nothing open. Datasets and results are as they were. Nothing to do."
            ) from fault
        return point

    def keep(self, snapshot: Snapshot, result: str) -> None:
        """Schedule writing the state if it has changed."""
        if self._held is None:
            return
        draft, data = snapshot.draft, snapshot.dataset
        key = (draft.job, draft.typed, data.path if data is not None else None, result)
        if key == self._last_key:
            return
        self._last_key, self._waiting = key, restore_point_of(snapshot, result)
        if self._timer is not None:
            self._timer.cancel()
        self._timer = threading.Timer(REST_S, self.write)
        self._timer.daemon = True
        self._timer.start()

    def write(self) -> None:
        """Write the pending state now."""
        from wafer_viewer.store.io.atomic_files import write_text

        with self._writing:
            point, self._waiting = self._waiting, None
            if point is None:
                return
            try:
                write_text(self._path, msgspec.json.encode(point).decode())
            except DatasetError as fault:
                log.warning("What is open is not remembered: %s", fault)

    def close(self, snapshot: Snapshot, result: str) -> None:
        """Write the final state, and release the file."""
        if not snapshot.reopening:
            self.keep(snapshot, result)
        if self._timer is not None:
            self._timer.cancel()
        self.write()
        if self._held is not None:
            self._held.release()
            self._held = None


def _taken(folder: Path, holder: Holder) -> str:
    """Return why another program owns the restore file; a lock of another machine may be stale."""
    dead = "" if holder.host == socket.gethostname() else f" If that one is gone, delete {folder / 'lock'}."
    return (
        f"Another Wafer Viewer ({holder}) works in {folder.parent} and remembers there what it has open. "
        f"This one began with nothing open, and will do so again as long as the other one runs.{dead} Nothing to do."
    )
