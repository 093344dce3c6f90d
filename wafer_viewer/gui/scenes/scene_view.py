"""Scene of one browser: draws the session's state for a view, on its own thread."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Hashable
from functools import partial
from typing import Any

import numpy as np
import viser

from wafer_viewer.draw.surface import mesh
from wafer_viewer.draw.surface.display_style import DisplayStyle, eight_bit
from wafer_viewer.draw.surface.mesh import painted
from wafer_viewer.gui.scene.camera_controller import CameraController
from wafer_viewer.gui.scene.camera_presets import CameraPose, Clear
from wafer_viewer.gui.scene.display_range import DisplayRangeHysteresis, Range, range_in_view
from wafer_viewer.gui.scene.primitives import Box, Group, lines, rectangle, word
from wafer_viewer.gui.scene.reconciler import NotReady, SceneItem, SceneReconciler, SendWindow
from wafer_viewer.gui.scene.scene_contents import DisplayedSurface, SceneContents, colours, corners_of, corners_over
from wafer_viewer.gui.scene.surface_tiles import PointTile, Shown, SurfaceInfoCache, surface_items
from wafer_viewer.gui.scene.viewport import Viewport
from wafer_viewer.gui.scenes.plan_scene import box_edges, field_box, fields_box, flat_items, plan_contents, sample_items
from wafer_viewer.gui.scenes.pose_overlay import PoseCache
from wafer_viewer.gui.scenes.surface_scene import marked, only_grew, result_of, source_of, surface_contents
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.tools.clip_box import Moved
from wafer_viewer.gui.tools.scene_tools import Tools
from wafer_viewer.gui.widgets.callbacks import LatestOnlyWorker
from wafer_viewer.model.acquisition.focus_stack import Image
from wafer_viewer.model.acquisition.plan import Field
from wafer_viewer.model.measurement.tool_options import LevelBy, Levelling
from wafer_viewer.model.region import Region
from wafer_viewer.session.rendering.render_request import SurfaceKey, SurfaceStatistics
from wafer_viewer.session.state.snapshot import FieldState, LatestFrame, OpenDataset, Snapshot

# -------------------------------------------------------------------------------------------------------- acquire scene


_TEXTURE_PIXELS = 1_600_000
"""Budget of texture pixels for all finished fields."""
_FIELD_PIXELS = 200_000
_FRAME_SIDE_PX = 480
_NOT_TAKEN = (FieldState.TO_COME, FieldState.TO_REPEAT, FieldState.TAKING, FieldState.FAILED)


def acquire_contents(
    cache: SurfaceInfoCache, snapshot: Snapshot, view: View, latest: LatestFrame | None
) -> SceneContents:
    """Return the fields of the open dataset at their current state; the plan if no dataset is open."""
    data = snapshot.dataset
    if data is None:
        return plan_contents(snapshot, view)
    if not data.fields:  # a surface file: it is drawn as soon as it is read, and the sample on the stage is another
        return SceneContents(
            items=(), corners_mm=corners_of((-1.0, -1.0, 1.0, 1.0), 0.0, 0.0), place=("file", data.path)
        )
    size = data.plan.cols * data.plan.pixel_um, data.plan.rows * data.plan.pixel_um
    facts = cache.available_facts({n: _source(data, snapshot, n) for n in sorted(data.stamps)})
    z0 = min((f.lowest_um for f in facts.values()), default=min(f.z_start_um for f in data.fields))
    box = fields_box(data.fields, *size)
    floor = -0.006 * max(box[2] - box[0], box[3] - box[1])
    items = _live(snapshot, view, latest, data, size, z0, floor)
    if snapshot.dataset_overview is not None:
        items += sample_items(snapshot, view.dark, floor, dimmed=True)
    taken = {number for number, state in data.states.items() if state not in _NOT_TAKEN}
    items += flat_items([f for f in data.fields if f.number not in facts], taken, *size, floor, view.dark)
    items += _finished(data, snapshot, view, facts, z0)
    return SceneContents(
        items=tuple(items),
        corners_mm=corners_of(box, floor, 0.12 * (box[3] - box[1])),
        place=("acquire", data.path),
        awaits_more=len(facts) < len(data.stamps),
        stretch=view.exaggeration,
        clear=Clear(left=60, right=60, top=110, bottom=90),
    )


def _source(data: OpenDataset, snapshot: Snapshot, number: int) -> SurfaceKey:
    return SurfaceKey(data.path, result_of(snapshot), number, data.stamps[number])


# ---------------------------------------------------------------- finished fields


def _finished(
    data: OpenDataset, snapshot: Snapshot, view: View, facts: dict[int, SurfaceStatistics], z0_um: float
) -> list[SceneItem]:
    if not facts:
        return []
    low, high = _common_range(list(facts.values()))
    look = DisplayStyle("height", view.colours, low, high, view.hillshade, view.all_in_focus)
    pixels = min(_FIELD_PIXELS, _TEXTURE_PIXELS // len(facts))
    items: list[SceneItem] = []
    for number, fact in facts.items():
        source = _source(data, snapshot, number)
        items += surface_items(Shown(source, fact, fact), look, _solid(view), z0_um, pixels, f"field/{number}")
    return items


def _solid(view: View) -> View:
    """Return the view with fields drawn as surfaces, independent of the look of the stitched surface."""
    return view if view.look == "surface" else View(step="acquire", dark=view.dark)


def _common_range(facts: list[SurfaceStatistics]) -> tuple[float, float]:
    """Return one height range for all fields, rounded so that it seldom changes when a field is added."""
    low, high = min(f.low_um for f in facts), max(f.high_um for f in facts)
    step = max(high - low, 0.5) / 8
    step = 2.0 ** round(math.log2(step))
    return math.floor(low / step) * step, math.ceil(high / step) * step


# ---------------------------------------------------------------- the field being taken


def _live(
    snapshot: Snapshot,
    view: View,
    latest: LatestFrame | None,
    data: OpenDataset,
    size: tuple[float, float],
    z0_um: float,
    floor_mm: float,
) -> list[SceneItem]:
    """Return the box of the current field's z range, and its latest frame at its z."""
    scan = snapshot.scan
    if scan is None or scan.finished or not snapshot.scanning:
        return []
    box, stretch = field_box(scan.field, *size), view.exaggeration * 1e-3
    low = (scan.field.z_start_um - z0_um) * stretch
    high = low + data.plan.sweep.range_um * stretch
    items = [
        SceneItem(
            "live/box", (box, floor_mm, high, view.dark),
            partial(_box, field=scan.field, box=box, low=max(low, floor_mm), high=high, dark=view.dark),
        )
    ]  # fmt: skip
    if latest is not None and latest.field.number == scan.field.number:
        z = (latest.z_um - z0_um) * stretch
        drawn = partial(_frame, image=latest.image, box=box, z=z, dark=view.dark)
        items.insert(0, SceneItem("live/frame", (latest, z, view.dark), drawn))
    return items


