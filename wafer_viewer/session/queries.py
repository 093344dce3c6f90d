"""Session queries, from any thread at any time: surfaces, measurements and rendered pictures."""

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
    """Read-only part of a session; its render process starts with the first picture."""

    def __init__(self, questions: DatasetQueries) -> None:
        self._questions = questions
        self._painter: Painter | None = None
        self._painter_lock = threading.Lock()

    def mosaic(self) -> Mosaic:
        """Return the stitched surface of the open dataset."""
        return self._questions.mosaic()

    def height_map(self, field: int) -> HeightMap:
        """Return the surface of one field."""
        return self._questions.height_map(field)

    def surface_source(self, show: int) -> Mosaic:
        """Return the displayed surface: 0 the stitched one, above 0 the field of that number, below 0 a comparison."""
        return self._questions.surface_source(show)

    def poses(self) -> Poses | None:
        """Return the field poses and overlap measurements of the stitched surface.

        None if only stage positions were used.
        """
        return self._questions.poses()

    def frame(self, field: int, k: int) -> Image:
        """Return one frame of a field, as it was stored."""
        return self._questions.frame(field, k)

    def frame_near(self, field: int, z_um: float) -> Image:
        """Return the frame of a field nearest to a z, as it was stored."""
        return self._questions.frame_near(field, z_um)

    def thumbnail(self, number: int) -> bytes | None:
        """Return the thumbnail of a result, JPEG; None if there is none."""
        return self._questions.thumbnail(number)

    def measure(
        self,
        tool: ToolName,
        places: tuple[Region, ...],
        show: int = 0,
        levelling: Levelling | None = None,
        options: ToolOptions | None = None,
    ) -> AnyResult:
        """Return the result of a measuring tool at its regions, heights relative to the stage's zero or levelled."""
        return self._questions.measuring.measure(tool, places, show, levelling, options)

    def datum(self, levelling: Levelling, show: int = 0) -> Datum:
        """Return the datum of a levelling on the displayed surface."""
        return self._questions.measuring.datum(levelling, show)

    def profile(self, line: Region, show: int = 0, levelling: Levelling | None = None) -> tuple[Profile, ProfileCurve]:
        """Return a section along a line."""
        return self._questions.measuring.profile(line, show, levelling)

    def read_out(self, x_um: float, y_um: float, show: int = 0) -> ReadOut:
        """Return the surface at a point."""
        return self._questions.read_out(x_um, y_um, show)

    def paint(self, request: RenderRequest) -> Future[bytes]:
        """Render an image tile, in a separate process."""
        from wafer_viewer.session.rendering.render_process import Painter

        with self._painter_lock:
            self._painter = self._painter or Painter()
        return self._painter.paint(request)
