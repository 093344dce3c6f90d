"""Stitching section: registration figures, warnings, and the switch of the overlay."""

from __future__ import annotations

from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.presenters import stitching as words
from wafer_viewer.gui.scenes.pose_cache import PoseCache
from wafer_viewer.gui.scenes.surface_scene import source_of
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.controls import BoundInput, HtmlBlock, set_prop
from wafer_viewer.session.state.snapshot import Snapshot, SurfaceInfo


class StitchingSection:
    """Section shown for more than one field; it lists rejected overlaps with the details or the overlay."""

    def __init__(self, page: Page, poses: PoseCache) -> None:
        self._page, self._poses = page, poses
        self._unfolded = False
        gui = page.gui
        self._folder = gui.add_folder(None, visible=False)
        with self._folder:
            self._head = HtmlBlock(gui)
            gui.add_html('<div class="wv-wide"></div>')
            box = gui.add_checkbox("Fields and overlaps", False, hint="Key O")
            self._on = BoundInput(
                box, lambda event: page.change(fields=bool(event.target.value)), page, "The display was not changed"
            )
            self._said = HtmlBlock(gui)
        page.on_pick("stitching", self._toggle)

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Bring the section up to date."""
        info = snapshot.surface
        there = info is not None and info.n_fields > 1 and view.show == 0
        set_prop(self._folder, "visible", there)
        if info is None or not there:
            return
        self._head.show(self._headed(info))
        self._on.show(view.fields)
        self._on.enable(info.stitching is not None)
        self._said.show(self._all_said(snapshot, info, view))

    def _toggle(self, _: str) -> None:
        self._unfolded = not self._unfolded
        self._page.redraw()

    def _headed(self, info: SurfaceInfo) -> str:
        name = "Less" if self._unfolded else "Details"
        link = f'<span class="wv-link" {html.pick("stitching")}>{name}</span>' if info.stitching else ""
        return f'<div class="wv-h">Stitching<span>{link}</span></div>'

    def _all_said(self, snapshot: Snapshot, info: SurfaceInfo, view: View) -> str:
        found = info.stitching
        if found is None:
            return f'<div class="wv-lab">{words.BY_STAGE}</div>'
        said = words.cautions(found) + words.numbers(found)
        if self._unfolded:
            said += words.details(found)
        if self._unfolded or view.shows_fields:
            said += self._doubted(snapshot, info)
        return said

    def _doubted(self, snapshot: Snapshot, info: SurfaceInfo) -> str:
        source = source_of(snapshot, 0)
        known = self._poses.at(source) if source is not None else None
        return (
            words.rejected_overlaps(known.poses, info.pixel_um) if known is not None and known.poses is not None else ""
        )
