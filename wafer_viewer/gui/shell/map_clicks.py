"""Clicks on the field map: show or move to a field, fly to a place, or move the stage after confirmation."""

from __future__ import annotations

from typing import TYPE_CHECKING

import viser

from wafer_viewer.draw.charts.wafer_map import MOST_SINGLE
from wafer_viewer.draw.number_format import number
from wafer_viewer.gui.page.dialogs import Dialog
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.shell.field_map import drawn, field_at

if TYPE_CHECKING:
    from wafer_viewer.gui.scenes.scene_view import SceneView

WIDE_UM = 300.0
"""Side of the area shown around a place if the camera's view of the ground is unbounded."""


class MapClicks:
    """Click handler of the field map; fields are given by number, places in stage um."""

    def __init__(self, page: Page, scene: SceneView) -> None:
        self._page, self._scene = page, scene
        page.on_pick("field", lambda key: self._go_to_field(int(key)))
        page.on_pick("place", lambda key: self._go_to_place(*(float(um) for um in key.split(","))))

    def _go_to_field(self, chosen: int) -> None:
        """Move the stage to a field in Plan and Acquire; on a surface show the field, or all on a second click.

        Nothing moves for data that this rig did not take, because its fields have no stage position here.
        """
        page = self._page
        if page.view.on_surface:
            page.change(show=0 if page.view.show == chosen else chosen, frame_k=None, slice_z_um=None)
            return
        snapshot = page.session.snapshot
        if self._is_elsewhere:
            return
        field = next((f for f in drawn(snapshot, page.view)[0] if f.number == chosen), None)
        if field is not None and not snapshot.scanning:
            page.ask("The stage did not move", page.session.move_to(x_um=field.x_um, y_um=field.y_um))

    def _go_to_place(self, x_um: float, y_um: float) -> None:
        page, snapshot = self._page, self._page.session.snapshot
        many = len(drawn(snapshot, page.view)[0]) > MOST_SINGLE  # which have no element of their own to be clicked
        field = field_at(snapshot, page.view, x_um, y_um) if many else None
        if field is not None:
            self._go_to_field(field.number)
        elif page.view.on_surface:
            self._fly(x_um, y_um)
        elif snapshot.rig.state == "ready" and not self._is_elsewhere:
            self._ask_to_move(x_um, y_um)

    @property
    def _is_elsewhere(self) -> bool:
        """True if the map shows data that this rig did not take."""
        snapshot, view = self._page.session.snapshot, self._page.view
        return view.step == "acquire" and snapshot.dataset is not None and not snapshot.is_of_this_rig

    def _fly(self, x_um: float, y_um: float) -> None:
        """Fly to a place and keep the size of the view."""
        corners = self._scene.seen_um()
        xs, ys = ([corner[k] for corner in corners] for k in (0, 1)) if corners else ((0.0, WIDE_UM), (0.0, WIDE_UM))
        half_x, half_y = (max(xs) - min(xs)) / 2, (max(ys) - min(ys)) / 2
        self._scene.fly_to((x_um - half_x, y_um - half_y, x_um + half_x, y_um + half_y))

    def _ask_to_move(self, x_um: float, y_um: float) -> None:
        place = f"X {number(x_um / 1000, 4, signed=True)}, Y {number(y_um / 1000, 4, signed=True)} mm"
        page = self._page
        dialog = Dialog(page, "Move the stage?", f"To {place}. Z does not change: check that nothing is in the way.")
        dialog.answers(
            "Move there",
            viser.Icon.CROSSHAIR,
            lambda: page.ask("The stage did not move", page.session.move_to(x_um=x_um, y_um=y_um)),
            "The stage did not move",
        )
