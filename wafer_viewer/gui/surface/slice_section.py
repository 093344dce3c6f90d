"""Slice section: a single frame of a field, or the stitched picture at one z, instead of the surface."""

from __future__ import annotations

from typing import Any

from wafer_viewer.draw.number_format import with_unit
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.controls import BoundInput, HtmlBlock, set_prop
from wafer_viewer.model.acquisition.plan import ScanPlan
from wafer_viewer.session.state.snapshot import Snapshot


class SliceSection:
    """Switch, and a slider over the frames of the displayed field or over z."""

    def __init__(self, page: Page) -> None:
        self._page = page
        gui = page.gui
        self._head = HtmlBlock(gui)
        self._on = BoundInput(gui.add_checkbox("One frame", False), self._switch, page, "The frame was not changed")
        self._frame = self._slider(gui.add_slider("Frame", 1, 3, 1, 1, visible=False), self._choose_frame)
        self._z = self._slider(gui.add_slider("z, µm", 0.0, 1.0, 0.1, 0.0, visible=False), self._choose_z)

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Bring the section up to date."""
        plan = snapshot.dataset.plan if snapshot.dataset and snapshot.dataset.fields else None
        single = view.show > 0
        on = view.frame_k is not None if single else view.slice_z_um is not None
        self._head.show(html.head("Pictures", _where(plan, view)))
        set_prop(self._on.handle, "label", "One frame" if single else "One z")
        self._on.show(on)
        self._on.enable(plan is not None and view.show >= 0)
        set_prop(self._frame.handle, "visible", single and on)
        set_prop(self._z.handle, "visible", not single and on)
        if plan is None:
            return
        set_prop(self._frame.handle, "max", plan.sweep.n_frames)
        if view.frame_k is not None:
            self._frame.show(view.frame_k + 1)
        if view.slice_z_um is not None:
            low, high = _z_range(plan)
            set_prop(self._z.handle, "min", low)
            set_prop(self._z.handle, "max", high)
            set_prop(self._z.handle, "step", plan.sweep.z_step_um)
            self._z.show(view.slice_z_um)

    def _slider(self, handle: Any, act: Any) -> BoundInput[Any]:
        return BoundInput(handle, act, self._page, "The frame was not changed")

    def _switch(self, event: Any) -> None:
        page, data = self._page, self._page.session.snapshot.dataset
        if data is None:
            return
        middle = data.plan.sweep.n_frames // 2
        if not event.target.value:
            page.change(frame_k=None, slice_z_um=None)
        elif page.view.show > 0:
            page.change(frame_k=middle, slice_z_um=None)
        else:
            low, _ = _z_range(data.plan)
            page.change(frame_k=None, slice_z_um=low + middle * data.plan.sweep.z_step_um)

    def _choose_frame(self, event: Any) -> None:
        self._page.change(frame_k=int(event.target.value) - 1)

    def _choose_z(self, event: Any) -> None:
        self._page.change(slice_z_um=float(event.target.value))


def _z_range(plan: ScanPlan) -> tuple[float, float]:
    low = min(field.z_start_um for field in plan.fields)
    return low, max(field.z_start_um for field in plan.fields) + plan.sweep.range_um


def _where(plan: ScanPlan | None, view: View) -> str:
    if plan is None:
        return ""
    if view.show > 0 and view.frame_k is not None:
        z_um = plan.sweep.z_um(plan.field(view.show), view.frame_k)
        return f"frame {view.frame_k + 1} of {plan.sweep.n_frames} · z {with_unit(z_um, 1, signed=True)}"
    if not view.show and view.slice_z_um is not None:
        return f"stitched, z {with_unit(view.slice_z_um, 1, signed=True)}"
    return "as the camera took them"
