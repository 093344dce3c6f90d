"""Cache of the field poses of the displayed surface, read on its own thread."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from wafer_viewer.gui.widgets.latest_only import LatestOnlyWorker
from wafer_viewer.model.errors import WaferViewerError
from wafer_viewer.model.surface.field_poses import Poses
from wafer_viewer.session.rendering.render_request import SurfaceKey


@dataclass(frozen=True, slots=True, eq=False)
class CachedPoses:
    """Field poses of a surface; None if its fields are at their stage positions."""

    of: SurfaceKey
    poses: Poses | None


class PoseCache:
    """Cache of field poses. `read` may block and raise; `failed` receives its errors."""

    def __init__(self, read: Callable[[], Poses | None], failed: Callable[[Exception], None]) -> None:
        self._read, self._failed = read, failed
        self._asked: SurfaceKey | None = None
        self._known: CachedPoses | None = None
        self._listeners: list[Callable[[], object]] = []
        self._worker = LatestOnlyWorker("poses")

    def on_arrival(self, callback: Callable[[], object]) -> None:
        """Call back on the cache's thread when poses have been read."""
        self._listeners.append(callback)

    def at(self, source: SurfaceKey) -> CachedPoses | None:
        """Return the poses of a surface, the previous ones while new ones are read; None if there are none yet."""
        if source != self._asked:
            self._asked = source
            self._worker.ask(lambda: self._look_up(source))
        known = self._known
        same = known is not None and (known.of.dataset, known.of.result) == (source.dataset, source.result)
        return known if same else None

    def close(self) -> None:
        """Stop the thread."""
        self._worker.close()

    def _look_up(self, source: SurfaceKey) -> None:
        try:
            self._known = CachedPoses(source, self._read())
        except WaferViewerError as fault:  # told, and the page goes on without poses
            self._known = CachedPoses(source, None)
            self._failed(fault)
        for listener in self._listeners:
            listener()
