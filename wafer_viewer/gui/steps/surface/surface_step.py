"""The step Surface: display, colours, slices, statistics and reconstruction of the surface."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import viser
from markupsafe import Markup

from wafer_viewer.draw.colormaps import COLOUR_MAPS
from wafer_viewer.draw.number_format import number, share, with_unit
from wafer_viewer.gui.dialogs.open_and_export import export_dialog, surface_name
from wafer_viewer.gui.elements.elements import (
    Button,
    Buttons,
    Checkbox,
    Dropdown,
    Elements,
    Html,
    NumberPair,
    Slider,
    Stack,
    Toggle,
)
from wafer_viewer.gui.elements.step import Here, Picks
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.page.panels import verdict_html
from wafer_viewer.gui.scene.surface_tiles import OWN_COLOURS
from wafer_viewer.gui.scenes.pose_overlay import PoseCache
from wafer_viewer.gui.state.view_state import ColourBy, Counted, View
from wafer_viewer.gui.steps.surface.heights import HEIGHT_PICKS, ShownStatistics, heights_section
from wafer_viewer.gui.steps.surface.points import clip_section, points_section
from wafer_viewer.gui.steps.surface.reconstruction import RecipeState, fold, recipe_section, stitching_section
from wafer_viewer.gui.widgets import html
from wafer_viewer.model.acquisition.plan import ScanPlan
from wafer_viewer.model.region import Region
from wafer_viewer.session.rendering.render_request import Statistics
from wafer_viewer.session.state.snapshot import OpenDataset, SurfaceInfo

FAILED, FRAME_FAILED = "The display was not changed", "The frame was not changed"
SHOW_HINT, COLOUR_HINT = "The stitched surface, or one field", "Quantity shown as colour"
MAP_HINT = "Monotonic in lightness; on the surface Viridis and Cividis lose their light end"
RANGE_HINT, ENDS_HINT = "Range of values that the colours cover", "Lowest and highest value of the colours"
HEIGHT_HINT = "Exaggeration of z; 1 is the true shape, at most 20"
SHADE_HINT = "Light from the north-west; 0 shows colours as the bar does"
FOCUS_HINT = "Strength of the all-in-focus picture in the colours"
FIELD_HINT, Z_HINT = "The field as the camera saw it at one z", "All fields as the camera saw them at one z"
FRAME_HINT = "Number of the frame, from the lowest"
COUNTED_HINT = "All of what is shown, what is in view, or the selection"
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


@dataclass(frozen=True, slots=True)
class SurfaceState:
    """poses: positions of the fields. in_view: heights in the camera's view. statistics: those of what is on show."""

    poses: PoseCache
    in_view: InView
    statistics: ShownStatistics
    recipe: RecipeState = RecipeState()


def surface_step(here: Here[SurfaceState]) -> Elements | None:
    """Return display, colour, light, slices, numbers and recipe, and the button to the step Measure."""
    page, snapshot, view = here.page, here.snapshot, here.view
    if view.step != "surface" or view.explains:
        return None
    data, info = snapshot.dataset, snapshot.surface
    points, download, ruler = view.look == "points", viser.Icon.DOWNLOAD, viser.Icon.RULER_MEASURE
    nothing = info is None and view.show == 0
    result = data.results[0] if data and len(data.results) == 1 else ""

    def measure() -> None:
        page.change(step="measure", tool="profile" if page.view.tool == "none" else page.view.tool)

    return [
        Html(html.title("Surface", _below(data, info, page.statistics, view))),
        Html(page.notes(snapshot)),
        Html(verdict_html(snapshot)),
        Toggle("Look", view.look, lambda look: page.change(look=look), "", options=LOOKS),
        _shown(page, data, view),
        points_section(page, view) if points else None,
        clip_section(page, view, here.own.statistics.view_box_um) if points else None,
        Stack(_colour(here)),
        heights_section(page, view),
        Stack(_light(page, view)),
        Stack(_pictures(page, data, view), failed=FRAME_FAILED),
        Html(html.head(surface_name(view), result)),
        Toggle("Statistics for", view.counted, lambda part: _count(page, part), COUNTED_HINT, options=COUNTED),
        Html(_numbers_of(here, data, info, view)),
        _selection(page, view),
        stitching_section(here),
        Stack(recipe_section(here)),
        Buttons([Button("Export…", lambda: export_dialog(page), download, disabled=nothing)], 34),
        Button("Measure this surface", measure, ruler, "leading", disabled=info is None),
    ]


