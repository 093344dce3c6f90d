"""What the measuring panel says of a result: the answer in large type, where it comes from, its budget. Pure."""

from __future__ import annotations

import math

from wafer_viewer.draw.colours import PROFILE_COLOURS
from wafer_viewer.draw.numbers import number, share, value_and_u, with_unit
from wafer_viewer.gui import html
from wafer_viewer.model.findings import AnyFinding, Defect, Flatness, GaugeCheck, Length, Profile, StepHeight

REGION_COLOUR = "#15202B"
OTHER_COLOUR = "#5B6B7A"
NO_U = {"not evaluated": "U not evaluated", "uncalibrated": "uncalibrated"}
_SURFACES = {
    "unsmoothed": "measured heights, unsmoothed",
    "smoothed": "smoothed heights",
    "filled": "filled heights too",
}


def main_length(finding: AnyFinding) -> Length:
    """The length that stands for a result."""
    match finding:
        case Profile():
            return finding.pt
        case StepHeight():
            return finding.height
        case Flatness():
            return finding.flt_t
        case GaugeCheck():
            return finding.step.height
        case Defect():
            return finding.height


def letter(finding: AnyFinding) -> str:
    """The sign of a result, P1, S2."""
    kind = {"profile": "P", "step_height": "S", "flatness": "F", "gauge_check": "G", "defect": "D"}
    return f"{kind[finding.__struct_config__.tag]}{finding.number or ''}"  # pyright: ignore[reportArgumentType]


def sign_colour(finding: AnyFinding) -> str:
    """Its colour, the same in list, curve and scene."""
    if isinstance(finding, Profile):
        return PROFILE_COLOURS[0]
    return REGION_COLOUR if isinstance(finding, StepHeight) else OTHER_COLOUR


def length_text(finding: AnyFinding) -> str:
    """Value and uncertainty for the list, as HTML."""
    length = main_length(finding)
    value, u = value_and_u(length.value_um, length.expanded_um)
    beside = f"± {u}" if length.expanded_um is not None else NO_U.get(length.status, "")
    return f"<b>{value}</b><small>{html.safe(beside)}</small>"


def answer(name: str, length: Length, signed: bool = False) -> str:
    """The card with the answer in large type."""
    value, u = value_and_u(length.value_um, length.expanded_um, signed=signed)
    if length.expanded_um is not None:
        below = f'± {html.safe(u)} µm <span class="dim" style="font-size:13px">expanded, k = 2</span>'
    else:
        below = f'<span style="color:var(--attention)">{NO_U.get(length.status, "U not evaluated")}</span>'
    return (
        f'<div class="wv-answer"><div class="wv-lab">{html.safe(name)}</div>'
        f'<div class="wv-big" style="font-size:40px">{value}<span class="wv-unit"> µm</span></div>'
        f'<div style="font-size:17px;color:var(--ink2);font-weight:500">{below}</div></div>'
    )


def source(finding: AnyFinding) -> str:
    """Where a result comes from: its regions, its points, the surface it was measured on."""
    match finding:
        case StepHeight():
            rows = [
                _region("Upper region", finding.upper_mean_um, finding.upper_sq_um, finding.upper_points),
                _region("Lower region", finding.lower_mean_um, finding.lower_sq_um, finding.lower_points),
            ]
            tilt = html.pairs([("Relative tilt", with_unit(finding.relative_tilt_mrad, 2, "mrad"))])
            table = html.table(["Region", "Mean", "Sq", "Points"], rows, " nnn")
            body = table + tilt + _small([f"Height: {finding.definition.rstrip('.')}."])
        case Profile():
            body = html.pairs(
                [
                    ("Length", with_unit(finding.length_um, 1)),
                    ("Averaged over", averaging(finding)),
                    ("Rise, first to last point", with_unit(finding.rise.value_um, 2, signed=True)),
                    ("Angle", with_unit(_angle(finding), 2, "°", signed=True)),
                    ("Measured", share(finding.measured_fraction)),
                ]
            )
        case _:
            body = ""
    return html.head("Where it comes from", "µm") + body + _measured_on(finding)


def averaging(profile: Profile) -> str:
    """How wide a strip across the line is averaged over."""
    return with_unit(profile.line.width_um, 1) if profile.line.width_um else "one pixel"


def budget(length: Length) -> str:
    """Every contribution, then the combined and the expanded uncertainty."""
    if not length.budget or length.expanded_um is None:
        why = "A calibration of the rig gives it one." if length.status == "uncalibrated" else ""
        word = NO_U.get(length.status, "U not evaluated")
        return html.head("Uncertainty") + html.empty(f"{word[0].upper()}{word[1:]}.", why)
    rows = [html.row([html.safe(c.name[:1].upper() + c.name[1:]), number(c.u_um, 3)], " n") for c in length.budget]
    combined = math.sqrt(sum(c.u_um**2 for c in length.budget))
    total = f"{number(combined, 3)} · {number(length.expanded_um, 3)}"
    rows.append(html.row(["Combined · expanded, k = 2", total], " n", look="strong"))
    return html.head("Uncertainty", "µm, k = 1") + html.table([], rows, " n")


def _region(name: str, mean_um: float, sq_um: float, points: int) -> str:
    return html.row([name, number(mean_um, 2, signed=True), number(sq_um, 2), number(points, 0)], " nnn")


def _angle(profile: Profile) -> float:
    return math.degrees(math.atan2(profile.rise.value_um, profile.length_um)) if profile.length_um else math.nan


def _measured_on(finding: AnyFinding) -> str:
    lines = [f"On the {_SURFACES[finding.surface]}, filter: {finding.filter}."]
    if finding.simulated:
        lines.append("SIMULATED: not a measurement of a real sample.")
    lines.extend(finding.notes)
    return _small(lines)


def _small(lines: list[str]) -> str:
    return "".join(f'<div class="wv-lab" style="margin-top:4px">{html.safe(html.micro(line))}</div>' for line in lines)
