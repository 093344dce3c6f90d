"""Picture of the scene at print size, rendered by the browser, captioned, saved with the dataset, and downloaded."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import numpy as np
import viser
from numpy.typing import NDArray

from wafer_viewer.draw.number_format import number
from wafer_viewer.draw.surface.display_style import QUANTITIES
from wafer_viewer.gui.overlays.hud import SIGNED
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.page.preconditions import surface_not_shown
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.widgets.callbacks import LatestOnlyWorker, guarded
from wafer_viewer.gui.widgets.controls import Command, with_precondition
from wafer_viewer.gui.widgets.style import RGB_OF_TONE
from wafer_viewer.model.errors import WaferViewerError
from wafer_viewer.session.state.snapshot import Snapshot

if TYPE_CHECKING:
    from wafer_viewer.draw.print_figures import Caption, ColourKey
    from wafer_viewer.gui.scenes.scene_view import SceneView

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
