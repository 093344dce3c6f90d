"""Assembly of a page: theme, header, panels, overlays, scene, keys, and the callbacks between them.

The browser's part is lost_connection.js; it gets its texts in advance and a heartbeat every second.
"""

from __future__ import annotations

import itertools
import secrets
import threading
import time
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import viser
from markupsafe import Markup

from wafer_viewer.gui.dialogs.control_handover import CONTROL_PICKS, NOT_HANDED_OVER, ControlNews, control_strip
from wafer_viewer.gui.dialogs.stop import complete_fields_sentence
from wafer_viewer.gui.elements.step import Here, StepDock, StepOverlay, StepPanel
from wafer_viewer.gui.measure.live_measurement import LiveProfiles
from wafer_viewer.gui.measure.profile_dock import PROFILE_PICKS, ProfilePlot, profile_dock
from wafer_viewer.gui.overlays.hud import (
    Clicked,
    PoseLegend,
    click_surface,
    colour_legend,
    legend,
    origin_legend,
    pose_legend,
    read_out,
    scale_bar,
    sheet_over,
)
from wafer_viewer.gui.overlays.toolbar import PrintPicture, toolbar
from wafer_viewer.gui.page.browser_info import BrowserEvents
from wafer_viewer.gui.page.page import Page, PagePart
from wafer_viewer.gui.page.panels import awaited, bottom_panel_height_px
from wafer_viewer.gui.page.work_steps import possible
from wafer_viewer.gui.scenes.pose_overlay import PoseCache
from wafer_viewer.gui.scenes.scene_view import SceneView
from wafer_viewer.gui.scenes.thumbnails import Thumbnails
from wafer_viewer.gui.shell.header import CONFIRMATION_PICKS, HEADER_PICKS, NOT_CONFIRMED, confirmation, header
from wafer_viewer.gui.shell.header import FAILED as NOT_DRAWN
from wafer_viewer.gui.shell.left_panel import LeftPanel, MapState
from wafer_viewer.gui.shell.saved_views import SavedViews, Viewpoint
from wafer_viewer.gui.shell.shortcuts import (
    Palette,
    Parts,
    add_shortcut_dialog,
    add_titles,
    audit_command,
    commands_of,
    glossary_command,
)
from wafer_viewer.gui.shell.tour_guide import (
    NO_PLAN,
    TOUR_PICKS,
    Welcome,
    tour_commands,
    tour_guide,
    welcome,
    welcome_commands,
)
from wafer_viewer.gui.state.view_state import View, with_cursor
from wafer_viewer.gui.steps.acquire import acquire_step
from wafer_viewer.gui.steps.gauge.gauge_check import run_chart_dock, step_readout
from wafer_viewer.gui.steps.gauge.gauge_step import FAILED as CHECK_FAILED
from wafer_viewer.gui.steps.gauge.gauge_step import GAUGE_PICKS, CheckInputs, gauge_commands, gauge_step
from wafer_viewer.gui.steps.gauge.instrument import (
    INSTRUMENT_PICKS,
    NOT_RUN,
    calibration_dock,
    instrument_commands,
    instrument_step,
)
from wafer_viewer.gui.steps.live.focus_curve import CURVE_PICKS, FIRST_ENDS_UM, live_dock
from wafer_viewer.gui.steps.live.live_picture import LivePicture
from wafer_viewer.gui.steps.live.live_step import LIVE_PICKS, JogPad, live_commands, live_step
from wafer_viewer.gui.steps.measure import MeasureState, measure_step, use_tool
from wafer_viewer.gui.steps.plan import PICKS, plan_step
from wafer_viewer.gui.steps.plan_form import NOT_CHANGED, PlanState
from wafer_viewer.gui.steps.report import ReportChoices, report_commands, report_step
from wafer_viewer.gui.steps.results import choose_result
from wafer_viewer.gui.steps.review.defect_list import section_commands
from wafer_viewer.gui.steps.review.die_map import map_commands
from wafer_viewer.gui.steps.review.die_stack import stack_commands
from wafer_viewer.gui.steps.review.judging import NOT_JUDGED, Review, review_commands
from wafer_viewer.gui.steps.review.panes import section_dock
from wafer_viewer.gui.steps.review.review_step import REVIEW_PICKS, review_step
from wafer_viewer.gui.steps.review.sheet import SHEET_PICKS, SheetState, review_sheet
from wafer_viewer.gui.steps.surface.comparison import comparison_commands
from wafer_viewer.gui.steps.surface.focus_evidence import (
    EVIDENCE_PICKS,
    FRAME_PICKS,
    ChosenFrame,
    Explained,
    evidence_dock,
    evidence_step,
    explain_click,
)
from wafer_viewer.gui.steps.surface.heights import ShownStatistics
from wafer_viewer.gui.steps.surface.points import clip_box_callback, point_count
from wafer_viewer.gui.steps.surface.surface_step import FAILED, SURFACE_PICKS, SurfaceState, surface_step
from wafer_viewer.gui.tools.region_tools import in_scene, take_places
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.callbacks import guarded, tell_failure
from wafer_viewer.gui.widgets.controls import Command, add_html, always_mounted, looking, set_props
from wafer_viewer.gui.widgets.style import BRAND, RIGHT_PX, page_style
from wafer_viewer.model.measurement.tool_options import Levelling
from wafer_viewer.model.region import Region
from wafer_viewer.session.state.snapshot import RigStatus, Snapshot

