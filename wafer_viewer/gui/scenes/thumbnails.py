"""Thumbnails of measured regions, rendered when their results are first listed."""

from __future__ import annotations

import base64
import math
from collections.abc import Sequence
from concurrent.futures import CancelledError, Future

import numpy as np
from markupsafe import Markup

from wafer_viewer.draw.surface.display_style import DisplayStyle
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.presenters.measurement import sign_colour
from wafer_viewer.gui.presenters.results import Box, bounds_of
from wafer_viewer.gui.presenters.review import ReviewItem
from wafer_viewer.gui.scenes.surface_scene import source_of
from wafer_viewer.gui.tools.region_tools import outline_of
from wafer_viewer.model.errors import WaferViewerError
from wafer_viewer.model.findings import AnyResult
from wafer_viewer.model.inspection.defect import Evidence
from wafer_viewer.model.region import Region
from wafer_viewer.session.rendering.render_request import RenderRequest
from wafer_viewer.session.state.snapshot import Snapshot

WIDTH_PX, HEIGHT_PX = 44, 33
_ROOM, _LEAST_PX = 1.7, 32
"""Size of a thumbnail relative to its regions, and its least size in pixels of the surface."""


class Thumbnails:
    """Thumbnails by request. A pending one is an empty box, and the page is redrawn when it is available."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._requested: dict[RenderRequest, Future[bytes]] = {}

    def painted_all(self, requests: Sequence[RenderRequest | None]) -> list[bytes]:
        """Return images as `painted` does, and cancel all other requests that are pending."""
        wanted = set(requests)
        for request in [request for request, future in self._requested.items() if not future.done()]:
            if request not in wanted:
                self._requested.pop(request).cancel()
        return [self.painted(request) if request is not None else b"" for request in requests]

    def of(self, finding: AnyResult, snapshot: Snapshot) -> Markup:
        """Return the thumbnail of a result, with its regions outlined in its colour, as HTML."""
        request = picture_of(finding, snapshot)
        data = self.painted(request) if request is not None else b""
        return thumbnail(data, outlines(finding, box_of(finding, snapshot)))

    def painted(self, request: RenderRequest) -> bytes:
        """Return an image as JPEG; empty while it is pending or if it failed."""
        future = self._requested.get(request)
        if future is None or future.cancelled():
            future = self._requested[request] = self._page.session.paint(request)
            future.add_done_callback(lambda _: self._page.redraw())
        return future.result() if future.done() and future.exception() is None else b""


def thumbnail(jpeg: bytes, over: str = "") -> Markup:
    """Return a thumbnail with an overlay as HTML."""
    return Markup('<span class="wv-thumb">{}{}</span>').format(image(jpeg), over)


def image(jpeg: bytes) -> Markup:
    """Return an image as HTML; empty without one."""
    src = base64.b64encode(jpeg).decode()
    return Markup('<img alt="" src="data:image/jpeg;base64,{}">').format(src) if jpeg else Markup()


DEFECT_PX, DEFECT_ROOM, LEAST_DEFECT_PX = 96, 1.8, 48
"""Side of the picture of a defect, relative to its size, and at least in pixels of the surface."""
LAYERS: dict[Evidence, DisplayStyle] = {"picture": DisplayStyle(colour_by="grey")}
"""Display style of a defect that shows in the picture only; else that of heights."""


def defect_request(item: ReviewItem, snapshot: Snapshot) -> RenderRequest | None:
    """Return the request for the square picture of a defect; None while its surface is not available."""
    source = source_of(snapshot, item.show)
    if source is None or item.box_um is None:
        return None
    (x0, y0, x1, y1), pixel_um = item.box_um, snapshot.surface.pixel_um if snapshot.surface else 1.0
    half = max(DEFECT_ROOM * max(x1 - x0, y1 - y0), LEAST_DEFECT_PX * pixel_um) / 2
    x, y = (x0 + x1) / 2, (y0 + y1) / 2
    look = LAYERS.get(item.evidence, DisplayStyle())
    box = (x - half, y - half, x + half, y + half)
    return RenderRequest(source, "picture", box_um=box, side_px=DEFECT_PX, look=look)


def painted(page: Page, finding: AnyResult, wait_s: float) -> bytes | None:
    """Return the image stored with a result, as JPEG; None if it is not available in time.

    It blocks up to `wait_s`, so it must not run on a page's own thread.
    """
    request = picture_of(finding, page.session.snapshot)
    if request is None:
        return None
    try:
        return page.session.paint(request).result(wait_s) or None
    except (TimeoutError, CancelledError, WaferViewerError):
        return None


def picture_of(finding: AnyResult, snapshot: Snapshot) -> RenderRequest | None:
    """Return the render request of a result; None while the surface it was measured on is not available."""
    source = source_of(snapshot, finding.show)
    return None if source is None else RenderRequest(source, "picture", box_um=box_of(finding, snapshot))


def box_of(finding: AnyResult, snapshot: Snapshot) -> Box:
    """Return the extent of a result's thumbnail, in um."""
    return framed(bounds_of(finding, _LEAST_PX * (snapshot.surface.pixel_um if snapshot.surface else 1.0)))


def framed(bounds: Box) -> Box:
    """Return a box around another, with a margin and the aspect ratio of a thumbnail."""
    (x0, y0, x1, y1), aspect = bounds, WIDTH_PX / HEIGHT_PX
    width = max(x1 - x0, (y1 - y0) * aspect) * _ROOM
    x, y = (x0 + x1) / 2, (y0 + y1) / 2
    return x - width / 2, y - width / aspect / 2, x + width / 2, y + width / aspect / 2


def outlines(finding: AnyResult, box: Box) -> Markup:
    """Return the regions of a result over the image of a box, as SVG."""
    paths = Markup("").join(_path(place, box) for place in finding.drawn)
    style = Markup('style="--tone:{}"').format(sign_colour(finding))
    return Markup('<svg viewBox="0 0 {width_px} {height_px}" {style}>{paths}</svg>').format(
        width_px=WIDTH_PX, height_px=HEIGHT_PX, style=style, paths=paths
    )


def _path(place: Region, box: Box) -> Markup:
    x0, y0, x1, y1 = box
    corners = outline_of(place)
    if len(corners) == 0:
        corners = np.array([(point.x_um, point.y_um) for point in place.points])
    x, y = (corners[:, 0] - x0) / (x1 - x0) * WIDTH_PX, (y1 - corners[:, 1]) / (y1 - y0) * HEIGHT_PX
    if place.kind == "point":
        return Markup('<circle cx="{:.1f}" cy="{:.1f}" r="3"/>').format(x[0], y[0])
    step = max(1, math.ceil(len(x) / 24))
    points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x[::step], y[::step], strict=True))
    return (
        Markup('<polyline points="{}"/>').format(points)
        if place.is_path
        else Markup('<polygon points="{}"/>').format(points)
    )
