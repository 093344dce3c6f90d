"""What goes on paper: pictures of the scene at print size and the report, kept beside the datasets."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from itertools import count
from pathlib import Path
from typing import Any

from wafer_viewer.session.library import Library

PICTURE, REPORT = "picture", "report"


class Papers:
    """For the page: every verb returns a future."""

    def __init__(self, do: Callable[..., Future[Any]], library: Library) -> None:
        self._do, self._library = do, library

    def keep_picture(self, png: bytes) -> Future[Path]:
        """Keep a picture of the open dataset beside it, as ``NAME-picture-3.png``; done with its path."""
        return self._do(self._keep_picture, png)

    def _keep_picture(self, png: bytes) -> Path:
        from wafer_viewer.store.files import replacing

        path = free_path(self._library.shown.path, PICTURE, ".png")
        with replacing(path) as beside:
            beside.write_bytes(png)
        return path


def free_path(dataset: Path, what: str, ending: str) -> Path:
    """The first ``NAME-what-1``, ``NAME-what-2``, … beside a dataset that is no file yet."""
    paths = (dataset.with_name(f"{dataset.stem}-{what}-{n}{ending}") for n in count(1))
    return next(path for path in paths if not path.exists())
