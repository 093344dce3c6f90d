"""What goes on paper: pictures of the scene at print size and the report, kept beside the datasets."""

from __future__ import annotations

import glob
import re
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Future
from itertools import count
from pathlib import Path
from typing import Any

from wafer_viewer.model.report import Contents, ReportOrder
from wafer_viewer.session.core.dataset_library import Library
from wafer_viewer.session.files.file_jobs import FileWork
from wafer_viewer.session.reporting.report import contents

PICTURE, REPORT = "picture", "report"
_REPORT_NAME = re.compile(r"[^/\\]+-report-\d+\.html")


class Documents:
    """For the page: every verb returns a future."""

    def __init__(self, do: Callable[..., Future[Any]], library: Library, files: FileWork) -> None:
        self._do, self._library, self._files = do, library, files
        self.pictures_kept = 0
        """Since the start: it changes when a report may have more to hold."""
        self.saved_reports: dict[str, Path] = {}
        """Reports that were written where a person chose, by the names of their files."""

    def keep_picture(self, png: bytes) -> Future[Path]:
        """Keep a picture of the open dataset beside it, as ``NAME-picture-3.png``; done with its path."""
        return self._do(self._keep_picture, png)

    def contents(self) -> Future[Contents]:
        """What each part of a report of the open dataset would hold, in a few words."""
        return self._do(lambda: contents(self._library.dataset.path, self._library.result_name))

    def write_report(self, order: ReportOrder, path: Path | None = None) -> Future[Path]:
        """Write the report; done with its path. Without one it is ``NAME-report-2.html`` beside the dataset."""

        def note(done: Future[Path]) -> None:
            if path is not None and not done.cancelled() and done.exception() is None:
                self.saved_reports[path.name] = path

        written = self._do(
            lambda: self._files.write_report(order, path or free_path(self._library.shown.path, REPORT, ".html"))
        )
        written.add_done_callback(note)
        return written

    def _keep_picture(self, png: bytes) -> Path:
        from wafer_viewer.store.io.atomic_files import replacing

        path = free_path(self._library.shown.path, PICTURE, ".png")
        with replacing(path) as beside:
            beside.write_bytes(png)
        self.pictures_kept += 1
        return path


def newest_report(dataset: Path) -> Path | None:
    """The report of a dataset that was written last, or None."""
    reports = dataset.parent.glob(f"{glob.escape(dataset.stem)}-{REPORT}-*.html")
    return max(reports, key=lambda path: path.stat().st_mtime, default=None)


def read_report(name: str, folders: Iterable[Path], saved: Mapping[str, Path] = {}) -> bytes | None:
    """The bytes of a report by its file name, from the first of the folders that has it; None for any other file.

    saved: reports that were written in other folders or under other names.
    """
    if (path := saved.get(name)) is not None and path.is_file():
        return path.read_bytes()
    if not _REPORT_NAME.fullmatch(name):
        return None
    return next((path.read_bytes() for folder in folders if (path := folder / name).is_file()), None)


def free_path(dataset: Path, what: str, ending: str) -> Path:
    """The first ``NAME-what-1``, ``NAME-what-2``, … beside a dataset that is not a file yet."""
    paths = (dataset.with_name(f"{dataset.stem}-{what}-{n}{ending}") for n in count(1))
    return next(path for path in paths if not path.exists())
