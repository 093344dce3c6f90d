"""Charts of several inspections as SVG: the control chart of defect density, and all defects on one wafer map."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from markupsafe import Markup

from wafer_viewer.draw.charts.axes import Axis, ChartAxes, line_svg, round_ticks, symbol
from wafer_viewer.draw.charts.defect_charts import MOST_MARKS
from wafer_viewer.draw.charts.die_map import die_frame, die_shapes
from wafer_viewer.model.inspection.defect_classes import DEFECT_CLASSES, DefectClassEntry
from wafer_viewer.model.inspection.lot import WaferDefect, WaferDefects, WaferDensity

_LEFT_PX, _TOP_PX, _FOOT_PX, _MARK_PX = 56.0, 10.0, 26.0, 2.6
_MOST_TICKS, _HEADROOM = 5, 1.1
_DASHES = Markup('stroke-dasharray="6 4" fill="none"')
CLASS_NAMES = {look.title: look.name for look in DEFECT_CLASSES.values()}
"""Names of the built-in classes by their titles."""


def density_chart_svg(
    wafers: Sequence[WaferDensity], per_mm2: float, *, width_px: int = 560, height_px: int = 220
) -> Markup:
    """Return the u chart: a point for each wafer with a density, its control limits, and the mean."""
    known = [wafer for wafer in wafers if wafer.per_mm2 is not None]
    axes = _axes(known, per_mm2, width_px, height_px)
    half = (axes.x.at(1.0) - axes.x.at(0.0)) / 2
    mean = line_svg(axes.level(per_mm2), "ink3", 1.2)
    limits = Markup("").join(_limits(axes, k, wafer, half) for k, wafer in enumerate(known))
    course = "L".join(f"{axes.x.at(float(k)):.1f} {axes.y.at(w.per_mm2 or 0.0):.1f}" for k, w in enumerate(known))
    line = line_svg(f"M{course}", "ink3", 1.2, Markup('fill="none" opacity=".7"'))
    dots = Markup("").join(_dot(axes, k, wafer) for k, wafer in enumerate(known))
    return Markup(
        '<svg viewBox="0 0 {w} {h}" width="{w}" role="img" aria-label="Defects per mm² of each wafer" '
        'style="max-width:100%" font-size="11" fill="var(--ink3)">{grid}{labels}{mean}{limits}{line}{dots}</svg>'
    ).format(
        w=width_px,
        h=height_px,
        grid=line_svg(axes.frame(), "ink3", 0.6, Markup('fill="none" opacity=".5"')),
        labels=axes.labels_svg(),
        mean=mean,
        limits=limits,
        line=line if len(known) > 1 else Markup(),
        dots=dots,
    )


def _axes(wafers: Sequence[WaferDensity], per_mm2: float, width_px: int, height_px: int) -> ChartAxes:
    """Return the axes; every n-th wafer has its number below."""
    highest = max(max(wafer.per_mm2 or 0.0, wafer.high_per_mm2 or 0.0) for wafer in wafers)
    ends = 0.0, _HEADROOM * (highest or per_mm2 or 1.0)
    every = -(-len(wafers) // 20)
    named = tuple((float(k), f"{k + 1}") for k in range(0, len(wafers), every))
    across = Axis((-0.5, len(wafers) - 0.5), (_LEFT_PX, width_px - 8.0), named)
    return ChartAxes(across, Axis(ends, (height_px - _FOOT_PX, _TOP_PX), round_ticks(ends, _MOST_TICKS)))


def _limits(axes: ChartAxes, k: int, wafer: WaferDensity, half_px: float) -> Markup:
    """Return the steps of both control limits at a wafer."""
    left = axes.x.at(float(k)) - half_px
    steps = "".join(
        f"M{left:.1f} {axes.y.at(limit or 0.0):.1f}h{2 * half_px:.1f}"
        for limit in (wafer.low_per_mm2, wafer.high_per_mm2)
    )
    return line_svg(steps, "fault", 1.2, _DASHES)


def _dot(axes: ChartAxes, k: int, wafer: WaferDensity) -> Markup:
    x, y = axes.x.at(float(k)), axes.y.at(wafer.per_mm2 or 0.0)
    side = f", {wafer.outside} the control limits" if wafer.outside else ""
    words = f"{k + 1}: {wafer.title}, {wafer.per_mm2:.3g} per mm²{side}"
    ring = (
        Markup('<circle cx="{:.1f}" cy="{:.1f}" r="7" fill="none" stroke="var(--fault)" stroke-width="1.6"/>').format(
            x, y
        )
        if wafer.outside
        else Markup()
    )
    return Markup('<g><title>{}</title>{}<circle cx="{:.1f}" cy="{:.1f}" r="3.2" fill="#0B6E99"/></g>').format(
        words, ring, x, y
    )


def stack_map_svg(stack: WaferDefects, *, width_px: int = 420, most_height_px: int = 420) -> Markup:
    """Return all defects on the map of the dies; empty without dies. At most `MOST_MARKS` defects are drawn."""
    frame = die_frame(stack, width_px=width_px, most_height_px=most_height_px)
    if frame is None:
        return Markup()
    marks = Markup("").join(
        symbol(look.shape, look.colour, frame.x(defect.x_um), frame.y(defect.y_um), _MARK_PX)
        for defect, look in _drawn(stack.defects)
    )
    return Markup(
        '<svg viewBox="0 0 {w} {h:.0f}" width="{w}" role="img" aria-label="Defects of all wafers on one map" '
        'style="max-width:100%">{dies}{marks}</svg>'
    ).format(w=width_px, h=frame.height_px, dies=Markup(die_shapes(frame, stack, {})), marks=marks)


def _drawn(defects: Sequence[WaferDefect]) -> Iterator[tuple[WaferDefect, DefectClassEntry]]:
    """Yield evenly chosen defects with the looks of their classes."""
    every = -(-len(defects) // MOST_MARKS) or 1
    return ((defect, DEFECT_CLASSES[CLASS_NAMES.get(defect.kind, defect.kind)]) for defect in defects[::every])
