"""Following the focus: the coarse look, its map of windows, and a row of fields from the side."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import viser
from markupsafe import Markup

from wafer_viewer.draw.charts.axes import ChartAxes, PlotLook, plot_html, round_ticks
from wafer_viewer.draw.charts.wafer_map import MapViewport, map_frame
from wafer_viewer.draw.colormaps import Rgb
from wafer_viewer.draw.number_format import number, plural, with_unit
from wafer_viewer.gui.elements.elements import Button, Buttons, Elements, Html, Toggle
from wafer_viewer.gui.elements.step import Here
from wafer_viewer.gui.scenes.plan_scene import WINDOW_COLOUR, FollowedPlan, followed
from wafer_viewer.gui.steps.job_dialogs import edit
from wafer_viewer.gui.steps.plan_form import PlanState
from wafer_viewer.gui.widgets import html
from wafer_viewer.model.acquisition.plan import Field, FieldFocus, FocusSweep
from wafer_viewer.model.spec import replace

NOT_FOUND = "The focus was not searched"
ALLOW_FOR = ((1.0, "1 u"), (2.0, "2 u"), (3.0, "3 u"))
"""Coverage factors with their titles."""
_MAP_PX = 250
_LEAST_FOR_TEXT_PX = 19
_LINE, _BAND = "var(--accent)", 0.28


def follow_section(here: Here[PlanState]) -> Elements:
    """Return the section of a plan that follows the focus; nothing for another one."""
    snapshot, draft, session = here.snapshot, here.snapshot.draft, here.page.session
    follow = draft.job.follow_focus if draft.job is not None else None
    if follow is None:
        return []
    shown = followed(draft, here.view.focus_row)
    busy = draft.plan is None or not snapshot.rig.can_start
    everywhere = shown is None or len(shown.look.places) >= len(shown.plan.fields)

    def allow(factor: float) -> None:
        edit(here.page, "The allowance was not changed", follow_focus=replace(follow, coverage_factor=factor))

    def button(label: str, act: object, icon: object, disabled: bool) -> Button:
        return Button(label, act, icon, disabled=disabled, commands=True, failed=NOT_FOUND)  # pyright: ignore[reportArgumentType]

    look = button("Look for the focus", session.look_for_focus, viser.Icon.CROSSHAIR, busy)
    more = button("More places", session.look_at_more_places, viser.Icon.PLUS, busy or everywhere)
    return [
        Html(head(shown)),
        Toggle("Allow for", follow.coverage_factor, allow, "", options=ALLOW_FOR),
        Buttons([look, more]),
        Html(windows(shown) if shown is not None else ""),
    ]


def head(shown: FollowedPlan | None) -> Markup:
    """Return the head of the section: the number of places with a focus, or a note that there was no look yet."""
    if shown is None:
        return html.head("Following") + html.remark("No coarse look yet: Start scan takes one first.")
    places = shown.look.places
    return html.head("Following", f"{len(shown.look.found)} of {len(places)} places in focus")


def windows(shown: FollowedPlan) -> Markup:
    """Return the map of places and windows with its legend, and the row from the side."""
    mean_um = np.mean([high - low for low, high in map(shown.window_um, shown.plan.fields)])
    mean_text = html.remark(f"Window of each field, µm · mean {number(float(mean_um), 0)}. Click a row.")
    return _map(shown) + _legend() + mean_text + _from_the_side(shown) + _no_focus(shown)


def _map(shown: FollowedPlan) -> Markup:
    """Return the map: colour of the predicted height, length of the window, places looked at and without a focus."""
    width_um, height_um = shown.frame_um()
    fields = shown.plan.fields
    frame = map_frame(fields, width_um, height_um, width_px=_MAP_PX, most_height_px=_MAP_PX)
    if frame is None:
        return Markup()
    cells = [
        _cell(shown, frame, field, colour, opacity)
        for field, colour, opacity in zip(fields, shown.colours(), shown.opacities(), strict=True)
    ]
    return Markup(
        '<svg width="{:.0f}" height="{:.0f}" role="group" aria-label="Windows of the fields" '
        'style="display:block;margin:4px auto">{}{}</svg>'
    ).format(frame.width_px, frame.height_px, Markup("").join(cells), _row_outline(shown, frame))


def _cell(shown: FollowedPlan, frame: MapViewport, field: Field, colour: Rgb, opacity: float) -> Markup:
    width_um, height_um = shown.frame_um()
    x, y = frame.x(field.x_um - width_um / 2), frame.y(field.y_um + height_um / 2)
    w, h = width_um * frame.scale, height_um * frame.scale
    low_um, high_um = shown.window_um(field)
    text = Markup()
    if w >= _LEAST_FOR_TEXT_PX:
        dark = sum(colour) < 380 and opacity > 0.6
        text = Markup('<text x="{:.1f}" y="{:.1f}" text-anchor="middle" font-size="10" fill="{}">{}</text>').format(
            x + w / 2, y + h - 4, "#fff" if dark else "#15202b", number(high_um - low_um, 0)
        )
    sign = _sign(field.number in shown.blank, x + 7, y + 7.5) if field.number in shown.looked_at else ""
    return Markup(
        '<g {}><title>Field {}: window {} to {} µm</title>'
        '<rect x="{:.1f}" y="{:.1f}" width="{:.1f}" height="{:.1f}" fill="#fff"/>'
        '<rect x="{:.1f}" y="{:.1f}" width="{:.1f}" height="{:.1f}" fill="rgb{}" fill-opacity="{:.2f}" '
        'stroke="#fff" stroke-width=".8"/>{}{}</g>'
    ).format(
        html.pick("focus-row", field.row), field.number, number(low_um, 0), number(high_um, 0),
        x, y, w, h, x, y, w, h, colour, opacity, text, sign,
    )  # fmt: skip


def _sign(blank: bool, x: float, y: float) -> Markup:
    """Return the sign of a place: a ring, or an exclamation mark where it has no focus."""
    if blank:
        return Markup(
            '<g><rect x="{:.1f}" y="{:.1f}" width="11" height="12" rx="2" fill="#fff3d6" stroke="#9a6700"/>'
            '<text x="{:.1f}" y="{:.1f}" text-anchor="middle" font-size="10" font-weight="700" fill="#9a4a00">!</text>'
            "</g>"
        ).format(x - 5.5, y - 6, x, y + 3.5)
    return Markup('<circle cx="{:.1f}" cy="{:.1f}" r="3.4" fill="#fff" stroke="#15202b" stroke-width="1.4"/>').format(
        x, y
    )


def _row_outline(shown: FollowedPlan, frame: MapViewport) -> Markup:
    width_um, height_um = shown.frame_um()
    fields = [field for field, _ in shown.in_row]
    x0 = frame.x(fields[0].x_um - width_um / 2)
    x1 = frame.x(fields[-1].x_um + width_um / 2)
    y0 = frame.y(max(f.y_um for f in fields) + height_um / 2)
    y1 = frame.y(min(f.y_um for f in fields) - height_um / 2)
    return Markup(
        '<rect x="{:.1f}" y="{:.1f}" width="{:.1f}" height="{:.1f}" fill="none" stroke="{}" stroke-width="2" '
        'pointer-events="none"/>'
    ).format(x0, y0, x1 - x0, y1 - y0, WINDOW_COLOUR)


def _legend() -> Markup:
    style = "background:#fff;border:1.5px solid #15202b;border-radius:50%;width:10px;height:10px"
    ring, row = Markup('<i class="wv-sw" style="{}"></i>').format(style), html.swatch("transparent", WINDOW_COLOUR)
    return html.legend([(ring, "searched"), (Markup("<b>!</b>"), "no focus"), (row, "row from the side")])


def _no_focus(shown: FollowedPlan) -> Markup:
    """Return a note on the places without a focus; empty if there are none."""
    if not shown.blank:
        return Markup()
    n, numbers = len(shown.blank), ", ".join(map(str, sorted(shown.blank)[:8]))
    name = f"No focus in {plural(n, 'place')}"
    whole = with_unit(shown.plan.sweep.range_um, 0)
    take = "It takes" if n == 1 else "They take"
    return html.note("attention", name, f"Field{'s' if n > 1 else ''} {numbers}. {take} the whole sweep, {whole}.")


def _from_the_side(shown: FollowedPlan) -> Markup:
    """Return the row from the side: focus with its uncertainty, windows, and the whole sweep dashed."""
    row, k = shown.in_row, shown.follow.coverage_factor
    width_um, _ = shown.frame_um()
    sweep, whole = shown.plan.sweep, shown.whole_um
    x_um = row[0][0].x_um - width_um / 2, row[-1][0].x_um + width_um / 2
    pad_um = 0.04 * (whole[1] - whole[0])
    ends = whole[0] - pad_um, whole[1] + pad_um
    x_mm = x_um[0] / 1000, x_um[1] / 1000
    axes = ChartAxes.stretched(x_mm, ends, round_ticks(x_mm, 5), round_ticks(ends, 5, signed=True))
    boxes = Markup("").join(_window(axes, shown, field, width_um, sweep) for field, _ in row)
    drawn = _dashed(axes, whole) + boxes + _band(axes, row, k, shown.blank)
    look = PlotLook(
        f"Row {shown.row + 1} from the side", "z, µm", "x, mm", left_px=44, right_px=8, style="height:190px"
    )
    signs = [
        (html.swatch(_LINE, _LINE), f"focus, ± {k:g} u"),
        (html.swatch("transparent", WINDOW_COLOUR), "window"),
        (html.swatch("transparent", "var(--ink3)", dashed=True), f"whole sweep, {with_unit(sweep.range_um, 0)}"),
    ]
    return html.head(f"Row {shown.row + 1} from the side") + html.legend(signs) + plot_html(axes, look, drawn)


def _window(axes: ChartAxes, shown: FollowedPlan, field: Field, width_um: float, sweep: FocusSweep) -> Markup:
    low_um, high_um = field.z_start_um, sweep.top_um(field)
    x0, x1 = (axes.x.at((field.x_um + side * 0.42 * width_um) / 1000) for side in (-1, 1))
    y0, y1 = axes.y.at(high_um), axes.y.at(low_um)
    dash = "5 4" if field.number in shown.blank else "none"
    return Markup(
        '<rect x="{:.1f}" y="{:.1f}" width="{:.1f}" height="{:.1f}" fill="{}" fill-opacity=".12" stroke="{}" '
        'stroke-width="1.4" stroke-dasharray="{}" vector-effect="non-scaling-stroke"/>'
    ).format(x0, y0, x1 - x0, y1 - y0, WINDOW_COLOUR, WINDOW_COLOUR, dash)


def _dashed(axes: ChartAxes, whole: tuple[float, float]) -> Markup:
    (left, right), (low, high) = axes.x.span, (axes.y.at(whole[0]), axes.y.at(whole[1]))
    return Markup(
        '<path d="M{left:g} {high:.1f}H{right:g}V{low:.1f}H{left:g}Z" fill="none" stroke="var(--ink3)" '
        'stroke-width="1.3" stroke-dasharray="5 4" vector-effect="non-scaling-stroke"/>'
    ).format(left=left, right=right, low=low, high=high)


def _band(axes: ChartAxes, row: Sequence[tuple[Field, FieldFocus]], k: float, blank: frozenset[int]) -> Markup:
    """Return the range in focus, its allowance for uncertainty as a band, over the fields that have a focus."""
    known = [(axes.x.at(field.x_um / 1000), one) for field, one in row if field.number not in blank]
    if not known:
        return Markup()
    upper = [f"{x:.1f} {axes.y.at(one.high_um + k * one.u_um):.1f}" for x, one in known]
    lower = [f"{x:.1f} {axes.y.at(one.low_um - k * one.u_um):.1f}" for x, one in known]
    middle = "L".join(f"{x:.1f} {axes.y.at(one.middle_um):.1f}" for x, one in known)
    return Markup(
        '<path d="M{}Z" fill="{}" fill-opacity="{}"/>'
        '<path d="M{}" fill="none" stroke="{}" stroke-width="2" vector-effect="non-scaling-stroke"/>'
    ).format("L".join([*upper, *reversed(lower)]), _LINE, _BAND, middle, _LINE)