SURFACE_PICKS: Picks[SurfaceState] = {**HEIGHT_PICKS, "recipe": fold}


def _shown(page: Page, data: OpenDataset | None, view: View) -> Dropdown:
    """Return the choice between the stitched surface, its fields, and the comparison on show."""
    fields = [f"Field {number}" for number in _listed(data, view.show)]
    options = (STITCHED, *((COMPARED,) if view.show < 0 else ()), *fields)
    shown = COMPARED if view.show < 0 else f"Field {view.show}" if view.show else STITCHED

    def choose(text: str) -> None:
        if text != COMPARED:
            show = 0 if text == STITCHED else int(text.removeprefix("Field "))
            page.change(show=show, frame_k=None, slice_z_um=None)

    return Dropdown("Show", shown if shown in options else STITCHED, choose, SHOW_HINT, options=options)


def _colour(here: Here[SurfaceState]) -> Elements:
    """Return quantity and colour map, and the range: a slider with two typed ends."""
    page, view = here.page, here.view
    scale, by, full_range = page.scale, page.coloured_by(view), _full_range(page, view)
    in_colours = view.colour_by not in ("grey", "origin")
    ranged = in_colours and full_range is not None and scale is not None
    low, high = view.range_um or ((scale.low, scale.high) if scale is not None else (-1.0, 1.0))
    least, most = full_range or (low, high)
    step = _slider_step(least, most)
    decimals = max(0, -math.floor(math.log10(step)))
    thumbs = round(round(low / step) * step, 6), round(round(high / step) * step, 6)
    ends = round(low, decimals) + 0.0, round(high, decimals) + 0.0  # no zero has a sign
    least, most = _down(min(least, low), 10 * step), _up(max(most, high), 10 * step)
    off, maps, icon = not ranged, {name: key for key, name in COLOUR_MAPS.items()}, viser.Icon

    def cover(ends: tuple[float, float] | None) -> None:
        if ends is not None and ends[1] > ends[0]:
            page.change(range_um=ends)

    def quantity(name: str) -> None:
        page.change(colour_by=COLOUR_BY[name], range_um=None)

    def colour(name: str) -> None:
        page.change(colours=maps[name])

    quantities = tuple(name for name, key in COLOUR_BY.items() if key not in page.unavailable)
    fixed = not in_colours or by in OWN_COLOURS
    usual = Button("0.5 – 99.5 %", lambda: page.change(range_um=None), icon.CHART_HISTOGRAM)
    whole = Button("Whole range", lambda: cover(_full_range(page, page.view)), icon.ARROWS_MAXIMIZE)
    return [
        Html(html.head("Colour")),
        Dropdown("Colour by", TITLES_OF_COLOUR_BY[by], quantity, COLOUR_HINT, options=quantities),
        Dropdown("Colours", COLOUR_MAPS[view.colours], colour, MAP_HINT, disabled=fixed, options=tuple(maps)),
        Slider("Range", thumbs, cover, RANGE_HINT, disabled=off, least=least, most=most, step=step),
        NumberPair("From, to", ends, cover, ENDS_HINT, disabled=off, step=step, decimals=decimals),
        Buttons([usual, whole]),
        Buttons([Button("What is in view", lambda: here.own.in_view(cover), icon.EYE)]),
    ]


def _full_range(page: Page, view: View) -> tuple[float, float] | None:
    """Return the limits of the colour range: all heights; for other quantities a margin around the usual range."""
    scale, statistics = page.scale, page.statistics
    if page.coloured_by(view) == "height" and statistics is not None and statistics.lowest_um is not None:
        low, high = statistics.span_um
        return min(statistics.lowest_um, low), max(statistics.highest_um or 0.0, high)
    if scale is None:
        return None
    spare = (scale.own_high - scale.own_low) / 2
    low = scale.own_low - spare
    return max(0.0, low) if scale.quantity in NEVER_NEGATIVE else low, scale.own_high + spare


