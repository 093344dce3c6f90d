"""HTML of steps and grooves, and of the contributions missing in a budget."""

from __future__ import annotations

from wafer_viewer.draw.charts.groove_svg import groove_svg
from wafer_viewer.draw.number_format import number, share, with_unit
from wafer_viewer.gui.presenters.measurement import averaging, format_quantity
from wafer_viewer.gui.widgets import html
from wafer_viewer.model.findings import AnyResult
from wafer_viewer.model.measurement.step import StepHeight, StepProfile


def step(finding: StepHeight) -> str:
    """Return both faces, their relative tilt, the step at the joint, and the definition of h."""
    rows = [
        _face(_named("Upper", finding.also_upper), finding.upper_mean_um, finding.upper_sq_um, finding.upper_points),
        _face(_named("Lower", finding.also_lower), finding.lower_mean_um, finding.lower_sq_um, finding.lower_points),
    ]
    pairs = [("Relative tilt", _tilt(finding))]
    if finding.at_joint is not None:
        pairs.append(("Step at the joint", format_quantity(finding.at_joint.quantity)))
    return html.table(["Face", "Mean", "Sq", "Points"], rows, " nnn") + html.pairs(pairs) + _small(finding.definition)


def groove(finding: StepProfile) -> str:
    """Return the drawing, width and zones of a groove, and the definition of its height."""
    width = [("Width", format_quantity(finding.width.quantity))] if finding.width is not None else []
    zones = [(f"Zone {name}", f"{number(start, 1)} – {number(end, 1)}") for name, start, end in finding.zones]
    pairs = [
        ("What the line crosses", finding.kind),
        *width,
        *zones,
        ("Averaged over", averaging(finding)),
        ("Sq from the fit", number(finding.sq_um, 2)),
        ("Samples", number(finding.points, 0)),
        ("Measured", share(finding.measured_fraction)),
    ]
    return groove_svg(finding) + html.pairs(pairs) + _small(finding.definition)


def not_evaluated(finding: AnyResult) -> str:
    """Return the contributions that are not evaluated, hence not in the budget; empty if there are none."""
    missing: tuple[str, ...] = getattr(finding, "not_evaluated", ())
    return _small(f"Not evaluated: {', '.join(missing)}.") if missing else ""


def _tilt(finding: StepHeight) -> str:
    if finding.tilt is not None:
        return format_quantity(finding.tilt)
    return with_unit(finding.relative_tilt_mrad, 2, "mrad")


def _named(face: str, others: tuple[object, ...]) -> str:
    return f"{face}, {1 + len(others)} regions" if others else face


def _face(name: str, mean_um: float, sq_um: float, points: int) -> str:
    return html.row([name, number(mean_um, 2, signed=True), number(sq_um, 2), number(points, 0)], " nnn")


def _small(line: str) -> str:
    return f'<div class="wv-lab" style="margin-top:4px">{html.safe(html.with_micro_sign(line))}</div>'
