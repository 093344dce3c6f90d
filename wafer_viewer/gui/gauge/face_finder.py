"""Automatic detection of the two gauge block faces on a worker thread."""

from __future__ import annotations

from pathlib import Path

from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.tools.gauge_regions import default_faces
from wafer_viewer.gui.widgets.error_guard import guarded
from wafer_viewer.gui.widgets.latest_only import LatestOnlyWorker
from wafer_viewer.model.errors import WaferViewerError
from wafer_viewer.session.state.snapshot import Snapshot

Surface = tuple[Path, int, int]
"""Dataset path, displayed field (0 for the stitched surface) and stamp of the surface."""


class FaceFinder:
    """Finder of the two faces, run when there are no faces of this dataset yet, and on request.

    problem: why no faces were found, or empty; looking: whether a search is running.
    """

    def __init__(self, page: Page) -> None:
        self._page = page
        self._worker = LatestOnlyWorker("faces")
        self._looked_at: Surface | None = None
        self.problem = ""
        self.looking = False
        page.on_close(self._worker.close)

    def follow(self, snapshot: Snapshot, view: View) -> None:
        """Start a search if a surface without faces is displayed."""
        surface = _surface(snapshot, view)
        if surface is None or surface == self._looked_at:
            return
        of_others = self._looked_at is not None and self._looked_at[0] != surface[0]
        if of_others or not view.faces:
            self._look(surface)
        self._looked_at = surface

    def again(self) -> None:
        """Search again and replace the present regions."""
        surface = _surface(self._page.session.snapshot, self._page.view)
        if surface is not None:
            self._look(surface)

    def place_default_regions(self) -> None:
        """Place the regions at default positions, to be dragged by hand."""
        info = self._page.session.snapshot.surface
        if info is not None:
            self.problem = ""
            self._page.change(faces=default_faces(info))

    def _look(self, surface: Surface) -> None:
        self._looked_at, self.looking, self.problem = surface, True, ""
        self._worker.ask(lambda: guarded(self._page, "The faces were not found")(self._find)(self._page.view.show))
        self._page.redraw()

    def _find(self, show: int) -> None:
        try:
            faces = self._page.session.gauge.find_faces(max(0, show))
            self._page.change(faces=faces)
        except WaferViewerError as fault:
            self.problem = str(fault)
        finally:
            self.looking = False
            self._page.redraw()


def _surface(snapshot: Snapshot, view: View) -> Surface | None:
    """Return the key of the displayed surface; None without one, or during a scan."""
    data = snapshot.dataset
    if data is None or snapshot.surface is None or snapshot.scanning:
        return None
    return data.path, max(0, view.show), snapshot.surface.stamp