def _light(page: Page, view: View) -> Elements:
    height, shade = view.exaggeration, round(100 * view.hillshade, 3)
    focus, flat = round(100 * view.all_in_focus, 3), view.look == "plan"
    exaggerate, light = _sets(page, "exaggeration"), _sets(page, "hillshade", 100)
    blend = _sets(page, "all_in_focus", 100)
    return [
        Html(html.head("Light and depth")),
        Slider("Height, ×", height, exaggerate, HEIGHT_HINT, disabled=flat, least=1, most=20, step=0.5),
        Slider("Hillshade, %", shade, light, SHADE_HINT, most=100, step=5) if view.look != "points" else None,
        Slider("All-in-focus, %", focus, blend, FOCUS_HINT, most=100, step=5),
    ]


def _pictures(page: Page, data: OpenDataset | None, view: View) -> Elements:
    """Return the switch to the camera's pictures, with a slider over the frames of the field on show or over z."""
    plan, single = data.plan if data is not None and data.fields else None, view.show > 0
    frame_k, z_um = (view.frame_k, None) if single else (None, view.slice_z_um)
    on = frame_k is not None or z_um is not None

    def choose_frame(number: float) -> None:
        page.change(frame_k=int(number) - 1)

    slider = None
    if plan is not None and frame_k is not None:
        most = plan.sweep.frames_of(plan.field(view.show))
        slider = Slider("Frame", frame_k + 1, choose_frame, FRAME_HINT, least=1, most=most, step=1)
    elif plan is not None and z_um is not None:
        low, high = _z_range(plan)
        step, choose = plan.sweep.z_step_um, _sets(page, "slice_z_um")
        slider = Slider("z, µm", z_um, choose, "Stage z of the frames, µm", least=low, most=high, step=step)

    def switch(wanted: bool) -> None:
        if not wanted or plan is None:
            page.change(frame_k=None, slice_z_um=None)
        elif single:
            page.change(frame_k=plan.sweep.frames_of(plan.field(view.show)) // 2, slice_z_um=None)
        else:
            low, high = _z_range(plan)
            steps = round((high - low) / plan.sweep.z_step_um)
            page.change(frame_k=None, slice_z_um=low + steps // 2 * plan.sweep.z_step_um)

    label, hint = ("One frame", FIELD_HINT) if single else ("One z", Z_HINT)
    return [
        Html(html.head("Pictures", _where(plan, view))),
        Checkbox(label, on, switch, hint, disabled=plan is None or view.show < 0, key=label),
        Stack([slider], key=slider.label) if slider is not None else None,
    ]


def _sets(page: Page, name: str, per: float = 1) -> Callable[[Any], None]:
    """Return a callback that changes a setting of the view; per: number of the input's units in one of the view's."""
    return lambda value: page.change(**{name: value if per == 1 else value / per})


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


def _count(page: Page, part: Counted) -> None:
    """Choose the part that is counted; without a selection the next drag over the scene selects."""
    page.change(counted=part, selecting=part == "selection" and page.view.selection is None)


def _selection(page: Page, view: View) -> Buttons | None:
    """Return what can be done with the selection, while it is counted."""
    box, icon = view.selection, viser.Icon
    if view.counted != "selection" or box is None:
        return None

    def measure() -> None:
        places = (Region.rectangle(*(round(v, 2) for v in box)),)
        page.change(step="measure", tool="flatness", places=places, selected=None)

    def deselect() -> None:
        page.change(selection=None, counted="all", selecting=False)

    return Buttons(
        [Button("Measure the selection", measure, icon.RULER_MEASURE), Button("No selection", deselect, icon.X)]
    )


def _numbers_of(here: Here[SurfaceState], data: OpenDataset | None, info: SurfaceInfo | None, view: View) -> Markup:
    statistics, problem = here.page.statistics, here.own.statistics.problem
    if statistics is not None:
        return _numbers(data, info if view.show == 0 and view.counted == "all" else None, statistics)
    if view.counted == "selection" and view.selection is None:
        return html.empty("Drag a rectangle over the surface:", "its statistics are shown here.")
    if problem:
        return html.empty(html.typeset(problem))
    if info is None and not view.show:
        return html.empty("The statistics of the surface are shown", "when its fields are stitched.")
    return html.empty("Counting …")


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
    if statistics.counts:
        n_all, n_drawn = statistics.n_heights, statistics.n_points
        part = f"{share(n_drawn / max(1, n_all))} of " if n_drawn != n_all else ""
        rows.append(("Points drawn" if part else "Points", f"{part}{number(n_all, 0)}"))
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
    problem = data.calibration_problem if data else None
    return html.pairs(rows) + html.remark(blocks) + html.remark(f"uncalibrated: {problem}" if problem else "")


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
