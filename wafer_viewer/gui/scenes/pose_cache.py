"""The poses of the surface on show: read on a thread of its own, and known until there are newer ones."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from wafer_viewer.gui.widgets.latest_only import LatestOnlyWorker
from wafer_viewer.model.errors import WaferViewerError
from wafer_viewer.model.surface.field_poses import Poses
from wafer_viewer.session.rendering.render_request import SurfaceKey


@dataclass(frozen=True, slots=True, eq=False)
class CachedPoses:
    """The poses of a surface; None where its fields lie as the stage says."""

    of: SurfaceKey
    poses: Poses | None


class PoseCache:
    """`read` may wait and raise; what it raises is told to `failed`."""

    def __init__(self, read: Callable[[], Poses | None], failed: Callable[[Exception], None]) -> None:
        self._read, self._failed = read, failed
        self._asked: SurfaceKey | None = None
        self._known: CachedPoses | None = None
        self._listeners: list[Callable[[], object]] = []
        self._worker = LatestOnlyWorker("poses")

    def on_arrival(self, callback: Callable[[], object]) -> None:
        """Call back when poses have come, on a thread of its own."""
        self._listeners.append(callback)

    def at(self, source: SurfaceKey) -> CachedPoses | None:
        """The poses of a surface; while they are read, those it had before. None: none are known yet."""
        if source != self._asked:
            self._asked = source
            self._worker.ask(lambda: self._look_up(source))
        known = self._known
        same = known is not None and (known.of.dataset, known.of.result) == (source.dataset, source.result)
        return known if same else None

    def close(self) -> None:
        """Let the thread go."""
        self._worker.close()

    def _look_up(self, source: SurfaceKey) -> None:
        try:
            self._known = CachedPoses(source, self._read())
        except WaferViewerError as fault:  # told, and the page goes on without poses
            self._known = CachedPoses(source, None)
            self._failed(fault)
        for listener in self._listeners:
            listener()
