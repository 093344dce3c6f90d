"""Panel of the step Surface: display, slice, statistics and reconstruction of the surface."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import viser
from markupsafe import Markup

from wafer_viewer.draw.colormaps import COLOUR_MAPS
from wafer_viewer.draw.number_format import number, share, with_unit
from wafer_viewer.gui.page.import_export_dialogs import export_dialog
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.page.panels import VerdictSection
from wafer_viewer.gui.presenters.surface import surface_name
from wafer_viewer.gui.scene.surface_tiles import OWN_COLOURS
from wafer_viewer.gui.scenes.pose_overlay import PoseCache
from wafer_viewer.gui.state.view_state import ColourBy, Counted, View
from wafer_viewer.gui.surface.heights_section import HeightsSection, ShownStatistics
from wafer_viewer.gui.surface.points_section import ClipSection, PointsSection
from wafer_viewer.gui.surface.reconstruction_section import RecipeSection, StitchingSection
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.controls import BoundInput, HtmlBlock, ToggleGroup, button, in_a_row, leading, set_prop
from wafer_viewer.model.acquisition.plan import ScanPlan
from wafer_viewer.model.region import Region
from wafer_viewer.session.rendering.render_request import Statistics
from wafer_viewer.session.state.snapshot import OpenDataset, Snapshot, SurfaceInfo


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
        if single:
            set_prop(self._frame.handle, "max", plan.sweep.frames_of(plan.field(view.show)))
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
        plan, show = data.plan, page.view.show
        if not event.target.value:
            page.change(frame_k=None, slice_z_um=None)
        elif show > 0:
            page.change(frame_k=plan.sweep.frames_of(plan.field(show)) // 2, slice_z_um=None)
        else:
            low, high = _z_range(plan)
            steps = round((high - low) / plan.sweep.z_step_um)
            page.change(frame_k=None, slice_z_um=low + steps // 2 * plan.sweep.z_step_um)

    def _choose_frame(self, event: Any) -> None:
        self._page.change(frame_k=int(event.target.value) - 1)

    def _choose_z(self, event: Any) -> None:
        self._page.change(slice_z_um=float(event.target.value))


def _z_range(plan: ScanPlan) -> tuple[float, float]:
    return min(field.z_start_um for field in plan.fields), max(map(plan.sweep.top_um, plan.fields))


def _where(plan: ScanPlan | None, view: View) -> str:
    if plan is None:
        return ""
    if view.show > 0 and view.frame_k is not None:
        field = plan.field(view.show)
        z_um = plan.sweep.z_um(field, view.frame_k)
        return f"frame {view.frame_k + 1} of {plan.sweep.frames_of(field)} · z {with_unit(z_um, 1, signed=True)}"
    if not view.show and view.slice_z_um is not None:
        return f"stitched, z {with_unit(view.slice_z_um, 1, signed=True)}"
    return "as the camera took them"


COUNTED: tuple[tuple[Counted, str], ...] = (("all", "All"), ("view", "In view"), ("selection", "Selection"))
LOOKS = (("surface", "Surface"), ("points", "Points"), ("plan", "Plan"))
COLOUR_BY: dict[str, ColourBy] = {
    "Height": "height",
    "Confidence": "confidence",
    "Uncertainty": "uncertainty",
    "Slope": "slope",
    "Deviation from plane": "deviation",
    "Deviation from form": "form",
    "Overlap difference": "overlap",
    "All-in-focus picture": "grey",
    "Origin": "origin",
}
TITLES_OF_COLOUR_BY: dict[ColourBy, str] = {"difference": "Height", **{key: name for name, key in COLOUR_BY.items()}}
NEVER_NEGATIVE = ("confidence", "uncertainty", "slope", "overlap")
STITCHED, COMPARED = "Stitched surface", "Comparison"
MOST_LISTED = 500
"""Fields in the list of surfaces, which a browser can scroll; the others are chosen on the map."""
FULL_BLEND = 0.4
"""Opacity of the all-in-focus picture when it is switched on."""
FULL_SHADE = 0.8
InView = Callable[[Callable[[tuple[float, float]], None]], None]
"""Function that calls back with the range of the colour quantity in the camera's view."""


