"""Import of surface files of other programs into a dataset, which is then opened.

For exports see session/file_work.py.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from typing import Any

from wafer_viewer.model.file_formats import Reading
from wafer_viewer.session.core.command_queue import CommandQueue
from wafer_viewer.session.files.file_jobs import FileWork


class Exchange:
    """Import commands for the page and for notebooks; commands return futures."""

    def __init__(
        self, do: Callable[..., Future[Any]], desk: CommandQueue, files: FileWork, open_dataset: Callable[[Path], Path]
    ) -> None:
        self._do, self._desk, self._files, self._open = do, desk, files, open_dataset

    def is_surface(self, path: Path) -> bool:
        """Return whether a path names a surface file, rather than a dataset or images."""
        from wafer_viewer.store.formats.readers import is_surface_file

        return is_surface_file(Path(path))

    def import_surface(self, path: Path, says: Reading = Reading(), name: str | None = None) -> Future[Path]:
        """Import a surface file into a dataset and open it. says: values that the file does not contain."""
        made = self._do(self._files.import_surface, Path(path), says, name)
        return self._desk.then(made, self._open)
