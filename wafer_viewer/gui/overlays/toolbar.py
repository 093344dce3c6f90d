"""Toolbar over the scene, and the picture of the scene at print size."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import viser
from markupsafe import Markup
from numpy.typing import NDArray

from wafer_viewer.draw.number_format import number
from wafer_viewer.draw.surface.display_style import QUANTITIES
from wafer_viewer.gui.elements.step import Here, Overlay
from wafer_viewer.gui.overlays.hud import EDGE_PX, SIGNED
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.page.preconditions import surface_not_shown
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.tools.tool_palette import GAP, tool_strip
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.callbacks import LatestOnlyWorker, guarded
from wafer_viewer.gui.widgets.controls import Command, with_precondition
from wafer_viewer.gui.widgets.style import RGB_OF_TONE
from wafer_viewer.model.errors import WaferViewerError
from wafer_viewer.session.state.snapshot import Snapshot

if TYPE_CHECKING:
    from wafer_viewer.draw.print_figures import Caption, ColourKey
    from wafer_viewer.gui.scenes.scene_view import SceneView


# ----------------------------------------------------------------------------------------------------------- screenshot


PRINT_WIDTH_PX = 3000
"""25 cm at 300 dots per inch."""
SETTLE_S, RENDER_S = 40.0, 60.0


class PrintPicture:
    """Command that takes a picture at print size, on a thread of its own."""

    def __init__(self, page: Page, scene: SceneView) -> None:
        self._page, self._scene = page, scene
        self._work = LatestOnlyWorker("print picture")
        self._busy = False
        page.on_close(self._work.close)
        page.on_pick("picture", lambda _: self.take())

    def commands(self) -> list[Command]:
        """Return the command and its key."""
        return with_precondition(
            surface_not_shown, Command("Picture at print size", "P", self.take, viser.Icon.CAMERA, group="Look")
        )

    def take(self) -> None:
        """Take the picture, unless one is in progress."""
        if self._page.session.snapshot.dataset is None or not self._page.view.on_surface or self._busy:
            return
        self._busy = True
        self._work.ask(guarded(self._page, "The picture was not taken")(self._take))

    def _take(self) -> None:
        notification = self._page.client.add_notification(
            "Picture", "Refining the surface …", loading=True, with_close_button=False, color=RGB_OF_TONE["busy"]
        )
        try:
            complete = self._scene.settle(PRINT_WIDTH_PX, SETTLE_S)
            notification.body = f"The browser draws {PRINT_WIDTH_PX} px …"
            rendered, um_per_pixel = self._rendered()
        finally:
            self._scene.settle(None, 0.0)
            self._busy = False
            notification.remove()
        self._keep(rendered, um_per_pixel, complete)

    def _rendered(self) -> tuple[NDArray[np.uint8], float]:
        """Return the scene as rendered by the browser, and its µm per pixel at the look-at point."""
        client = self._page.client
        viewport = self._page.viewport
        height_px = round(PRINT_WIDTH_PX * viewport.height_px / max(1, viewport.width_px))
        um_per_pixel = self._scene.um_per_pixel() * viewport.height_px / height_px
        try:
            return client.get_render(height_px, PRINT_WIDTH_PX, transport_format="png", timeout=RENDER_S), um_per_pixel
        except TimeoutError as fault:
            raise WaferViewerError(
                f"The browser did not answer within {RENDER_S:g} s: bring its window to the front and press P again."
            ) from fault
        except RuntimeError as fault:
            raise WaferViewerError(
                f"The browser could not draw {PRINT_WIDTH_PX} x {height_px} px: close its other windows, press P again."
            ) from fault

    def _keep(self, rendered: NDArray[np.uint8], um_per_pixel: float, complete: bool) -> None:
        from wafer_viewer.draw.print_figures import DARK, LIGHT, png, print_picture

        page, snapshot, view = self._page, self._page.session.snapshot, self._page.view
        paper = DARK if view.dark else LIGHT
        picture = print_picture(rendered, um_per_pixel, caption_of(snapshot, view), self._key(view), paper)
        data = png(picture)

        def saved(path: Any) -> None:
            coarse = "" if complete else " Parts were still being drawn finer: press P again for a sharper one."
            page.say("Picture saved", f"{path}{coarse}")
            page.client.send_file_download(path.name, data)
            page.redraw()

        page.ask("The picture was not saved", page.session.papers.keep_picture(data), saved)

    def _key(self, view: View) -> ColourKey | None:
        from wafer_viewer.draw.print_figures import ColourKey

        scale, by = self._page.scale, self._page.coloured_by(view)
        if scale is None or by == "origin":
            return None
        colours = "grey" if by == "grey" else view.colours
        return ColourKey(*QUANTITIES[by], scale.low, scale.high, colours, by in SIGNED)


def caption_of(snapshot: Snapshot, view: View) -> Caption:
    """Return the caption of the picture."""
    from wafer_viewer.draw.print_figures import Caption

    data = snapshot.dataset
    drawn = "seen from above" if view.look == "plan" else f"z drawn × {number(view.exaggeration, 1).removesuffix('.0')}"
    shown = f"field {view.show}" if view.show > 0 else "stitched surface"
    raw = () if data is None or data.calibration_problem is None else ("uncalibrated",)
    words = (shown, drawn, *raw, time.strftime("%Y-%m-%d"))
    return Caption(data.path.stem if data else "", words, snapshot.simulated)


# -------------------------------------------------------------------------------------------------------------- toolbar


WAYS_TO_LOOK = (
    ("top", "Top", "Look from above · T", viser.Icon.SQUARE),
    ("front", "Front", "Look from the front · F", viser.Icon.PERSPECTIVE),
    ("iso", "Iso", "Three-quarter view · I", viser.Icon.CUBE),
    ("all", "Fit", "Show all · Home", viser.Icon.FOCUS_2),
)
_WIDTH_PX, _HEIGHT_PX = 520, 42
NARROW_SCENE_PX = 640
"""Scene width below which the toolbar shows icons only, to clear the legend."""
NAMED_SCENE_PX = 1080
"""Scene width from which the tools show their names."""
_SIDE_TOOLS_PX = 124 + 2 * EDGE_PX + 8
"""Width reserved for the colour bar: in a narrow scene the tools take two rows."""


def toolbar(here: Here[None]) -> Overlay | None:
    """Return the toolbar of camera views and tools; views have labels unless the tools need the space."""
    view = here.view
    if view.sheet_over != "none" or view.at_bench:  # what lies over the scene would lie over the tools
        return None
    measuring = view.step == "measure"
    scene_px = here.page.viewport.width_px
    short = measuring or 0 < scene_px < NARROW_SCENE_PX
    looks = Markup("").join(_preset(*preset, short=short) for preset in WAYS_TO_LOOK)
    parts = tool_strip(view.tool, scene_px >= NAMED_SCENE_PX) + GAP + looks if measuring else looks
    if view.step == "surface":
        parts += GAP + _select(view.selecting)
    if view.step == "plan":
        parts = sample_or_live(live=False) + GAP + parts
    if view.reviews_defect:
        ways = (("beside", "Pictures", viser.Icon.LAYOUT_COLUMNS, False), ("none", "3D", viser.Icon.CUBE, True))
        parts = _ways("sheet", ways, " · Z") + GAP + parts
    if view.step == "gauge":
        parts = blocks_or_instrument(view.instrument) + GAP + parts
    two_rows = measuring and 0 < scene_px < NARROW_SCENE_PX
    room = (
        Markup(' style="flex-wrap:wrap;max-width:{}px"').format(scene_px - _SIDE_TOOLS_PX - EDGE_PX)
        if two_rows
        else Markup()
    )
    content = Markup('<div class="wv-glass wv-tools{}"{}>{}</div>').format(" many" if measuring else "", room, parts)
    width_px, height_px = max(_WIDTH_PX, scene_px - _SIDE_TOOLS_PX), 2 * _HEIGHT_PX if two_rows else _HEIGHT_PX
    return Overlay.of(content, EDGE_PX, EDGE_PX, width_px, height_px)


def _preset(key: str, name: str, hint: str, sign: Any, short: bool) -> Markup:
    words = "" if short else name
    label = Markup('title="{}" aria-label="{}"').format(hint, name)
    return Markup("<span {label} {pick}>{icon}{words}</span>").format(
        label=label, pick=html.pick("look", key), icon=html.icon(sign, 17), words=words
    )


def sample_or_live(live: bool) -> Markup:
    """Return the choice between the sample and the live view in Plan."""
    ways = (("sample", "Sample", viser.Icon.MAP_2, not live), ("live", "Live", viser.Icon.VIDEO, live))
    return _ways("plan-look", ways, " · C")


def blocks_or_instrument(instrument: bool) -> Markup:
    """Return the choice between the gauge blocks and the calibrations of the instrument in Gauge check."""
    ways = (
        ("blocks", "Blocks", viser.Icon.CERTIFICATE, not instrument),
        ("instrument", "Instrument", viser.Icon.MICROSCOPE, instrument),
    )
    return _ways("gauge-look", ways)


def _ways(what: str, ways: Sequence[tuple[str, str, Any, bool]], key_hint: str = "") -> Markup:
    """Return a choice between looks of a step: key, name, icon, and whether it is the present one."""
    return Markup("").join(
        Markup('<span{on} title="{name}{hint}" aria-pressed="{pressed}" {pick}>{icon}{name}</span>').format(
            on=Markup(' class="on"') if on else "",
            name=name,
            hint=key_hint,
            pressed=str(on).lower(),
            pick=html.pick(what, key),
            icon=html.icon(sign, 17),
        )
        for key, name, sign, on in ways
    )


def _select(selecting: bool) -> Markup:
    """Return the Select toggle: if on, a drag over the scene selects; with Shift it always does."""
    label = Markup('title="Select an area · or drag with Shift" aria-label="Select" aria-pressed="{}"').format(
        str(selecting).lower()
    )
    on = Markup(' class="on"') if selecting else Markup()
    return Markup("<span{on} {label} {pick}>{icon}Select</span>").format(
        on=on, label=label, pick=html.pick("select"), icon=html.icon(viser.Icon.MARQUEE_2, 17)
    )
