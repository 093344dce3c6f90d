"""A session that stands still over heights in memory, which it truly paints and measures."""

from __future__ import annotations

from tests.browser.sessions.fake_session import FakeSession
from tests.support.page_stand_in import MemoryShelf, StandIn
from wafer_viewer.model.surface.height_map import HeightMap
from wafer_viewer.session.measurement.dataset_queries import Measuring
from wafer_viewer.session.rendering.render_request import RenderRequest
from wafer_viewer.session.state.snapshot import Snapshot


class SurfaceSession(FakeSession):
    """`surfaces`: the height maps by the numbers that they are shown by."""

    def __init__(self, snapshot: Snapshot, surfaces: dict[int, HeightMap]) -> None:
        super().__init__(snapshot)
        self.shelf = MemoryShelf(surfaces)
        self._painter = StandIn(self.shelf)
        self.paint, self.surface_source = self._painter.paint, self._painter.surface_source
        self.measuring = Measuring(self.surface_source, lambda: self.snapshot)
        self.measure = self.measuring.measure

    @property
    def painted(self) -> list[RenderRequest]:
        """What was asked of the painter, in order."""
        return self._painter.asked

    def close(self) -> None:
        self._painter.close()
