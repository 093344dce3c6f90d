"""Surface files in: one of another program becomes a dataset and is open. What goes out is in session/file_work.py."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from typing import Any

from wafer_viewer.model.file_formats import Reading
from wafer_viewer.session.core.command_queue import CommandQueue
from wafer_viewer.session.files.file_jobs import FileWork


class Exchange:
    """For the page and for notebooks: every verb returns a future."""

    def __init__(
        self, do: Callable[..., Future[Any]], desk: CommandQueue, files: FileWork, open_dataset: Callable[[Path], Path]
    ) -> None:
        self._do, self._desk, self._files, self._open = do, desk, files, open_dataset

    def is_surface(self, path: Path) -> bool:
        """Whether a path names a surface file, and no dataset and no images."""
        from wafer_viewer.store.formats.readers import is_surface_file

        return is_surface_file(Path(path))

    def import_surface(self, path: Path, says: Reading = Reading(), name: str | None = None) -> Future[Path]:
        """Make a dataset of a surface file and open it; done when it is open. says: what the file does not say."""
        made = self._do(self._files.import_surface, Path(path), says, name)
        return self._desk.then(made, self._open)