if TYPE_CHECKING:
    from wafer_viewer.session.session import Session


# ------------------------------------------------------------------------------------------------------ lost connection


BEAT_S = 1.0
PROGRAM, SINCE = secrets.token_hex(8), time.strftime("%H:%M:%S")
"""Identity and start time of this process; a page that finds another one reports a restart."""
_STOP_OUT_OF_REACH, _RED_BUTTON = "Stop on this page does not reach the rig.", "Press the red button on the rig."


class Contact:
    """Heartbeat to the browser, with the texts to show if the connection is lost."""

    def __init__(self, page: Page) -> None:
        self._page = secrets.token_hex(8)
        self._beats = itertools.count()
        self._words = Markup()
        self._cell = add_html(page.gui, "")
        self._closed = threading.Event()
        self._lock = threading.Lock()
        page.on_pick("contact-look", lambda _: page.change(step=_step_to_look_at(page.session.snapshot), why=None))
        page.on_close(self._closed.set)
        threading.Thread(target=self._beat, name="contact", daemon=True).start()

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Bring the browser's texts up to date."""
        words = {
            "program": PROGRAM,
            "page": self._page,
            "since": SINCE,
            "state": state(snapshot),
            "box": out_of_reach(snapshot.rig),
            "back": disconnection_summary(snapshot),
            "anew": restart_summary(snapshot),
            "look": "Look, and confirm the sample" if not snapshot.draft.confirmed else "Look",
        }
        self._words = Markup(" ").join(Markup('data-{}="{}"').format(name, text) for name, text in words.items())
        self._tell()

    def _beat(self) -> None:
        while not self._closed.wait(BEAT_S):
            self._tell()

    def _tell(self) -> None:
        if self._words and not self._closed.is_set():
            with self._lock:
                look = Markup("<span {}></span>").format(html.pick("contact-look"))
                beat = Markup('<div hidden class="wv-contact" {} data-beat="{}">{}</div>')
                self._cell.content = str(beat.format(self._words, next(self._beats), look))


def state(snapshot: Snapshot) -> str:
    """Return the state of the rig in words, shown as the last known state when the connection is lost."""
    scan = snapshot.scan
    if snapshot.scanning and scan is not None:
        return f"{snapshot.rig.state}, field {scan.field.number}"
    return "at rest" if snapshot.rig.state == "ready" else snapshot.rig.state


def out_of_reach(rig: RigStatus) -> str:
    """Return the instruction for stopping the rig without this page."""
    return f"{_STOP_OUT_OF_REACH}\n{'It is simulated: nothing real moves.' if rig.simulated else _RED_BUTTON}"


def disconnection_summary(snapshot: Snapshot) -> str:
    """Return what happened while the page was disconnected, and whether action is needed."""
    scan, data = snapshot.scan, snapshot.dataset
    if snapshot.rig.state in ("fault", "absent"):
        return f"{snapshot.rig.message or 'The rig does not answer.'}"
    if snapshot.scanning and scan is not None:
        missing = f"{scan.frames_missing} missing, taken again later" if scan.frames_missing else "none missing"
        frames = f"frame {scan.frames_done} of {scan.frames_total}, {missing}"
        return f"The scan continued without this page: {frames}. Nothing to do."
    if scan is not None and scan.finished and data is not None:
        ended = "has ended" if data.finished else "is stopped"
        return f"The scan {ended}: {complete_fields_sentence(data)} Nothing to do."
    return "Nothing moves. Nothing to do." if snapshot.rig.state == "ready" else f"The rig is {snapshot.rig.state}."


def restart_summary(snapshot: Snapshot) -> str:
    """Return what was preserved over a restart of the program, and whether the sample must be confirmed."""
    data = snapshot.dataset
    what = (
        f"{data.path.stem}: {complete_fields_sentence(data)}" if data is not None else "Datasets and results are kept."
    )
    wait = "" if snapshot.draft.confirmed else " Nothing moves before the sample is confirmed."
    return f"{what}{wait}"


def _step_to_look_at(snapshot: Snapshot) -> str:
    """Return the step that asks to confirm the sample."""
    data = snapshot.dataset
    return "acquire" if data is not None and not data.finished else "plan"