def _box(
    scene: viser.SceneApi, name: str, _: bytes, *, field: Field, box: Box, low: float, high: float, dark: bool
) -> Group:
    accent, unit = colours(dark).accent, min(box[2] - box[0], box[3] - box[1])
    corner = (box[0] + 0.06 * unit, box[1] + 0.06 * unit, high + 0.01 * unit)
    ink = (255, 255, 255) if not dark else (11, 15, 19)
    return Group(
        lines(scene, f"{name}/edges", box_edges(box, low, high), accent, 1.6),
        word(scene, f"{name}/number", str(field.number), corner, 0.24 * unit, ink, accent, (0.0, 0.0)),
    )


def _frame(
    scene: viser.SceneApi, name: str, _: bytes,
    *, image: Image, box: Box, z: float, dark: bool,
) -> Group:  # fmt: skip
    step = -(-max(image.shape) // _FRAME_SIDE_PX)
    grey = eight_bit(image[::step, ::step])
    data = painted(mesh.flat(*box, z), np.repeat(grey[..., None], 3, axis=2))
    return Group(
        scene.add_glb(f"{name}/picture", data, cast_shadow=False, receive_shadow=False),
        lines(scene, f"{name}/edge", rectangle(box, z), colours(dark).accent, 4.0),
    )


# ----------------------------------------------------------------------------------------------------------- scene view


_CAMERA_EVERY_S = 0.1
_FENCE = "wafer-viewer-fence"
"""Key of the request whose answer confirms that the browser has processed everything sent before."""
Wanted = tuple[Snapshot, View]
Errand = Callable[[SceneContents], None]
"""A camera command, called with the displayed contents."""


class SceneView:
    """Draws into ``client.scene``. Methods return at once, except `settle`; drawing runs on the scene's own threads.

    on_fault: called with drawing errors, on the scene's thread.
    """

    def __init__(
        self,
        client: viser.ClientHandle,
        session: Any,
        on_fault: Callable[[Exception], None] | None = None,
        poses: PoseCache | None = None,
        viewport: Viewport | None = None,
    ) -> None:
        self._client, self._session = client, session
        self._on_fault = on_fault or (lambda fault: None)
        self._due = threading.Condition()
        self._wanted: Wanted | None = None
        self._begun: Wanted | None = None
        self._requested: Hashable = None
        self._more, self._closed, self._settled = False, False, True
        self._gate = SendWindow(lambda: client.local_storage.get_item(_FENCE), self._arrived)
        self._stage = SceneReconciler(client.scene, session.paint, self._arrived, self._gate)
        self._cache = SurfaceInfoCache(
            session.paint, self._arrived, lambda levelling, show: session.datum(levelling, show)
        )
        self._poses = poses or PoseCache(lambda: session.poses(), self._on_fault)
        self._poses.on_arrival(self._arrived)
        self._steady = DisplayRangeHysteresis()
        viewport = viewport or Viewport(client.camera)
        self._eye = CameraController(client, viewport)
        self._tools = Tools(client, self._eye, lambda show: session.surface_source(show))
        self._shown: SceneContents | None = None
        self._place: Hashable = None
        self._stands: Hashable = None
        self._handled: object = None
        self._errand: Errand | None = None
        self._first_pose: CameraPose | None = None
        self._print_px: int | None = None
        self._camera_listener: Callable[[], object] = lambda: None
        self._moves = LatestOnlyWorker("camera")
        self._scale_listener: Callable[[DisplayedSurface | None], None] = lambda on_show: None
        self._points_listener: Callable[[int], None] = lambda drawn: None
        self._drawn_points = 0
        client.scene.add_frame("/WorldAxes", visible=False)  # stands before the axes that viser draws for everyone
        # Also when the browser reports the size of the scene, which may come after the camera's report of that resize.
        viewport.on_change(lambda: self._moves.ask(self._camera_moved))
        threading.Thread(target=self._run, name="scene", daemon=True).start()

    # ---------------------------------------------------------------- what the page calls

    def draw(self, snapshot: Snapshot, view: View) -> None:
        """Show a snapshot with a view from now on; repeated calls with the same arguments cost nothing."""
        essence = self._essence(snapshot, view)
        with self._due:
            if essence == self._requested:
                return
            self._requested, self._wanted, self._more = essence, (snapshot, view), True
            self._due.notify_all()

    def look_from(self, preset: str) -> None:
        """Move the camera to ``top``, ``front`` or ``iso``; ``all`` keeps the direction and frames everything."""
        self._send(lambda shown: self._eye.frame(shown.corners_mm, preset, shown.clear, flying=True))

    def fly_to(self, bounds_um: Box) -> None:
        """Frame a rectangle of the surface, (x low, y low, x high, y high) in stage um, from the current direction."""
        self._send(lambda shown: self._eye.fly(corners_over(bounds_um, shown)))

    @property
    def pose(self) -> CameraPose | None:
        """Camera pose, or the goal of its transition; None before there is a camera."""
        return self._eye.goal if self._place is not None else None

    def go_to(self, pose: CameraPose) -> None:
        """Move the camera to a pose once the requested contents are drawn."""
        self._send(lambda _: self._eye.go(pose, flying=True))

    def let_fly(self, able: bool) -> None:
        """Enable animated camera transitions; without them the camera jumps."""
        self._eye.let_fly(able)

    def reopen(self, pose: CameraPose) -> None:
        """Set the initial camera pose, in place of the view of everything."""
        self._first_pose = pose

    def range_in_view(self, then: Callable[[Range], None]) -> None:
        """Call back, on another thread, with the range of the displayed quantity within the view."""
        if self._shown is not None and self._shown.on_show is not None:
            range_in_view(self._session.paint, self._shown.on_show, self.visible_um(), then)

    def visible_um(self) -> tuple[tuple[float, float], ...] | None:
        """Return the corners of the visible ground in stage um; None if it reaches the horizon."""
        return self._eye.sight().ground_um(float(self._eye.goal.look_at[2])) if self._place is not None else None

    def settle(self, width_px: int | None, timeout_s: float) -> bool:
        """Wait until everything is drawn for an image `width_px` wide; return whether that was achieved in time.

        width_px: None for the resolution of the screen.
        """
        with self._due:
            self._print_px, self._more = width_px, True
            self._due.notify_all()
            return self._due.wait_for(lambda: self._closed or not self._busy, timeout_s) and not self._closed

    def um_per_pixel(self) -> float:
        """Return the size of a CSS pixel at the point looked at, 0 before there is a camera."""
        return self._eye.um_per_pixel()

    def on_camera(self, callback: Callable[[], object]) -> None:
        """Call back after the camera has moved or the canvas was resized, at most ten times a second."""
        self._camera_listener = callback

    def on_scale(self, callback: Callable[[DisplayedSurface | None], None]) -> None:
        """Call back when the colours of the displayed surface have changed, for the colour bar; None: no colour bar."""
        self._scale_listener = callback

    def on_points(self, callback: Callable[[int], None]) -> None:
        """Call back when the number of drawn points has changed."""
        self._points_listener = callback

    def on_pick(self, callback: Callable[[float, float], None]) -> None:
        """Call back with the stage x, y in um of a click on the surface."""
        self._tools.on_pick(callback)

    def on_lines(self, callback: Callable[[tuple[Region, ...], int], None]) -> None:
        """Call back with the profile lines while handles are dragged, and when an initial line is placed."""
        self._tools.on_lines(callback)

    def on_cursor(self, callback: Callable[[int, float], None]) -> None:
        """Call back with a profile cursor and its fraction of the line, while its marker is dragged or placed."""
        self._tools.on_cursor(callback)

    def on_select(self, callback: Callable[[Box], None]) -> None:
        """Call back with a stage rectangle, um, selected by dragging."""
        self._tools.on_select(callback)

    def on_clip(self, callback: Moved) -> None:
        """Call back with the clip box while the handle of one of its faces is dragged."""
        self._tools.on_clip(callback)

    def on_places(self, callback: Callable[[tuple[Region, ...]], None]) -> None:
        """Call back with the regions of the active tool while they are dragged, and when initial ones are placed."""
        self._tools.on_places(callback)

    def on_levelling(self, callback: Callable[[Levelling], None]) -> None:
        """Call back when a levelling region has been moved and released."""
        self._tools.on_levelling(callback)

    def first_levelling(self, by: LevelBy) -> Levelling:
        """Return a levelling with initial regions on the surface. Raises MeasureError before a surface is drawn."""
        return self._tools.first_levelling(by)

    @property
    def busy(self) -> bool:
        """True while requested contents are not drawn or replaced nodes are not removed yet."""
        with self._due:
            return self._busy

    @property
    def _busy(self) -> bool:
        return self._more or not self._settled or self._errand is not None

    def close(self) -> None:
        """Stop the threads after the browser has gone."""
        with self._due:
            self._closed = True
            self._due.notify_all()
        for part in (self._gate, self._cache, self._tools, self._moves, self._poses, self._eye):
            part.close()

    # ---------------------------------------------------------------- the scene's thread

    def _essence(self, snapshot: Snapshot, view: View) -> Hashable:
        """Return the part of the state that affects the scene; most of the ten snapshots a second do not change it."""
        data, latest = snapshot.dataset, self._session.latest_frame
        if view.step == "plan":
            draft = snapshot.draft
            return view.step, view.dark, draft.job, draft.plan, snapshot.overview, snapshot.rig.limits
        source = source_of(snapshot, view.show) if view.step != "acquire" else None
        if source is not None:
            return view, source, snapshot.scanning, snapshot.findings if view.step == "measure" else ()
        progress = None if data is None else (data.path, *data.states.items(), *data.stamps.items())
        return view, progress, latest, snapshot.scanning, snapshot.overview, snapshot.draft.plan

    def _camera_moved(self) -> None:
        """Handle a camera move on its own thread, throttled by a pause; the last of many moves is always handled."""
        pose = self._eye.moved()
        self._tools.resize()
        self._arrived()
        self._camera_listener()
        time.sleep(_CAMERA_EVERY_S)
        self._tools.aim(pose)

    def _send(self, errand: Errand) -> None:
        with self._due:
            self._errand, self._more = errand, True
            self._due.notify_all()

    def _arrived(self) -> None:
        with self._due:
            self._more = True
            self._due.notify_all()

    def _run(self) -> None:
        pause: float | None = None
        while True:
            with self._due:
                self._due.wait_for(lambda: self._more or self._closed, pause)
                if self._closed:
                    return
                self._more, self._settled = False, False
                self._begun = wanted = self._next()
            complete = self._turn(wanted)
            pause = self._stage.remove_expired()
            with self._due:
                if complete:
                    self._begun = None
                    self._more |= wanted is not self._wanted
                self._settled = complete and pause is None
                self._due.notify_all()

    def _next(self) -> Wanted | None:
        """Return the contents to draw; for a growing surface the unfinished ones, so that fast growth is displayed."""
        if self._begun is None or self._wanted is None or not only_grew(self._begun, self._wanted):
            return self._wanted
        return self._begun

    def _turn(self, wanted: Wanted | None) -> bool:
        """Draw once and run the pending camera command; return whether everything is drawn."""
        complete = True
        try:
            if wanted is not None:
                complete = self._draw(*wanted)
        except NotReady:
            return False
        except Exception as fault:  # noqa: BLE001 - reported, so that the thread goes on to draw
            self._on_fault(fault)
        self._run_errand()
        return complete

    def _run_errand(self) -> None:
        """Run the pending camera command after the requested contents have been set."""
        with self._due:
            errand, self._errand = self._errand, None
            self._more |= errand is not None
        if errand is not None and self._shown is not None:
            errand(self._shown)

    def _draw(self, snapshot: Snapshot, view: View) -> bool:
        """Draw the available contents in one pass; pending render results trigger another pass."""
        contents = self._contents(snapshot, view)
        self._place_camera(contents)
        if contents.rough and self._stands != contents.place and not self._stage.show(contents.rough, contents.stretch):
            return False
        self._stands = contents.place
        self._scale_listener(contents.on_show)
        visible = () if contents.visible is None else contents.visible(self._eye.sight(), self._finer)
        complete = self._stage.show((*visible, *contents.items), contents.stretch)
        self._tell_points(view)
        self._stage.settle(self._eye.um_per_pixel() * 1e-3)
        handled = view, marked(snapshot, view), contents.on_show
        if complete or handled != self._handled:  # handles do not wait for the last tile
            self._tools.show(view, contents.on_show, self._cache, handled[1])
            self._handled = handled
        return complete and not contents.awaits_more

    def _tell_points(self, view: View) -> None:
        """Set the size of all points and report their number."""
        tiles = self._stage.each(PointTile)
        for tile in tiles:
            tile.size_px = view.point_px
        drawn = sum(tile.n_points for tile in tiles)
        if drawn != self._drawn_points:
            self._drawn_points = drawn
            self._points_listener(drawn)

    @property
    def _finer(self) -> float:
        """Rendered pixels per screen pixel."""
        return max(1.0, self._print_px / max(1, self._client.camera.image_width)) if self._print_px else 1.0

    def _contents(self, snapshot: Snapshot, view: View) -> SceneContents:
        if view.step == "plan":
            return plan_contents(snapshot, view)
        source = source_of(snapshot, view.show) if view.step != "acquire" else None
        if source is not None:
            return surface_contents(self._cache, self._steady, self._poses, snapshot, view, source)
        return acquire_contents(self._cache, snapshot, view, self._session.latest_frame)

    def _place_camera(self, contents: SceneContents) -> None:
        if contents.place != self._place:
            self._eye.frame(contents.corners_mm, contents.preset, contents.clear)
            if self._first_pose is not None:
                self._eye.go(self._first_pose)
                self._first_pose = None
        else:
            self._eye.follow(contents.corners_mm, contents.clear)
        self._place, self._shown = contents.place, contents
