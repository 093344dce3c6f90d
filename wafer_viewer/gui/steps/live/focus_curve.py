"""Focus score over z below the live picture, with the range to scan."""

from __future__ import annotations

from markupsafe import Markup

from wafer_viewer.draw.charts.axes import ChartAxes, PlotLook, line_svg, plot_html, round_ticks
from wafer_viewer.draw.number_format import number, with_unit
from wafer_viewer.gui.elements.elements import Elements, Html
from wafer_viewer.gui.elements.step import Here, Picks
from wafer_viewer.session.acquisition.live_controller import LiveLook
from wafer_viewer.session.state.instrument_state import LiveState
from wafer_viewer.session.state.snapshot import Snapshot

LEAST_SPAN_UM = 60.0
"""Least extent of the z axis."""
EDGE_SHARE = 0.08
ROUND_UM = 10.0
"""The ends of the axis are multiples, so that it does not creep with every frame."""
GAP_UM = 12.0
"""Distance of two scored positions beyond which the curve is interrupted: nothing was seen between them."""
AxisEnds = tuple[float, float]
FIRST_ENDS_UM: AxisEnds = (-LEAST_SPAN_UM / 2, LEAST_SPAN_UM / 2)
_Y_TICKS = ((0.0, "0"), (0.5, "50"), (1.0, "100"))


def live_dock(here: Here[AxisEnds]) -> Elements:
    """Return the curve of the scores at this place, with grips for the lowest and the highest z to scan."""
    snapshot, look = here.snapshot, here.page.session.live.look()
    ends_um = axis_ends_um(look, snapshot.live, snapshot.rig.z_um)
    low_um, high_um = here.own
    roomy = high_um - low_um > 3 * (ends_um[1] - ends_um[0])
    if ends_um[0] < low_um or ends_um[1] > high_um or roomy:
        here.own = ends_um
    plot = Markup('<div class="wv-below">{}{}</div>').format(_head(snapshot), curve_html(look, snapshot, here.own))
    return [Html(plot), Html(grips_html(snapshot.live, here.own))]


def _set_end(here: Here[AxisEnds], key: str) -> None:
    end, z_um = key.split(":")
    name = "lowest" if end == "lowest" else "highest"
    here.page.ask("The range was not changed", here.page.session.live.mark_end(name, round(float(z_um), 1)))


CURVE_PICKS: Picks[AxisEnds] = {"live-range": _set_end}
"""What the grips do."""


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
    best_um = look.trace.best_um if best is not None and best[1] > 0 else None
    drawn, words = _range_area(axes, snapshot.live), [_label(axes, here_um, "ink", "here", 0, best_um)]
    if best is not None and best[1] > 0:
        drawn += _curve(axes, points, best[1])
        if best_um is not None:
            drawn += line_svg(axes.upright(axes.x.within(best_um)), "good", 1.6, Markup('stroke-dasharray="5 4"'))
            text = f"best {number(best_um, 1, signed=True)}"
            words.append(_label(axes, best_um, "good", text, 1, here_um))
    drawn += line_svg(axes.upright(axes.x.within(here_um)), "ink", 1.8)
    if len(points) < 2:
        words.append(Markup('<b class="wv-live-unseen">Move in z, or go to focus: the curve is drawn as you move</b>'))
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


NEAR_PERCENT, LABEL_PERCENT = 18.0, 12.0
"""Labels of lines nearer than the first lie on their outer sides, except within the second of the start of the axis."""


def _label(axes: ChartAxes, z_um: float, colour: str, text: str, row: int, other_um: float | None) -> Markup:
    """Return a label beside its line, not across the other one; `row`: 0 at the top, 1 below it."""
    percent = axes.x.percent(axes.x.within(z_um))
    above = 0.0 if other_um is None else axes.x.percent(axes.x.within(other_um)) - percent
    before = percent > 80 or (percent > LABEL_PERCENT and 0 < above < NEAR_PERCENT)
    side = f"right:calc({100 - percent:.2f}% + 6px)" if before else f"left:calc({percent:.2f}% + 6px)"
    return Markup('<b style="{};top:{}px;color:var(--{})">{}</b>').format(side, 16 * row, colour, text)


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