# ----------------------------------------------------------------------------------------------------------- build page


class PageTheme:
    """Style sheet and viser's theme: light or dark, and the height of the bottom panel."""

    def __init__(self, page: Page) -> None:
        self._gui = page.gui
        self._dark: bool | None = None
        self._styles = add_html(page.gui, "")

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Bring the theme up to date."""
        set_props(self._styles, content=str(page_style(view.dark, bottom_panel_height_px(view))))
        if view.dark != self._dark:
            self._dark = view.dark
            self._gui.configure_theme(
                dark_mode=view.dark,
                show_logo=False,
                show_share_button=False,
                control_width="large",
                brand_color=BRAND[view.dark],
            )


class ScenePart:
    """3D scene as a part of the page."""

    def __init__(self, scene: SceneView, curves: LiveProfiles) -> None:
        self._scene, self._curves = scene, curves

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Draw the scene, on its own thread, with the cursors at their positions on the curve."""
        plot = replace(view.plot, cursors=self._curves.cursor_shares(view))
        self._scene.draw(snapshot, in_scene(replace(view, plot=plot), snapshot.surface))


class StepFallback:
    """Fallback to the step Plan if the present step has no content, after a reload or when a dataset is closed."""

    def __init__(self, page: Page) -> None:
        self._page = page

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Go to Plan if the step has no content; Review stays while a verdict is pending."""
        step = self._page.view.step
        waits = step == "review" and awaited(snapshot)
        if not (possible(step, snapshot) or waits):
            self._page.change(step="plan")


def build_page(client: viser.ClientHandle, session: Session) -> Page:
    """Create the page of a newly connected browser and start drawing it."""
    page = Page(client, session)
    page.gui.main_panel.dock_right()
    page.gui.main_panel.set_width(RIGHT_PX)
    with always_mounted(page.gui):
        page.add_picks()
    with always_mounted(page.gui):
        ear = BrowserEvents(page)
    with always_mounted(page.gui):
        theme = PageTheme(page)
        head, contact = StepPanel(page, header, None, NOT_DRAWN, HEADER_PICKS), Contact(page)
        tour = StepPanel(page, tour_guide, None, "The tour did not go on", TOUR_PICKS)
    review = Review(page)
    left = LeftPanel(page, review)  # docked before anything is drawn: the scene is drawn anew when it changes its size
    strip = StepPanel(page, control_strip, None, NOT_HANDED_OVER, CONTROL_PICKS)
    reopened = StepPanel(page, confirmation, None, NOT_CONFIRMED, CONFIRMATION_PICKS)
    poses = PoseCache(session.poses, lambda fault: tell_failure(page, "The overlaps are not shown", fault))
    poses.on_arrival(page.redraw)
    failed = partial(tell_failure, page, "The scene is not complete")
    scene = SceneView(client, session, failed, poses, page.viewport)
    ear.on_motion(scene.let_fly)
    review.on_fly(scene)
    curves = LiveProfiles(page)
    viewpoint, drawing = Viewpoint(page, scene), ScenePart(scene, curves)
    start = StepOverlay(page, welcome, Welcome(), failed=NO_PLAN)
    page.show_first([theme, head, start, viewpoint, drawing])
    statistics = ShownStatistics(page, scene.visible_um)
    plan = StepPanel(page, plan_step, PlanState(), NOT_CHANGED, PICKS)
    acquire = StepPanel(page, acquire_step, None, "The scan was not changed")
    live = StepPanel(page, live_step, JogPad(page), "The stage did not move", LIVE_PICKS)
    instrument = StepPanel(page, instrument_step, None, NOT_RUN, INSTRUMENT_PICKS)
    surface = StepPanel(page, surface_step, SurfaceState(poses, scene.range_in_view, statistics), FAILED, SURFACE_PICKS)
    measure = StepPanel(page, measure_step, MeasureState(curves, scene.first_levelling), "The setting was not changed")
    gauge = StepPanel(page, gauge_step, CheckInputs(), CHECK_FAILED, GAUGE_PICKS)
    report = StepPanel(page, report_step, ReportChoices(), "The report was not changed")
    profiles = StepDock(page, "profile", profile_dock, ProfilePlot(curves), "The curve is not shown", PROFILE_PICKS)
    curves.on_change(lambda: profiles.show(page.session.snapshot, page.view))
    sheet = StepOverlay(page, partial(sheet_over, review_sheet), SheetState(review, Thumbnails(page)), SHEET_PICKS)
    page.viewport.on_change(page.redraw)
    why = StepPanel(page, evidence_step, Explained(), "The explanation was not updated", EVIDENCE_PICKS)
    ear.left = left.panel
    clicked = StepOverlay(page, read_out, Clicked())
    parts: list[PagePart] = [
        *(
            StepFallback(page),
            theme,
            ear,
            head,
            statistics,
            plan,
            acquire,
            surface,
            curves,
            measure,
            gauge,
            instrument,
            StepPanel(page, review_step, review, NOT_JUDGED, REVIEW_PICKS),
            report,
            why,
            left,
            StepOverlay(page, toolbar),
            StepOverlay(page, point_count),
            StepOverlay(page, legend),
        ),
        *(
            StepOverlay(page, colour_legend),
            StepOverlay(page, origin_legend),
            StepOverlay(page, pose_legend, PoseLegend(poses, scene.um_per_pixel)),
            StepOverlay(page, scale_bar, scene.um_per_pixel),
            clicked,
            profiles,
            StepDock(page, "why", evidence_dock, ChosenFrame(), "The frame was not chosen", FRAME_PICKS),
            StepDock(page, "gauge", run_chart_dock, None, CHECK_FAILED),
            StepDock(page, "calibration", calibration_dock, None, NOT_RUN),
            sheet,
            StepDock(page, "defect", section_dock, None, "The section was not drawn"),
            StepDock(page, "live", live_dock, FIRST_ENDS_UM, "The curve is not shown", CURVE_PICKS),
            LivePicture(page),
            live,
            StepOverlay(page, step_readout),
        ),
        start,
        tour,
        reopened,
        strip,
        ControlNews(page),
        contact,
        viewpoint,
        drawing,
    ]
    _listen_to_page(page, scene, left)
    _listen_to_scene(page, scene, clicked.here, why.here)
    _listen_to_lines(page, scene, curves)
    of_steps = [*welcome_commands(start.here), *tour_commands(page), *report_commands(report.here)]
    of_steps += [*comparison_commands(left.compare.here), *live_commands(page), *gauge_commands(gauge.here)]
    of_steps += [*instrument_commands(page), *review_commands(review), *section_commands(left.defects.here)]
    of_steps += [*map_commands(review), *stack_commands(sheet.here, review)]
    verbs = [*of_steps, *commands_of(page, Parts(plan.here, measure.here, why.here, review))]
    parts.insert(1, _palette(page, scene, verbs))
    page.on_close(scene.close)
    page.begin(parts)
    return page


def _palette(page: Page, scene: SceneView, of_parts: list[Command]) -> Palette:
    """Create the command palette and the key sheet, and add titles to buttons."""
    views, picture = SavedViews(page, scene), PrintPicture(page, scene)
    commands = [
        *looking(scene.look_from),
        *views.commands(),
        *picture.commands(),
        *of_parts,
        glossary_command(page),
        audit_command(page),
    ]
    palette = Palette(page, [*commands, add_shortcut_dialog(page, commands)], views.going)
    add_titles(page, commands)
    return palette


def _listen_to_page(page: Page, scene: SceneView, left: LeftPanel) -> None:
    """Connect clicks in the left panel, on the overlays and in the header."""
    page.on_pick("finding", lambda key: choose_result(page, int(key), scene.fly_to))
    page.on_pick("stage-zero", lambda _: page.change(levelling=Levelling(), range_um=None))
    left.map.here.own = MapState(scene.visible_um, scene.fly_to)
    page.on_pick("dismiss", page.dismiss)
    page.on_pick("tool", lambda tool: use_tool(page, tool))
    page.on_pick("look", scene.look_from)
    page.on_pick("select", lambda _: page.change(selecting=not page.view.selecting))


def _listen_to_lines(page: Page, scene: SceneView, curves: LiveProfiles) -> None:
    def moved(lines: tuple[Region, ...], line: int) -> None:
        page.change(lines=lines, line=line, selected=None)
        curves.follow()

    def cursor_moved(number: int, share: float) -> None:
        page.change(plot=with_cursor(page.view.plot, number, share))

    scene.on_lines(guarded(page, "The surface was not read")(moved))
    scene.on_cursor(guarded(page, "The cursor was not moved")(cursor_moved))


def _listen_to_scene(page: Page, scene: SceneView, clicked: Here[Clicked], why: Here[Explained]) -> None:
    """Connect handles, clicks and the camera."""
    failed = "The surface was not read"
    scene.on_places(guarded(page, failed)(take_places(page)))
    scene.on_levelling(guarded(page, failed)(lambda levelling: page.change(levelling=levelling, range_um=None)))

    def picked(x_um: float, y_um: float) -> None:
        explain_click(why, x_um, y_um)
        click_surface(clicked, x_um, y_um)

    scene.on_pick(picked)
    scene.on_select(guarded(page, failed)(lambda box: page.change(selection=box, counted="selection", selecting=False)))
    scene.on_clip(clip_box_callback(page))
    scene.on_camera(page.redraw)
    scene.on_scale(page.show_scale)
    scene.on_points(page.show_points)