class SurfacePanel:
    """Panel with display style, colour, light, slices, numbers and recipe, and the button to the step Measure."""

    def __init__(self, page: Page, poses: PoseCache, in_view: InView, statistics: ShownStatistics) -> None:
        self._page, self._in_view, self._statistics = page, in_view, statistics
        self._poses = poses
        self._folder = page.gui.add_folder(None, visible=False)
        with self._folder:
            self._build()

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Bring the panel up to date."""
        visible = view.step == "surface" and not view.explains
        set_prop(self._folder, "visible", visible)
        if not visible:
            return
        data, info, statistics = snapshot.dataset, snapshot.surface, self._page.statistics
        self._title.show(html.title("Surface", _below(data, info, statistics, view)))
        self._notes.show(self._page.notes(snapshot))
        self._verdict.show(snapshot)
        self._show_look(data, view)
        self._points.show(view)
        self._clip.show(view)
        self._show_colour(view)
        self._heights.show(view)
        self._show_light(view)
        self._slice.show(snapshot, view)
        self._counted.show(view.counted)
        self._head.show(html.head(surface_name(view), data.results[0] if data and len(data.results) == 1 else ""))
        self._numbers.show(self._numbers_of(data, info, view))
        selected = view.counted == "selection" and view.selection is not None
        for handle in (self._of_selection, self._deselect):
            set_prop(handle, "visible", selected)
        self._stitching.show(snapshot, view)
        self._recipe.show(snapshot)
        set_prop(self._measure, "disabled", info is None)
        set_prop(self._export, "disabled", info is None and view.show == 0)

    def toggle_hillshade(self) -> None:
        """Switch the hillshade (light from the north-west) on or off."""
        self._page.change(hillshade=0.0 if self._page.view.hillshade else FULL_SHADE)

    def toggle_fields(self) -> None:
        """Switch the overlay of fields and overlaps on or off."""
        self._page.change(fields=not self._page.view.fields)

    def toggle_all_in_focus(self) -> None:
        """Switch the all-in-focus picture on or off."""
        self._page.change(all_in_focus=0.0 if self._page.view.all_in_focus else FULL_BLEND)

    # --- building

    def _build(self) -> None:
        page, gui = self._page, self._page.gui
        self._title = HtmlBlock(gui)
        self._notes = HtmlBlock(gui)
        self._verdict = VerdictSection(page)
        self._look = ToggleGroup(gui, "Look", LOOKS, lambda key: page.change(look=key))
        self._shown = self._field(gui.add_dropdown("Show", (STITCHED,)), lambda text: self._choose_shown(text))
        self._points = PointsSection(page)
        self._clip = ClipSection(page, self._statistics.view_box_um)
        self._build_colour()
        self._heights = HeightsSection(page)
        self._build_light()
        self._slice = SliceSection(page)
        self._head = HtmlBlock(gui)
        self._counted = ToggleGroup(gui, "Numbers of", COUNTED, self._count)
        self._numbers = HtmlBlock(gui)
        self._of_selection = button(
            gui, "Measure the selection", viser.Icon.RULER_MEASURE, lambda _: self._measure_selection()
        )
        self._deselect = button(
            gui, "No selection", viser.Icon.X, lambda _: page.change(selection=None, counted="all", selecting=False)
        )
        in_a_row(gui, [self._of_selection, self._deselect])
        self._stitching = StitchingSection(page, self._poses)
        self._recipe = RecipeSection(page)
        self._export = button(gui, "Export…", viser.Icon.DOWNLOAD, lambda _: export_dialog(page))
        in_a_row(gui, [self._export], 34)
        self._measure = button(gui, "Measure this surface", viser.Icon.RULER_MEASURE, lambda _: self._go_measure())
        leading(gui, self._measure)

    def _build_colour(self) -> None:
        page, gui = self._page, self._page.gui
        HtmlBlock(gui, html.head("Colour"))
        by = gui.add_dropdown("Colour by", tuple(COLOUR_BY))
        self._by = self._field(by, lambda text: page.change(colour_by=COLOUR_BY[text], range_um=None))
        names = {name: key for key, name in COLOUR_MAPS.items()}
        colours = gui.add_dropdown("Colours", tuple(names))
        self._colours = self._field(colours, lambda text: page.change(colours=names[text]))
        slider = gui.add_multi_slider("Range", -1.0, 1.0, 0.1, (-1.0, 1.0))
        self._range = self._field(slider, lambda ends: page.change(range_um=(float(ends[0]), float(ends[1]))))
        by_hand = gui.add_vector2("By hand", (-1.0, 1.0), step=0.1)
        self._by_hand = self._field(by_hand, self._set_range)
        usual = button(gui, "0.5 – 99.5 %", viser.Icon.CHART_HISTOGRAM, lambda _: page.change(range_um=None))
        full_range = button(gui, "Whole range", viser.Icon.ARROWS_MAXIMIZE, lambda _: self._set_full_range())
        in_a_row(gui, [usual, full_range])
        in_view = button(gui, "What is in view", viser.Icon.EYE, lambda _: self._in_view(self._set_range))
        in_a_row(gui, [in_view])

    def _build_light(self) -> None:
        page, gui = self._page, self._page.gui
        HtmlBlock(gui, html.head("Light and depth"))
        self._height = self._field(
            gui.add_slider("Height, ×", 1.0, 20.0, 0.5, 3.0), lambda times: page.change(exaggeration=float(times))
        )
        shade = gui.add_slider("Hillshade, %", 0.0, 100.0, 5.0, 80.0)
        self._shade = self._field(shade, lambda percent: page.change(hillshade=percent / 100))
        focus = gui.add_slider("All-in-focus, %", 0.0, 100.0, 5.0, 0.0)
        self._focus = self._field(focus, lambda percent: page.change(all_in_focus=percent / 100))

    def _field(self, handle: Any, act: Callable[[Any], Any]) -> BoundInput[Any]:
        return BoundInput(handle, lambda event: act(event.target.value), self._page, "The display was not changed")

    # --- choices

    def _count(self, key: Counted) -> None:
        """Choose the part that is counted; without a selection the next drag over the scene selects."""
        self._page.change(counted=key, selecting=key == "selection" and self._page.view.selection is None)

    def _choose_shown(self, text: str) -> None:
        if text == COMPARED:
            return
        show = 0 if text == STITCHED else int(text.removeprefix("Field "))
        self._page.change(show=show, frame_k=None, slice_z_um=None)

    def _measure_selection(self) -> None:
        """Measure the flatness of the selection."""
        box = self._page.view.selection
        if box is not None:
            places = (Region.rectangle(*(round(v, 2) for v in box)),)
            self._page.change(step="measure", tool="flatness", places=places, selected=None)

    def _set_range(self, ends: tuple[float, float]) -> None:
        low, high = ends
        if high > low:
            self._page.change(range_um=(low, high))

    def _set_full_range(self) -> None:
        full_range = self._full_range(self._page.view)
        if full_range is not None and full_range[1] > full_range[0]:
            self._page.change(range_um=full_range)

    def _go_measure(self) -> None:
        tool = self._page.view.tool
        self._page.change(step="measure", tool="profile" if tool == "none" else tool)

    # --- showing

    def _show_look(self, data: OpenDataset | None, view: View) -> None:
        self._look.show(view.look)
        fields = [f"Field {number}" for number in _listed(data, view.show)]
        options = (STITCHED, *((COMPARED,) if view.show < 0 else ()), *fields)
        if tuple(self._shown.handle.options) != options:
            self._shown.handle.options = options
        shown = COMPARED if view.show < 0 else f"Field {view.show}" if view.show else STITCHED
        if shown in options:
            self._shown.show(shown)

    def _numbers_of(self, data: OpenDataset | None, info: SurfaceInfo | None, view: View) -> Markup:
        statistics = self._page.statistics
        if statistics is not None:
            return _numbers(data, info if view.show == 0 and view.counted == "all" else None, statistics)
        if view.counted == "selection" and view.selection is None:
            return html.empty("Drag a rectangle over the surface:", "its numbers come here.")
        if self._statistics.problem:
            return html.empty(html.with_micro_sign(self._statistics.problem))
        if info is None and not view.show:
            return html.empty("The numbers of the surface come", "when its fields are stitched.")
        return html.empty("Counting …")

    def _show_colour(self, view: View) -> None:
        scale, by = self._page.scale, self._page.coloured_by(view)
        set_prop(self._by.handle, "options", _quantities(self._page.unavailable))
        self._by.show(TITLES_OF_COLOUR_BY[by])
        self._colours.show(COLOUR_MAPS[view.colours])
        in_colours = view.colour_by not in ("grey", "origin")
        self._colours.enable(in_colours and by not in OWN_COLOURS)
        full_range = self._full_range(view)
        ranged = in_colours and full_range is not None and scale is not None
        for widget in (self._range, self._by_hand):
            widget.enable(ranged)
        if not ranged or full_range is None or scale is None:
            return
        low, high = view.range_um or (scale.low, scale.high)
        step = _slider_step(*full_range)
        set_prop(self._range.handle, "step", step)
        set_prop(self._range.handle, "min", _down(min(full_range[0], low), 10 * step))
        set_prop(self._range.handle, "max", _up(max(full_range[1], high), 10 * step))
        self._range.show((round(round(low / step) * step, 6), round(round(high / step) * step, 6)))
        self._show_by_hand(low, high, step)

    def _show_by_hand(self, low: float, high: float, step: float) -> None:
        decimals = max(0, -math.floor(math.log10(step)))
        set_prop(self._by_hand.handle, "step", step)
        set_prop(self._by_hand.handle, "precision", decimals)
        self._by_hand.show((round(low, decimals) + 0.0, round(high, decimals) + 0.0))  # no zero has a sign

    def _full_range(self, view: View) -> tuple[float, float] | None:
        """Return the limits of the colour range: all heights; for other quantities a margin around the usual range."""
        scale, statistics = self._page.scale, self._page.statistics
        if self._page.coloured_by(view) == "height" and statistics is not None and statistics.lowest_um is not None:
            return min(statistics.lowest_um, statistics.span_um[0]), max(
                statistics.highest_um or 0.0, statistics.span_um[1]
            )
        if scale is None:
            return None
        spare = (scale.own_high - scale.own_low) / 2
        low = scale.own_low - spare
        return max(0.0, low) if scale.quantity in NEVER_NEGATIVE else low, scale.own_high + spare

    def _show_light(self, view: View) -> None:
        self._height.show(view.exaggeration)
        self._height.enable(view.look != "plan")
        self._shade.show(round(100 * view.hillshade, 3))
        set_prop(self._shade.handle, "visible", view.look != "points")
        self._focus.show(round(100 * view.all_in_focus, 3))


def _quantities(unavailable: tuple[str, ...]) -> tuple[str, ...]:
    """Return the names of the available colour quantities."""
    return tuple(name for name, key in COLOUR_BY.items() if key not in unavailable)


def _below(data: OpenDataset | None, info: SurfaceInfo | None, statistics: Statistics | None, view: View) -> str:
    """Return one line about the displayed surface: name, number of points, measured share."""
    if data is None:
        return "Open a dataset, or scan one."
    calibrated = "" if data.calibration_problem is None else " · uncalibrated"
    if view.show == 0 and info is None:
        return f"{len(data.stamps)} of {len(data.fields)} fields reconstructed{calibrated}"
    name = surface_name(view)
    if view.show == 0 and view.counted == "all" and info is not None:
        name = "From a file" if not data.fields else "1 field" if info.n_fields == 1 else f"{info.n_fields} fields"
    if statistics is None:
        return f"{name}{calibrated}"
    size = f"{number(statistics.cols, 0)} × {number(statistics.rows, 0)} points"
    return f"{name} · {size} · {share(statistics.measured_fraction)} measured{calibrated}"


def _numbers(data: OpenDataset | None, info: SurfaceInfo | None, statistics: Statistics) -> Markup:
    """Return the statistics as HTML; `info` is that of the stitched surface if all of it is counted."""
    rows = [
        ("Highest", with_unit(statistics.highest_um, 2, signed=True)),
        ("Lowest", with_unit(statistics.lowest_um, 2, signed=True)),
    ]
    if statistics.mean_um is not None:
        rows.append(("Mean", with_unit(statistics.mean_um, 2, signed=True)))
        rows.append(("Spread (1 σ)", with_unit(statistics.spread_um, 2)))
    if statistics.counts and statistics.n_points != statistics.n_heights:
        rows.append(
            (
                "Points drawn",
                f"{share(statistics.n_points / max(1, statistics.n_heights))} of {number(statistics.n_heights, 0)}",
            )
        )
    elif statistics.counts:
        rows.append(("Points", number(statistics.n_heights, 0)))
    rows += [
        ("Not measured", share(1 - statistics.measured_fraction - statistics.filled_fraction)),
        *((f"– {words}", share(part)) for words, part in statistics.unmeasured if part > 0),
        ("Filled", share(statistics.filled_fraction)),
    ]
    if info is not None and info.overlap_rms_um is not None and info.stitching is None:
        rows.append(("Height difference in overlaps, rms", with_unit(info.overlap_rms_um, 2)))
    blocks = (
        f"Heights are means of {statistics.block_px} × {statistics.block_px} points." if statistics.block_px > 1 else ""
    )
    note = Markup('<div class="wv-lab">{}</div>').format(blocks) if blocks else Markup()
    problem = data.calibration_problem if data else None
    why = (
        Markup('<div class="wv-lab" style="margin-top:5px">uncalibrated: {}</div>').format(problem)
        if problem
        else Markup()
    )
    return html.pairs(rows) + note + why


def _slider_step(low: float, high: float) -> float:
    """Return a slider step that divides the range into at most 600 parts; 5 for larger ranges."""
    for step in (0.001, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0):
        if (high - low) / step <= 600:
            return step
    return 5.0


def _down(value: float, step: float) -> float:
    return round((value // step) * step, 6)


def _up(value: float, step: float) -> float:
    return round(-((-value) // step) * step, 6)


def _listed(data: OpenDataset | None, show: int) -> list[int]:
    """Return the numbers of the fields in the list of surfaces: the first of very many, and the one that is shown."""
    if data is None:
        return []
    numbers = sorted(data.stamps)
    others = [show] if show in data.stamps and show not in numbers[:MOST_LISTED] else []
    return numbers[:MOST_LISTED] + others
