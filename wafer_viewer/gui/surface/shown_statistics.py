"""Statistics of the surface shown in one browser: of all of it, of the part in view, or of the selection.

The panel, the histogram, the range of colours, the map and the export read them from the page, so that they agree.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import msgspec

from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.scene.reconciler import NotReady, RenderQueue
from wafer_viewer.gui.scene.scene_contents import DisplayedSurface
from wafer_viewer.gui.scenes.surface_scene import source_of
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.model.errors import WaferViewerError
from wafer_viewer.model.surface.clipping import Box
from wafer_viewer.session.rendering.render_request import RenderRequest, Statistics
from wafer_viewer.session.state.snapshot import Snapshot, SurfaceInfo

Corners = tuple[tuple[float, float], ...]
_KEPT = 64
_ROUNDED = 200
"""The view is rounded to this part of the surface, so that small camera moves start no new count."""


class ShownStatistics:
    """Part of the page that updates the statistics before the parts that show them; the painter counts."""

    def __init__(self, page: Page, seen_um: Callable[[], Corners | None]) -> None:
        self._page, self._seen_um = page, seen_um
        self._orders = RenderQueue(page.session.paint, page.redraw)
        self._known: dict[RenderRequest, Statistics] = {}
        self._of: RenderRequest | None = None
        self.problem = ""

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Request new statistics if the displayed part has changed."""
        self.problem = ""
        request = self._request(snapshot, view)
        self._page.counted_um = request.box_um if request is not None else None
        if request is None:
            self._page.statistics = _of_all(snapshot, view)
            self._orders.keep_only(set())
            return
        self._orders.keep_only({request})
        try:
            self._page.statistics, self._of = self._counted(request), request
        except NotReady:
            if self._of is None or not _same_part(self._of, request):
                self._page.statistics = _of_all(snapshot, view)
        except WaferViewerError as fault:
            self._page.statistics, self.problem = None, str(fault)

    def seen_um(self) -> Box | None:
        """Return the box of the surface in view; None if all of it is."""
        return self._box_um(self._page.on_show, replace(self._page.view, counted="view"))

    def _request(self, snapshot: Snapshot, view: View) -> RenderRequest | None:
        on_show, source = self._page.on_show, source_of(snapshot, view.show)
        looked_at = view.step in ("surface", "measure") and not snapshot.scanning
        if not looked_at or on_show is None or source is None or on_show.source != source:
            return None
        if view.counted == "selection" and view.selection is None:
            return None
        return RenderRequest(
            source,
            "statistics",
            datum=on_show.datum,
            box_um=self._box_um(on_show, view),
            clip=view.clipped,
            brush_um=view.brush,
            refused=view.draws_refused,
        )

    def _box_um(self, on_show: DisplayedSurface | None, view: View) -> Box | None:
        if view.counted == "selection":
            return view.selection
        corners = self._seen_um() if view.counted == "view" else None
        if corners is None or on_show is None:
            return None
        facts = on_show.facts
        step = facts.pixel_um * max(1, max(facts.rows, facts.cols) // _ROUNDED)
        x0, y1 = facts.x0_um, facts.y0_um
        x1, y0 = x0 + (facts.cols - 1) * facts.pixel_um, y1 - (facts.rows - 1) * facts.pixel_um
        xs, ys = ([round(v / step) * step for v in axis] for axis in zip(*corners, strict=True))
        box = max(x0, min(xs)), max(y0, min(ys)), min(x1, max(xs)), min(y1, max(ys))
        return None if box == (x0, y0, x1, y1) else box

    def _counted(self, request: RenderRequest) -> Statistics:
        """Return the statistics of a request. Raises NotReady, or WaferViewerError if they cannot be computed."""
        if request not in self._known:
            told = msgspec.msgpack.decode(self._orders.outcome(request).result(), type=Statistics)
            self._known = dict(list(self._known.items())[1 - _KEPT :])
            self._known[request] = told
        return self._known[request]


def _same_part(a: RenderRequest, b: RenderRequest) -> bool:
    """Return whether two requests count the same part apart from clip, brush and rejected points.

    The statistics of the first can then be shown until those of the second are ready.
    """
    return replace(a, clip=b.clip, brush_um=b.brush_um, refused=b.refused) == b


def _of_all(snapshot: Snapshot, view: View) -> Statistics | None:
    """Return the statistics that the session has of the whole stitched surface; None for any other part."""
    info = snapshot.surface
    whole = view.show == 0 and view.counted == "all" and view.levelling.by == "stage"
    return _as_statistics(info) if info is not None and whole else None


def _as_statistics(info: SurfaceInfo) -> Statistics:
    n = round(info.rows * info.cols * info.measured_fraction)
    return Statistics(
        rows=info.rows,
        cols=info.cols,
        pixel_um=info.pixel_um,
        n_heights=n,
        n_points=n,
        measured_fraction=info.measured_fraction,
        filled_fraction=info.filled_fraction,
        unmeasured=info.unmeasured,
        lowest_um=info.lowest_um,
        highest_um=info.highest_um,
        mean_um=None,
        spread_um=None,
    )
