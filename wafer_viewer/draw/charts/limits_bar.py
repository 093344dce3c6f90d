"""Small drawings of a table, SVG: a value with its U between the limits that it is judged by, and a share."""

from __future__ import annotations

from markupsafe import Markup

from wafer_viewer.draw.charts.axes import Axis
from wafer_viewer.model.measurement.feature import Feature
from wafer_viewer.model.quantity import Quantity, Word

GOOD, DOUBTFUL, RAIL, INK = "#BFE3CC", "#FCE3B6", "#DCE3EA", "#15202B"
DOTS: dict[Word, str] = {"pass": "#18794E", "fail": "#B42318", "inconclusive": "#8A5300", "no verdict": "#66768A"}
_WIDE_PX, _HIGH_PX = 150, 18
_BEYOND = 0.25
"""Room beside the limits, as a share of their distance."""


SHARE, _SHARE_PX = "#0B6E99", (64, 8)


def share_bar_svg(share: float) -> Markup:
    """Return a share of 1 as a bar."""
    shape = (
        '<svg width="{0}" height="{1}" viewBox="0 0 {0} {1}" aria-hidden="true">'
        '<rect width="{0}" height="{1}" rx="2" fill="{2}"/><rect width="{3:.1f}" height="{1}" rx="2" fill="{4}"/></svg>'
    )
    return Markup(shape).format(*_SHARE_PX, RAIL, share * _SHARE_PX[0], SHARE)


def limits_bar_svg(feature: Feature, quantity: Quantity | None, word: Word) -> Markup:
    """Return limits as uprights; green where a value conforms, amber where its U would reach a limit."""
    low, high = feature.lower_limit, feature.upper_limit
    if quantity is None or (low is None and high is None):
        return Markup()
    u = quantity.expanded or 0.0
    taken_off = u if feature.decision_rule == "guard_band" else 0.0
    given = [value for value in (low, high) if value is not None]
    reach = (max(given) - min(given)) or max(abs(quantity.value - given[0]) + u, 1e-12)
    axis = Axis((min(given) - _BEYOND * reach, max(given) + _BEYOND * reach), (1, _WIDE_PX - 1))
    first, last = (axis.ends[0] if low is None else low), (axis.ends[1] if high is None else high)
    inner = (first if low is None else low + taken_off), (last if high is None else high - taken_off)
    middle = _HIGH_PX / 2

    def bar(start: float, stop: float, colour: str) -> Markup:
        x0, x1 = axis.at(axis.within(start)), axis.at(axis.within(stop))
        shape = '<rect x="{:.1f}" y="{:g}" width="{:.1f}" height="6" fill="{}"/>'
        return Markup(shape).format(x0, middle - 3, max(x1 - x0, 0), colour)

    ends = [axis.at(axis.within(quantity.value + side * u)) for side in (-1, 1)]
    uprights = "".join(f"M{axis.at(value):.1f} 2V{_HIGH_PX - 2}" for value in given)
    whisker = f"M{ends[0]:.1f} {middle:g}H{ends[1]:.1f}" + "".join(f"M{x:.1f} {middle - 4:g}v8" for x in ends)
    return Markup(
        '<svg width="{0}" height="{1}" viewBox="0 0 {0} {1}" aria-hidden="true">'
        "{2}{3}{4}"
        '<path d="{5}" stroke="{7}" stroke-width="1.6" fill="none"/>'
        '<path d="{6}" stroke="{7}" stroke-width="1.3" fill="none"/>'
        '<circle cx="{8:.1f}" cy="{9:g}" r="3.6" fill="{10}"/></svg>'
    ).format(
        _WIDE_PX,
        _HIGH_PX,
        bar(*axis.ends, RAIL),
        bar(first, last, DOUBTFUL),
        bar(*inner, GOOD),
        uprights,
        whisker,
        INK,
        axis.at(axis.within(quantity.value)),
        middle,
        DOTS[word],
    )
