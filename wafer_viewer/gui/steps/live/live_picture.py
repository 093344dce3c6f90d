"""Picture of the camera over the scene."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
import viser
from markupsafe import Markup
from numpy.typing import NDArray

from wafer_viewer.draw.number_format import duration, length_text, number, round_length, with_unit
from wafer_viewer.draw.surface.display_style import eight_bit
from wafer_viewer.gui.elements.elements import Elements, Html, Picture
from wafer_viewer.gui.elements.mount import Mount
from wafer_viewer.gui.elements.step import CLIPPED_PX
from wafer_viewer.gui.overlays.hud import EDGE_PX, FIRST_PX
from wafer_viewer.gui.overlays.toolbar import sample_or_live
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.page.panels import bottom_panel_height_px
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.callbacks import LatestOnlyWorker, guarded
from wafer_viewer.gui.widgets.controls import set_props
from wafer_viewer.model.acquisition.focus_stack import Image
from wafer_viewer.model.acquisition.rig_limits import RigLimits
from wafer_viewer.session.acquisition.live_controller import LiveLook
from wafer_viewer.session.state.instrument_state import FocusTrace
from wafer_viewer.session.state.snapshot import Snapshot

LEAST_PX = 240
MOST_ACROSS_PX = 960
"""Largest number of columns that are sent; the browser scales them to the picture."""
WORDS_EVERY_S = 0.2
JPEG_QUALITY = 82
BAR_PX = 150
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
            self._mount = Mount(page.gui, page, FAILED)
        self._over: Elements = ()
        """All but the picture."""
        self._size: PictureSize | None = None
        self._scene_px = FIRST_PX
        self._at_bench = False
        self._drawn_s = 0.0
        self._worker = LatestOnlyWorker("live picture")
        page.on_close(self._worker.close)
        page.on_close(page.session.live.on_frame(self._frame_arrived))
        page.viewport.on_change(lambda: self._follow(page.viewport.width_px, page.viewport.height_px))
        page.on_pick("live-at", self._drive_to)

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Update the words over the picture; the picture follows the frames."""
        if view.at_bench and not self._at_bench:  # in the scene as it will be above the panel below
            self._scene_px = self._scene_px[0], self._scene_px[1] - bottom_panel_height_px(view)
        self._at_bench = view.at_bench
        if view.at_bench:
            limits = snapshot.rig.limits
            aspect = limits.camera.cols / limits.camera.rows if limits is not None else 4 / 3
            size = PictureSize.within(self._scene_px, aspect)
            if size != self._size:
                self._size = size
                self._panel.float(x=size.x_px, y=size.y_px, width=size.width_px, height=size.height_px + CLIPPED_PX)
            words = words_over(snapshot, self._page.session.live.look(), size, time.time())
            self._over = Html(_target(size), padded=False), Html(words, padded=False)
        self._draw()
        set_props(self._panel, visible=view.at_bench)

    def _draw(self) -> None:
        frame = self._page.session.live.look().frame
        picture = Picture(frame.image, display_picture, jpeg_quality=JPEG_QUALITY) if frame is not None else None
        self._mount.show([*self._over, picture] if self._at_bench else ())

    def _follow(self, width_px: int, height_px: int) -> None:
        if (width_px, height_px) != self._scene_px and width_px > 0 and height_px > 0:
            self._scene_px = width_px, height_px
            self._page.redraw()

    def _frame_arrived(self) -> None:
        if self._at_bench:
            self._worker.ask(guarded(self._page, FAILED)(self._send))

    def _send(self) -> None:
        """Send the latest frame, and a few times a second what is known of it."""
        self._draw()
        if time.monotonic() - self._drawn_s > WORDS_EVERY_S:
            self._drawn_s = time.monotonic()
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
    words = Markup("<b>Moving there · {}</b><br>Δx {} Δy {}").format(
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
