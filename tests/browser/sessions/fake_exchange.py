"""Files of a session that stands still: surfaces by their endings; images are looked at where a test wants it."""

from __future__ import annotations

from concurrent.futures import Future
from pathlib import Path
from typing import Any

import numpy as np
import tifffile

from tests.browser.recording import Recording, done, refused
from tests.cli.test_inspect import frames
from wafer_viewer.model.acquisition.image_source import ImageOptions
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.surface_format import Reading
from wafer_viewer.session.core.background_work import RunningWork
from wafer_viewer.session.files.file_jobs import MOST_PICTURES, FileJobs, ImportLook
from wafer_viewer.session.state.snapshot import Snapshot
from wafer_viewer.session.surface.worker_tasks import look_at_files


def write_stack(folder: Path) -> Path:
    """Write the frames of a stack into a folder, one missing, with a fused picture beside them."""
    folder.mkdir(parents=True, exist_ok=True)
    images = frames()
    for k, image in enumerate(images):
        if k != 6:
            tifffile.imwrite(folder / f"img_{k:03d}.tif", image)
    tifffile.imwrite(folder / "fused.tif", np.max(images, axis=0))
    return folder


def looking_session(snapshot: Snapshot) -> Any:
    """A session that stands still and looks at files."""
    from tests.browser.sessions.fake_session import FakeSession

    session = FakeSession(snapshot)
    session.exchange.looks = True
    return session


class FakeExchange(Recording):
    """Says what is a surface file by its ending; what comes in is remembered as asked.

    A look at files goes on for ever, unless `looks` is set: it is then over at once.
    """

    looks = False

    def __init__(self, session: Any) -> None:
        super().__init__(FileJobs, session._done, "exchange.")
        self.looked: list[tuple[tuple[Path, ...], ImageOptions]] = []
        self.stopped: list[str] = []

    def is_surface(self, path: Path) -> bool:
        return path.suffix in (".x3p", ".gsf")

    def look(
        self,
        srcs: tuple[Path, ...],
        options: ImageOptions = ImageOptions(),
        says: Reading = Reading(),
        name: str | None = None,
    ) -> Future[RunningWork[ImportLook]]:
        self.looked.append((srcs, options))
        over: Future[Any] = Future()
        if self.looks:
            try:
                found = look_at_files(srcs, options, says, MOST_PICTURES)
                over = done(ImportLook.of(*found[:2], Path("/tmp/wafers") / f"{srcs[0].stem}.wafer"))
            except DatasetError as fault:
                over = refused(fault)
        return done(RunningWork(f"look-{len(self.looked)}", over))

    def stop_look(self, work_id: str) -> Future[None]:
        self.stopped.append(work_id)
        return done()
