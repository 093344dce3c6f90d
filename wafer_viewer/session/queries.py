"""What may be asked of a session at any time and from any thread: the surface, its places, its pictures."""

from __future__ import annotations

import threading
from concurrent.futures import Future
from typing import TYPE_CHECKING

from wafer_viewer.model.acquisition.focus_stack import Image
from wafer_viewer.model.findings import AnyResult
from wafer_viewer.model.measurement.levelling import Datum, Levelling
from wafer_viewer.model.measurement.measurements import Profile, ProfileCurve
from wafer_viewer.model.measurement.tool_options import ToolOptions
from wafer_viewer.model.measurement.tools import ToolName
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.field_poses import Poses
from wafer_viewer.model.surface.height_map import HeightMap, Mosaic
from wafer_viewer.session.measurement.dataset_queries import DatasetQueries, ReadOut

if TYPE_CHECKING:
    from wafer_viewer.session.rendering.render_process import Painter
    from wafer_viewer.session.rendering.render_request import RenderRequest


class QueryApi:
    """The half of a session that changes nothing; its painter comes up with the first picture."""

    def __init__(self, questions: DatasetQueries) -> None:
        self._questions = questions
        self._painter: Painter | None = None
        self._painter_lock = threading.Lock()

    def mosaic(self) -> Mosaic:
        """The stitched surface of the open dataset."""
        return self._questions.mosaic()

    def height_map(self, field: int) -> HeightMap:
        """The surface of one field."""
        return self._questions.height_map(field)

    def surface_source(self, show: int) -> Mosaic:
        """What a browser shows: 0 the stitched surface, else the field of that number."""
        return self._questions.surface_source(show)

    def poses(self) -> Poses | None:
        """Where the fields of the stitched surface lie and what their overlaps said; None where only the stage did."""
        return self._questions.poses()

    def frame(self, field: int, k: int) -> Image:
        """One frame of a field, as it was stored."""
        return self._questions.frame(field, k)

    def frame_near(self, field: int, z_um: float) -> Image:
        """The frame of a field that was taken nearest to a z, as it was stored."""
        return self._questions.frame_near(field, z_um)

    def thumbnail(self, number: int) -> bytes | None:
        """The small picture, JPEG, that was kept with a result."""
        return self._questions.thumbnail(number)

    def measure(
        self,
        tool: ToolName,
        places: tuple[Region, ...],
        show: int = 0,
        levelling: Levelling | None = None,
        options: ToolOptions | None = None,
    ) -> AnyResult:
        """What a tool finds at its places, heights read from the stage's zero or as levelled."""
        return self._questions.measuring.measure(tool, places, show, levelling, options)

    def datum(self, levelling: Levelling, show: int = 0) -> Datum:
        """The zero that a way of levelling lays through what is shown."""
        return self._questions.measuring.datum(levelling, show)

    def profile(self, line: Region, show: int = 0, levelling: Levelling | None = None) -> tuple[Profile, ProfileCurve]:
        """A section along a line."""
        return self._questions.measuring.profile(line, show, levelling)

    def read_out(self, x_um: float, y_um: float, show: int = 0) -> ReadOut:
        """The surface at a point."""
        return self._questions.read_out(x_um, y_um, show)

    def paint(self, request: RenderRequest) -> Future[bytes]:
        """A picture tile, made in a process of its own."""
        from wafer_viewer.session.rendering.render_process import Painter

        with self._painter_lock:
            self._painter = self._painter or Painter()
        return self._painter.paint(request)
