"""Compression of the frames of the open dataset after its reconstruction, as its job requests."""

from __future__ import annotations

from concurrent.futures import Future
from pathlib import Path
from typing import TYPE_CHECKING

from wafer_viewer.model.errors import DatasetError
from wafer_viewer.session.core.background_work import BackgroundWork, Notifications
from wafer_viewer.session.core.dataset_library import Library
from wafer_viewer.session.surface.worker_tasks import compress_frames

if TYPE_CHECKING:
    from wafer_viewer.store.dataset.compression import CompressionReport


class FrameCompression:
    """Compression on a worker, field by field; use on the session's thread only.

    The worker holds the lock of the dataset meanwhile, also when another dataset is opened.
    """

    def __init__(self, library: Library, background: BackgroundWork, notices: Notifications) -> None:
        self._library, self._background, self._notices = library, background, notices
        self._running: set[Path] = set()

    def begin(self) -> None:
        """Compress the frames of the open dataset if its job requests it and its scan is finished."""
        shown = self._library.shown
        codec, path = shown.job.compression, shown.path
        if codec == "none" or not shown.finished or shown.read_only is not None or path in self._running:
            return
        self._running.add(path)
        self._library.release_lock()
        title = f"Compress the frames of {shown.name}"
        self._background.run(title, compress_frames, path, codec, ended=lambda done: self._over(path, done))

    def require_over(self, path: Path) -> None:
        """Raise DatasetError while the frames of a dataset are being compressed."""
        if path in self._running:
            raise DatasetError(
                f"The frames of {path.stem} are being compressed: cancel that in the list of running work, or wait "
                "until it is done."
            )

    def _over(self, path: Path, done: Future[CompressionReport]) -> None:
        self._running.discard(path)
        if self._library.is_open(path):
            self._library.compressed()
        if (fault := done.exception()) is not None:
            self._notices.fault("The frames are not all compressed", str(fault), "scan", needs_person=False)
            return
        for left in done.result().left:
            self._notices.fault("Frames were left uncompressed", left, "scan")
