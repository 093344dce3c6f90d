"""Picture of the camera over the scene, and below it the focus score over z."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
import viser
from markupsafe import Markup
from numpy.typing import NDArray

from wafer_viewer.draw.charts.axes import ChartAxes, PlotLook, line_svg, plot_html, round_ticks
from wafer_viewer.draw.number_format import duration, length_text, number, round_length, with_unit
from wafer_viewer.draw.surface.display_style import eight_bit
from wafer_viewer.gui.overlays.hud import EDGE_PX
from wafer_viewer.gui.overlays.toolbar import sample_or_live
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.page.panels import BottomPanel, bottom_panel_height_px
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.callbacks import LatestOnlyWorker, guarded
from wafer_viewer.gui.widgets.controls import HtmlBlock, set_prop
from wafer_viewer.model.acquisition.focus_stack import Image
from wafer_viewer.model.acquisition.rig_limits import RigLimits
from wafer_viewer.session.acquisition.live_controller import LiveLook
from wafer_viewer.session.state.instrument_state import FocusTrace, LiveState
from wafer_viewer.session.state.snapshot import Snapshot

# ----------------------------------------------------------------------------------------------------------- live curve


LEAST_SPAN_UM = 60.0
"""Least extent of the z axis."""
EDGE_SHARE = 0.08
ROUND_UM = 10.0
"""The ends of the axis are multiples, so that it does not creep with every frame."""
GAP_UM = 12.0
"""Distance of two scored positions beyond which the curve is interrupted: nothing was seen between them."""
_Y_TICKS = ((0.0, "0"), (0.5, "50"), (1.0, "100"))


class LiveDock:
    """Curve of the scores at this place, with grips for the lowest and the highest z to scan."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._panel = BottomPanel(page, "live")
        with self._panel.tab:
            self._plot = HtmlBlock(page.gui)
            self._grips = HtmlBlock(page.gui)
        self._ends_um = (-LEAST_SPAN_UM / 2, LEAST_SPAN_UM / 2)
        page.on_pick("live-range", self._set_end)

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Update the curve."""
        if not self._panel.show(view):
            return
        look = self._page.session.live.look()
        ends_um = axis_ends_um(look, snapshot.live, snapshot.rig.z_um)
        low_um, high_um = self._ends_um
        roomy = high_um - low_um > 3 * (ends_um[1] - ends_um[0])
        if ends_um[0] < low_um or ends_um[1] > high_um or roomy:
            self._ends_um = ends_um
        head, plot = _head(snapshot), curve_html(look, snapshot, self._ends_um)
        self._plot.show(Markup('<div class="wv-below">{}{}</div>').format(head, plot))
        self._grips.show(grips_html(snapshot.live, self._ends_um))

    def _set_end(self, key: str) -> None:
        end, z_um = key.split(":")
        name = "lowest" if end == "lowest" else "highest"
        self._page.ask("The range was not changed", self._page.session.live.mark_end(name, round(float(z_um), 1)))


def axis_ends_um(look: LiveLook, live: LiveState, z_um: float) -> tuple[float, float]:
    """Return round ends of the z axis that hold the scores, the range and the present z."""
    marked = [um for um in (live.lowest_um, live.highest_um) if um is not None]
    seen = [z_um, *(z for z, _ in look.trace.points), *marked]
    low, high = min(seen), max(seen)
    half = max((high - low) * (0.5 + EDGE_SHARE), LEAST_SPAN_UM / 2)
    middle = (low + high) / 2
    return ROUND_UM * ((middle - half) // ROUND_UM), -ROUND_UM * ((-middle - half) // ROUND_UM)


def _head(snapshot: Snapshot) -> Markup:
    live, job = snapshot.live, snapshot.draft.job
    words = Markup('<span class="wv-end">Drag the grips, or press Lowest and Highest is here</span>')
    if live.range_um is not None:
        low, high = live.range_um
        step_um = job.sweep.z_step_um if job is not None else None
        frames = f" · {round((high - low) / step_um) + 1} frames at {with_unit(step_um, 2)}" if step_um else ""
        words = Markup('<span class="wv-end">Range <b>{} … {}</b>{}</span>').format(
            number(low, 1, signed=True), with_unit(high, 1, signed=True), frames
        )
    return Markup('<div class="wv-dock"><b>Focus along z</b>{}</div>').format(words)


def curve_html(look: LiveLook, snapshot: Snapshot, ends_um: tuple[float, float]) -> Markup:
    """Return the plot: the curve, the range, the present z and the best one."""
    axes = ChartAxes.stretched(ends_um, (0.0, 1.12), round_ticks(ends_um, 9, signed=True), _Y_TICKS)
    points, best = look.trace.points, look.trace.best
    here_um = snapshot.rig.z_um
    drawn, words = _range_area(axes, snapshot.live), [_label(axes, here_um, "ink", "here", 0)]
    if best is not None and best[1] > 0:
        drawn += _curve(axes, points, best[1])
        best_um = look.trace.best_um
        if best_um is not None:
            drawn += line_svg(axes.upright(axes.x.within(best_um)), "good", 1.6, Markup('stroke-dasharray="5 4"'))
            text = f"best {number(best_um, 1, signed=True)}"
            words.append(_label(axes, best_um, "good", text, 1))
    drawn += line_svg(axes.upright(axes.x.within(here_um)), "ink", 1.8)
    if len(points) < 2:
        words.append(
            Markup('<b class="wv-live-unseen">Move in z, or go to focus: the curve grows with what is seen</b>')
        )
    else:
        words += _unseen(axes, points)
    look_of_plot = PlotLook("Focus score over z", "Focus, % of the best", "z, µm", classes="wv-profiles", top_px=8)
    return plot_html(axes, look_of_plot, drawn, Markup("").join(words))


def _curve(axes: ChartAxes, points: tuple[tuple[float, float], ...], best: float) -> Markup:
    path, before = "", None
    for z, score in points:
        pen = "L" if before is not None and z - before <= GAP_UM else "M"
        path += f"{pen}{axes.x.at(axes.x.within(z)):.1f} {axes.y.at(min(score / best, 1.0)):.1f}"
        before = z
    dots = "".join(f"M{axes.x.at(axes.x.within(z)):.1f} {axes.y.at(min(s / best, 1.0)):.1f}h.01" for z, s in points)
    return line_svg(path, "accent", 2) + line_svg(dots, "accent", 4, Markup('stroke-linecap="round"'))


def _range_area(axes: ChartAxes, live: LiveState) -> Markup:
    if live.range_um is None:
        return Markup()
    low, high = (axes.x.at(axes.x.within(um)) for um in live.range_um)
    return Markup('<rect class="wv-live-range" x="{:.1f}" y="0" width="{:.1f}" height="1000"/>').format(
        min(low, high), abs(high - low)
    )


def _unseen(axes: ChartAxes, points: tuple[tuple[float, float], ...]) -> list[Markup]:
    """Return pale areas over what was not seen at either end."""
    low, high = axes.x.percent(points[0][0]), axes.x.percent(points[-1][0])
    areas = []
    for side, percent in (("left", low), ("right", 100 - high)):
        if percent > 3:
            words = "not seen yet" if percent > 14 else ""
            areas.append(
                Markup('<b class="wv-live-pale" style="{}:0;width:{:.2f}%">{}</b>').format(side, percent, words)
            )
    return areas


def _label(axes: ChartAxes, z_um: float, colour: str, text: str, row: int) -> Markup:
    """Return a label beside its line; `row`: 0 at the top, 1 below it."""
    percent = axes.x.percent(axes.x.within(z_um))
    side = f"right:calc({100 - percent:.2f}% + 6px)" if percent > 80 else f"left:calc({percent:.2f}% + 6px)"
    return Markup('<b style="{};top:{}px;color:var(--{})">{}</b>').format(side, 16 * row - 2, colour, text)


def grips_html(live: LiveState, ends_um: tuple[float, float]) -> Markup:
    """Return a slider for each end of the range; without a mark its grip waits at the end of the axis."""
    marked = {"lowest": live.lowest_um, "highest": live.highest_um}
    waiting = {"lowest": ends_um[0], "highest": ends_um[1]}
    sliders = Markup("").join(
        Markup(
            '<input type="range" class="wv-slide wv-grip {state}" name="{end}" aria-label="{title}, µm" min="{low!r}" '
            'max="{high!r}" step="0.1" value="{z!r}" data-slide="live-range" data-needs-control>'
        ).format(
            state="" if um is not None else "waits",
            end=end,
            title=f"{end.capitalize()} z to scan",
            low=ends_um[0],
            high=ends_um[1],
            z=waiting[end] if um is None else um,
        )
        for end, um in marked.items()
    )
    return Markup('<div class="wv-slides wv-grips">{}</div>').format(sliders)


# --------------------------------------------------------------------------------------------------------- live picture


FIRST_PX = 892, 640
"""Size of the scene until the browser reports it."""
LEAST_PX = 240
MOST_ACROSS_PX = 960
"""Largest number of columns that are sent; the browser scales them to the picture."""
WORDS_EVERY_S = 0.2
JPEG_QUALITY = 82
BAR_PX = 150
BORDER_PX = 18
"""Extra height of a floating panel, without which viser clips its content at the bottom."""
SATURATED = (214, 39, 40)
FAILED = "The live picture is not shown"
NOT_DRIVEN = "The stage did not move"


@dataclass(frozen=True, slots=True)
class PictureSize:
    """Place and size of the picture in the scene, CSS pixels."""

    x_px: int
    y_px: int
    width_px: int
    height_px: int

    @classmethod
    def within(cls, scene_px: tuple[int, int], aspect: float) -> PictureSize:
        """Return the largest picture of an aspect ratio within the scene, centred."""
        room = max(LEAST_PX, scene_px[0] - 2 * EDGE_PX), max(LEAST_PX, scene_px[1] - 2 * EDGE_PX)
        width = int(min(room[0], room[1] * aspect))
        height = round(width / aspect)
        return cls((scene_px[0] - width) // 2, max(EDGE_PX, (scene_px[1] - height) // 2), width, height)


def display_picture(image: Image) -> NDArray[np.uint8]:
    """Return a frame as uint8 [row, col, 3] for display, with the pixels at the limit in red."""
    every = max(1, -(-image.shape[1] // MOST_ACROSS_PX))
    small = image[::every, ::every]
    coloured = np.repeat(eight_bit(small)[..., None], 3, axis=2)
    coloured[small == np.iinfo(image.dtype).max] = SATURATED
    return coloured


class LivePicture:
    """Live picture; frames go to the browser on a thread of their own, as fast as they come."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._panel = page.gui.add_panel(visible=False)
        with self._panel.add_tab("·"):
            self._target = HtmlBlock(page.gui, padded=False)
            self._words = HtmlBlock(page.gui, padded=False)
            blank = np.zeros((3, 4, 3), np.uint8)
            self._image = page.gui.add_image(blank, format="jpeg", jpeg_quality=JPEG_QUALITY, visible=False)
        self._size: PictureSize | None = None
        self._scene_px = FIRST_PX
        self._at_bench = False
        self._worded_s = 0.0
        self._worker = LatestOnlyWorker("live picture")
        page.on_close(self._worker.close)
        page.on_close(page.session.live.on_frame(self._frame_arrived))
        page.viewport.on_change(lambda: self._follow(page.viewport.width_px, page.viewport.height_px))
        page.on_pick("live-at", self._drive_to)
        page.on_pick("plan-look", lambda key: page.change(live=key == "live"))

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Update the words over the picture; the picture follows the frames."""
        if view.at_bench and not self._at_bench:
            self._enter(view)
        self._at_bench = view.at_bench
        if not view.at_bench:
            set_prop(self._panel, "visible", False)
            self._target.show("")
            self._words.show("")
            return
        limits = snapshot.rig.limits
        aspect = limits.camera.cols / limits.camera.rows if limits is not None else 4 / 3
        size = PictureSize.within(self._scene_px, aspect)
        if size != self._size:
            self._size = size
            self._panel.float(x=size.x_px, y=size.y_px, width=size.width_px, height=size.height_px + BORDER_PX)
        look = self._page.session.live.look()
        self._target.show(_target(size))
        self._words.show(words_over(snapshot, look, size, time.time()))
        set_prop(self._image, "visible", look.frame is not None)
        set_prop(self._panel, "visible", True)

    def _enter(self, view: View) -> None:
        """Show the last frame, in the scene as it will be above the panel below, before the browser reports it."""
        width_px, height_px = self._scene_px
        self._scene_px = width_px, height_px - bottom_panel_height_px(view)
        self._worker.ask(guarded(self._page, FAILED)(self._send))

    def _follow(self, width_px: int, height_px: int) -> None:
        if (width_px, height_px) != self._scene_px and width_px > 0 and height_px > 0:
            self._scene_px = width_px, height_px
            self._page.redraw()

    def _frame_arrived(self) -> None:
        if self._at_bench:
            self._worker.ask(guarded(self._page, FAILED)(self._send))

    def _send(self) -> None:
        """Send the latest frame, and a few times a second the words over it."""
        frame = self._page.session.live.look().frame
        if frame is None:
            return
        self._image.image = display_picture(frame.image)
        if time.monotonic() - self._worded_s > WORDS_EVERY_S:
            self._worded_s = time.monotonic()
            self._page.redraw()

    def _drive_to(self, key: str) -> None:
        """Drive to a clicked place of the picture."""
        session = self._page.session
        frame, limits = session.live.look().frame, session.snapshot.rig.limits
        if frame is None or limits is None:
            return
        across, down = (float(share) for share in key.split(","))
        x_um, y_um = offset_um(limits, across, down)
        goal = session.live.drive(x_um=frame.position.x_um + x_um, y_um=frame.position.y_um + y_um)
        self._page.ask(NOT_DRIVEN, goal)


def offset_um(limits: RigLimits, across: float, down: float) -> tuple[float, float]:
    """Return the distance of a place in the picture, given as fractions from its upper left corner, from its middle."""
    return (across - 0.5) * limits.field_width_um, (0.5 - down) * limits.field_height_um


def _target(size: PictureSize) -> Markup:
    """Return the area that takes clicks; it stays the same while the words change."""
    return Markup(
        '<div class="wv-ov wv-live-root"><div class="wv-live" style="width:{w}px;height:{h}px" data-pick="live-at" '
        'data-where="picture" data-needs-control role="img" aria-label="Picture of the camera: click to drive there">'
        '<div class="wv-live-still wv-glass" role="status"></div></div></div>'
    ).format(w=size.width_px, h=size.height_px)


def words_over(snapshot: Snapshot, look: LiveLook, size: PictureSize, now_s: float) -> Markup:
    """Return what lies over the picture and takes no clicks: cross, choice of the look, rate, focus and scale bar."""
    parts = [_cross(), _top(snapshot, look, now_s), _focus_bar(look)]
    limits = snapshot.rig.limits
    if limits is not None:
        parts += [_scale(limits, size, snapshot), _goal(snapshot, look, limits, size)]
    if look.frame is None:
        parts.append(_waits(snapshot))
    return Markup('<div class="wv-live-words" style="width:{}px;height:{}px">{}</div>').format(
        size.width_px, size.height_px, Markup("").join(parts)
    )


def _cross() -> Markup:
    return Markup('<i class="wv-live-cross"></i>')


def _top(snapshot: Snapshot, look: LiveLook, now_s: float) -> Markup:
    frame = look.frame
    rate = Markup()
    if frame is not None:
        age_ms = max(0.0, 1000 * (now_s - frame.taken_s))
        running = age_ms < 1000 and snapshot.rig.state in ("ready", "moving")
        rate = Markup('<span class="wv-glass wv-live-rate{}"><i></i>{}</span>').format(
            "" if running else " off",
            Markup("<b>{}</b> frames/s · {} ms old").format(number(look.rate_hz, 1), number(age_ms, 0))
            if running
            else "at rest",
        )
    return Markup('<div class="wv-live-top"><div class="wv-glass wv-tools">{}{}</div>{}</div>').format(
        sample_or_live(live=True), _keep_button() if frame is not None else "", rate
    )


def _keep_button() -> Markup:
    """Return the button that keeps the picture as a file."""
    return Markup(
        '<span title="Keep this picture as a file · TIFF with place and pixel size" {pick}>{icon}Picture</span>'
    ).format(pick=html.pick("live-keep"), icon=html.icon(viser.Icon.PHOTO_DOWN, 17))


def _focus_bar(look: LiveLook) -> Markup:
    """Return the score as a share of the best since the last change of place, and where the best was."""
    frame, best = look.frame, look.trace.best
    if frame is None or best is None or best[1] <= 0:
        return Markup()
    percent = 100 * min(1.0, frame.score / best[1])
    ticks = Markup("").join(Markup('<u style="bottom:{}%">{}</u>').format(share, share) for share in (0, 25, 50, 75))
    return Markup(
        '<div class="wv-glass wv-live-focus" role="img" aria-label="Focus {now} % of the best">'
        '<div class="head"><b>Focus</b><span>%</span></div>'
        '<div class="bar"><s></s><i style="height:{percent:.1f}%"></i>'
        '<em style="bottom:clamp(0px,calc({percent:.1f}% - 9px),calc(100% - 26px))">{now}</em>{ticks}</div>'
        '<div class="foot">{away}</div></div>'
    ).format(percent=percent, now=f"{percent:.0f}", ticks=ticks, away=best_words(look.trace, frame.position.z_um))


def best_words(trace: FocusTrace, z_um: float) -> Markup:
    """Return how far the best lies, and in which direction."""
    best_um = trace.best_um
    if best_um is None:
        return Markup()
    away_um = best_um - z_um
    if abs(away_um) < 0.15:
        return Markup("<b>at the best</b>")
    return Markup("best is<br><b>{} {}</b>").format(with_unit(abs(away_um), 1), "up" if away_um > 0 else "down")


def _scale(limits: RigLimits, size: PictureSize, snapshot: Snapshot) -> Markup:
    um_per_pixel = limits.field_width_um / size.width_px
    length_um = round_length(BAR_PX * um_per_pixel)
    setup = snapshot.rig.setup
    return Markup(
        '<div class="wv-glass wv-scale wv-live-scale"><div style="width:{:.0f}px"><b>{}</b><i></i></div>'
        "<span>{} × {} in view{}</span></div>"
    ).format(
        length_um / um_per_pixel,
        length_text(length_um),
        number(limits.field_width_um, 0),
        with_unit(limits.field_height_um, 0),
        f" · {number(limits.objective.magnification, 0)} ×" if setup is not None else "",
    )


def _goal(snapshot: Snapshot, look: LiveLook, limits: RigLimits, size: PictureSize) -> Markup:
    """Return arrow and ghost of a drive to a place in the picture, with its time and distances."""
    goal, frame = snapshot.live.goal_um, look.frame
    if goal is None or frame is None:
        return Markup()
    x_um, y_um = goal[0] - frame.position.x_um, goal[1] - frame.position.y_um
    across, down = 0.5 + x_um / limits.field_width_um, 0.5 - y_um / limits.field_height_um
    words = Markup("<b>Driving there · {}</b><br>Δx {} Δy {}").format(
        duration(snapshot.live.goal_s), number(x_um, 1, signed=True), with_unit(y_um, 1, signed=True)
    )
    if not (0 < across < 1 and 0 < down < 1):
        return Markup('<div class="wv-live-goal far">{}</div>').format(words)
    x_px, y_px = across * size.width_px, down * size.height_px
    return Markup(
        '<svg class="wv-live-arrow" viewBox="0 0 {w} {h}" aria-hidden="true"><line x1="{cx}" y1="{cy}" x2="{x:.0f}" '
        'y2="{y:.0f}"/><circle cx="{x:.0f}" cy="{y:.0f}" r="11"/><circle cx="{x:.0f}" cy="{y:.0f}" r="2"/></svg>'
        '<div class="wv-live-goal" style="left:{x:.0f}px;top:{y:.0f}px">{words}</div>'
    ).format(
        w=size.width_px, h=size.height_px, cx=size.width_px / 2, cy=size.height_px / 2, x=x_px, y=y_px, words=words
    )


def _waits(snapshot: Snapshot) -> Markup:
    """Return why there is no picture yet."""
    rig = snapshot.rig
    if snapshot.live.problem:
        return Markup('<div class="wv-live-empty">{}</div>').format(
            html.note("fault", "The live view ended", snapshot.live.problem, Markup("Set the exposure again to go on."))
        )
    words = "The first picture is on its way." if rig.state in ("ready", "moving") else rig.message or f"{rig.state}."
    return Markup('<div class="wv-live-empty">{}</div>').format(html.empty(words))
