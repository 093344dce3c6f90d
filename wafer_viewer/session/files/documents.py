"""Documents: scene pictures at print size and the report, stored next to the datasets."""

from __future__ import annotations

import glob
import re
from collections.abc import Iterable, Mapping
from concurrent.futures import Future
from itertools import count
from pathlib import Path

from wafer_viewer.model.report import Contents, ReportOrder
from wafer_viewer.session.core.command_queue import CommandQueue
from wafer_viewer.session.core.commands import observer_command
from wafer_viewer.session.core.dataset_library import Library
from wafer_viewer.session.files.file_jobs import FileJobs
from wafer_viewer.session.reporting.report import contents

PICTURE, REPORT = "picture", "report"
_REPORT_NAME = re.compile(r"[^/\\]+-report-\d+\.html")


class Documents:
    """Documents of the open dataset, ``session.papers``; every command returns a future."""

    def __init__(self, command_queue: CommandQueue, library: Library, files: FileJobs) -> None:
        self._command_queue, self._library, self._files = command_queue, library, files
        self.pictures_kept = 0
        """Number of pictures stored since the start; a change means that a report may have more to show."""
        self.saved_reports: dict[str, Path] = {}
        """Reports written to a path chosen by a person, by file name."""

    @observer_command
    def keep_picture(self, png: bytes) -> Path:
        """Store a picture next to the open dataset, as ``NAME-picture-3.png``; the future's result is its path."""
        from wafer_viewer.store.io.atomic_files import atomic_write

        path = free_path(self._library.shown.path, PICTURE, ".png")
        with atomic_write(path) as temporary:
            temporary.write_bytes(png)
        self.pictures_kept += 1
        return path

    @observer_command
    def contents(self) -> Contents:
        """Return a short description of each part that a report of the open dataset would have."""
        return contents(self._library.dataset.path, self._library.result_name)

    @observer_command
    def write_report(self, order: ReportOrder, path: Path | None = None) -> Future[Path]:
        """Write the report; the future's result is its path.

        The default path is ``NAME-report-2.html`` next to the dataset.
        """

        def note(done: Future[Path]) -> None:
            if path is not None and not done.cancelled() and done.exception() is None:
                self.saved_reports[path.name] = path

        written = self._files.write_report(order, path or free_path(self._library.shown.path, REPORT, ".html"))
        written.add_done_callback(note)
        return written


def newest_report(dataset: Path) -> Path | None:
    """Return the report of a dataset that was written last, or None."""
    reports = dataset.parent.glob(f"{glob.escape(dataset.stem)}-{REPORT}-*.html")
    return max(reports, key=lambda path: path.stat().st_mtime, default=None)


def read_report(name: str, folders: Iterable[Path], saved: Mapping[str, Path] = {}) -> bytes | None:
    """Return the bytes of a report by its file name, from the first folder that has it; None for any other file.

    saved: reports written to other folders or under other names.
    """
    if (path := saved.get(name)) is not None and path.is_file():
        return path.read_bytes()
    if not _REPORT_NAME.fullmatch(name):
        return None
    return next((path.read_bytes() for folder in folders if (path := folder / name).is_file()), None)


def free_path(dataset: Path, purpose: str, ending: str) -> Path:
    """Return the first of ``NAME-what-1``, ``NAME-what-2``, … next to a dataset that is not a file yet."""
    paths = (dataset.with_name(f"{dataset.stem}-{purpose}-{n}{ending}") for n in count(1))
    return next(path for path in paths if not path.exists())
