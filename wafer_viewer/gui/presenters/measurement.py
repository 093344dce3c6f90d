"""HTML of measured quantities: symbol, value with U and unit, and the parameters of each kind of result."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

from markupsafe import Markup

from wafer_viewer.draw.charts.die_map import site_map_svg, spread_um
from wafer_viewer.draw.charts.profile_plot import groove_svg
from wafer_viewer.draw.colormaps import PROFILE_COLOURS, css_gradient
from wafer_viewer.draw.number_format import THIN, digits_of_u, number, share, with_unit
from wafer_viewer.draw.quantities import (
    NO_U,
    display_unit,
    place_text,
    row_text,
    short_text,
    value_texts,
    with_unit_sign,
)
from wafer_viewer.gui.presenters.gauge import stored_check
from wafer_viewer.gui.widgets import html
from wafer_viewer.model.findings import AnyResult
from wafer_viewer.model.gauge import GaugeCheck
from wafer_viewer.model.inspection.defect import Defect
from wafer_viewer.model.inspection.defect_classes import DEFECT_CLASSES
from wafer_viewer.model.measurement.measurements import (
    AreaVolume,
    Chipping,
    Coplanarity,
    FaceAngle,
    Profile,
    Roughness,
    Site,
    SiteRanges,
    StepHeight,
    StepProfile,
)
from wafer_viewer.model.measurement.result_rows import Row, rows
from wafer_viewer.model.measurement.sections import LETTERS, Gap, Section
from wafer_viewer.model.measurement.tool_options import LevelBy
from wafer_viewer.model.measurement.tools import TOOL_OF_RESULT
from wafer_viewer.model.quantity import Quantity
from wafer_viewer.model.region import Point
from wafer_viewer.model.surface.height_map import LAYER_TITLES

# ---------------------------------------------------------------------------------------------------------- measurement


REGION_COLOUR = "#15202B"
OTHER_COLOUR = "#5B6B7A"
_OTHER_LETTERS: dict[type[AnyResult], str] = {GaugeCheck: "G", Defect: "D"}
"""Symbols of results that no tool makes."""


def symbol(finding: AnyResult) -> str:
    """Return the symbol of a result: P1, S2."""
    tool = TOOL_OF_RESULT.get(type(finding))
    letter = tool.symbol if tool is not None else _OTHER_LETTERS[type(finding)]
    return f"{letter}{finding.number or ''}"


def sign_colour(finding: AnyResult) -> str:
    """Return the colour of a result's symbol, the same in list, curve and scene."""
    if isinstance(finding, Profile):
        return PROFILE_COLOURS[0]
    if isinstance(finding, Defect):
        return DEFECT_CLASSES[finding.seen_as].colour
    return OTHER_COLOUR if isinstance(finding, GaugeCheck) else REGION_COLOUR


def main_label(finding: AnyResult) -> str:
    """Return the label of a result's main quantity; empty if the tool's name tells it."""
    if isinstance(finding, AreaVolume):
        return "below" if finding.main_field == "volume_below" else "above"
    tool = TOOL_OF_RESULT.get(type(finding))
    return tool.main if tool is not None else "error" if isinstance(finding, GaugeCheck) else ""


def list_text(finding: AnyResult) -> Markup:
    """Return value, uncertainty and unit for the list, as HTML."""
    value, u, unit = value_texts(finding.main, signed=_is_signed(finding))
    uncertainty = f"± {u}" if finding.main.expanded is not None else NO_U.get(finding.main.status, "")
    return Markup("<b>{}</b>{}<small>{}</small>").format(value, with_unit_sign("", unit), uncertainty)


def answer(name: str, quantity: Quantity, signed: bool = False, doubt: str = "") -> Markup:
    """Return the card with a quantity in large type; in small grey type with a doubt, which is told instead of U."""
    value, u, unit = value_texts(quantity, signed=signed)
    if doubt:
        below = Markup('<span style="font-size:13px;color:var(--attention)">{}</span>').format(doubt)
    elif quantity.expanded is not None:
        uncertainty = with_unit_sign(f"± {u}", unit)
        below = Markup('{} <span class="dim" style="font-size:13px">expanded, {}</span>').format(
            uncertainty, quantity.k_text
        )
    else:
        below = Markup('<span style="color:var(--attention)">{}</span>').format(
            NO_U.get(quantity.status, "U not evaluated")
        )
    return Markup(
        '<div class="wv-answer"><div class="wv-lab">{name}</div>'
        '<div class="wv-big" style="{look}">{value}<span class="wv-unit"> {unit}</span></div>'
        '<div style="font-size:17px;color:var(--ink2);font-weight:500">{below}</div></div>'
    ).format(name=name, value=value, unit=unit, below=below, look=_DOUBTFUL if doubt else "font-size:40px")


def card(finding: AnyResult, name: str) -> Markup:
    """Return the card with a result's main quantity."""
    named = " · ".join(part for part in (name, main_label(finding)) if part)
    return answer(named, finding.main, _is_signed(finding), _doubt(finding))


def _doubt(finding: AnyResult) -> str:
    """Return why a step is hardly one between two level faces; empty for others."""
    if not isinstance(finding, StepHeight):
        return ""
    if finding.height.value_um < 0:
        return "The upper region lies below the lower one: drag them, or exchange them."
    if max(finding.upper_sq_um, finding.lower_sq_um) > ROUGH * finding.height.value_um:
        return "A face is rougher than a tenth of the height. The regions lie across an edge: drag them."
    return ""


def budget(quantity: Quantity) -> Markup:
    """Return the uncertainty budget: contributions, then combined and expanded uncertainty."""
    if not quantity.budget or quantity.expanded is None:
        why = "A calibration of the rig gives it one." if quantity.status == "uncalibrated" else ""
        word = NO_U.get(quantity.status, "U not evaluated")
        return html.head("Uncertainty") + html.empty(f"{word[0].upper()}{word[1:]}.", why)
    read = display_unit(quantity)
    digits = max(3, digits_of_u(quantity.expanded * read.factor) + 1)
    lines = [(line.name[:1].upper() + line.name[1:], line.u * read.factor) for line in quantity.budget]
    table = [html.row([name, number(u, digits)], " n") for name, u in lines]
    combined = math.sqrt(sum(u**2 for _, u in lines))
    total = f"{number(combined, digits)} · {number(quantity.k * combined, digits)}"
    table.append(html.row([f"Combined · expanded, {quantity.k_text}", total], " n", look="strong"))
    return html.head("Uncertainty", f"{read.unit}, k = 1") + html.table([], table, " n")


def averaging(profile: Profile | StepProfile) -> str:
    """Format the averaging width across the line."""
    return with_unit(profile.line.width_um, 1) if profile.line.width_um else "one pixel"


def _is_signed(finding: AnyResult) -> bool:
    tool = TOOL_OF_RESULT.get(type(finding))
    return tool.signed if tool is not None else True


ROUGH = 0.1
"""Largest Sq of a face of a step, as a fraction of its height."""
_DOUBTFUL = "font-size:24px;color:var(--ink3)"
LISTED, MOST_SITES_LISTED = 8, 12
"""Number of chips or bumps listed, the worst first; of sites listed, the largest ranges first."""
COLUMNS = 3
"""Grouped numbers side by side."""
LONGEST_CELL = 40
"""Letters of a text that stands beside its label; a longer one stands below."""


def numbers(finding: AnyResult) -> Markup:
    """Return all numbers of a result but the main one: what its kind draws, rows, groups and sentences."""
    draw, drawn = _DRAWINGS.get(type(finding), (None, frozenset()))
    given = [row for row in rows(finding, drawn | {finding.main_field}) if not row.has_settings]
    texts = [(row, row_text(row)) for row in given if not row.label.group]
    pairs = [(row.label.title, text) for row, text in texts if len(text) <= LONGEST_CELL]
    sentences = [text for _, text in texts if len(text) > LONGEST_CELL]
    below = Markup("").join(small(text) for text in sentences)
    drawing = draw(finding) if draw is not None else Markup()
    return _grouped(rows(finding)) + drawing + html.pairs(pairs) + below


def chips(finding: Chipping) -> Markup:
    """Return a table of the worst chips."""
    if not finding.chips:
        return Markup()
    cells = (
        [place_text(chip.place), number(chip.depth_um), number(chip.length_um, 1), number(chip.area_um2, 1)]
        for chip in finding.chips[:LISTED]
    )
    lines = [html.row(chip, " nnn") for chip in cells]
    return html.table(["Chip at x, y", "Depth", "Length", "Area"], lines, " nnn") + _more(finding.n_chips)


def bumps(finding: Coplanarity) -> Markup:
    """Return a table of the bumps furthest from the plane."""
    cells = (
        [
            place_text(bump.place),
            number(bump.deviation.value_um, 2, signed=True),
            number(bump.height.value_um),
            number(bump.diameter_um, 1),
        ]
        for bump in finding.bumps[:LISTED]
    )
    lines = [html.row(bump, " nnn") for bump in cells]
    return html.table(["Bump at x, y", "Off plane", "Height", "Diameter"], lines, " nnn") + _more(finding.n_bumps)


def _more(count: int) -> Markup:
    return small(f"The worst {LISTED} of {count}; all are in the exported table.") if count > LISTED else Markup()


def sites(ranges: SiteRanges) -> Markup:
    """Return the map with its colour scale, and the table of the largest ranges."""
    measured = [site for site in ranges.sites if site.range is not None]
    missing = len(ranges.sites) - len(measured)
    without = html.pairs([("Without a range", f"{missing} of {len(ranges.sites)}")]) if missing else Markup()
    return site_map_svg(ranges) + _scale(ranges) + without + _largest(measured)


def _scale(ranges: SiteRanges) -> Markup:
    low, high = (f"{number(um, 2)}{THIN}µm" for um in spread_um(ranges))
    gradient = css_gradient("mako").replace("to top", "to right")
    return Markup(
        '<div class="wv-site-scale"><span>{}</span><i style="background:{}"></i><span>{}</span></div>'
    ).format(low, gradient, high)


def _largest(measured: list[Site]) -> Markup:
    largest = sorted(measured, key=lambda site: -(site.range.value_um if site.range else 0.0))[:MOST_SITES_LISTED]
    more = f"the largest {len(largest)} of {len(measured)}" if len(largest) < len(measured) else ""
    lines = [
        html.row(
            [
                place_text(Point(x_um=site.x_um, y_um=site.y_um)),
                share(site.measured_fraction),
                number(site.range.value_um, 3) if site.range is not None else "",
            ],
            " nn",
        )
        for site in largest
    ]
    return html.head("Range of each site", more) + html.table(["Middle x, y", "Measured", "Range"], lines, " nn")


def faces(finding: StepHeight) -> Markup:
    """Return the table of both faces of a step."""
    upper = finding.upper_mean_um, finding.upper_sq_um, finding.upper_points
    lower = finding.lower_mean_um, finding.lower_sq_um, finding.lower_points
    lines = [
        _face(_named("Upper", finding.also_upper), *upper),
        _face(_named("Lower", finding.also_lower), *lower),
    ]
    return html.table(["Face", "Mean", "Sq", "Points"], lines, " nnn")


def _named(face: str, others: tuple[object, ...]) -> str:
    return f"{face}, {1 + len(others)} regions" if others else face


def _face(name: str, mean_um: float, sq_um: float, points: int) -> Markup:
    return html.row([name, number(mean_um, 2, signed=True), number(sq_um, 2), number(points, 0)], " nnn")


def tilted_faces(finding: FaceAngle) -> Markup:
    """Return the table of the two faces of an angle."""
    given = (
        ("First face", finding.first_tilt_deg, finding.first_sq_um, finding.first_points),
        ("Second face", finding.second_tilt_deg, finding.second_sq_um, finding.second_points),
    )
    lines = [html.row([name, number(tilt, 2), number(sq, 2), number(n, 0)], " nnn") for name, tilt, sq, n in given]
    return html.table(["Face", "Tilt, °", "Sq", "Points"], lines, " nnn")


def volume(finding: AreaVolume) -> Markup:
    """Return the plane that the volume lies above and below, and the heights that count for neither."""
    plane = "the plane through the region's border" if finding.reference == "border" else "the zero of heights"
    noise = f"Within {with_unit(finding.noise_um, 2)} of it a height counts neither as above nor as below."
    return small(f"Above and below {plane}.") + small(noise)


def sampling(finding: Roughness) -> Markup:
    """Return the number of sampling lengths, and the length of each."""
    return html.pairs([("Sampling lengths", f"{finding.sections} × {with_unit(finding.section_um, 1)}")])


def groove(finding: StepProfile) -> Markup:
    """Return the drawing of a groove, and its zones."""
    zones = [(f"Zone {name}", f"{number(start, 1)} – {number(end, 1)}") for name, start, end in finding.zones]
    return groove_svg(finding) + html.pairs([*zones, ("Averaged over", averaging(finding))])


def profile(finding: Profile) -> Markup:
    """Return the averaging width of a profile, and the angle from its first to its last point."""
    flat = finding.length_um == 0
    angle = math.nan if flat else math.degrees(math.atan2(finding.rise.value_um, finding.length_um))
    return html.pairs([("Averaged over", averaging(finding)), ("Angle", with_unit(angle, 2, "°", signed=True))])


def _fields(kind: type[AnyResult], ending: str) -> frozenset[str]:
    return frozenset(name for name in kind.__struct_fields__ if name.endswith(ending))


_Drawing = tuple[Callable[[Any], Markup], frozenset[str]]
_DRAWINGS: dict[type[AnyResult], _Drawing] = {
    Profile: (profile, frozenset()),
    StepHeight: (
        faces,
        frozenset({"relative_tilt_mrad"}).union(
            *(_fields(StepHeight, end) for end in ("_mean_um", "_sq_um", "_points"))
        ),
    ),
    StepProfile: (groove, frozenset({"edges_um"})),
    FaceAngle: (
        tilted_faces,
        frozenset().union(*(_fields(FaceAngle, end) for end in ("_tilt_deg", "_sq_um", "_points"))),
    ),
    AreaVolume: (volume, frozenset({"reference", "noise_um"})),
    Roughness: (sampling, frozenset({"sections", "section_um"})),
    Chipping: (chips, frozenset()),
    Coplanarity: (bumps, frozenset()),
    SiteRanges: (sites, frozenset({"sites"})),
}
"""Drawings and tables of a kind of result, and the fields that they show."""


def not_evaluated(finding: AnyResult) -> Markup:
    """Return the contributions that are not evaluated, hence not in the budget; empty if there are none."""
    missing: tuple[str, ...] = getattr(finding, "not_evaluated", ())
    return small(f"Not evaluated: {', '.join(missing)}.") if missing else Markup()


def small(line: str) -> Markup:
    """Return a sentence in small type."""
    return html.remark(line, "margin-top:4px")


def _grouped(given: Sequence[Row]) -> Markup:
    """Return the rows of a group side by side, the name of the group before the first line."""
    groups = {row.label.group: None for row in given if row.label.group}
    lines: list[Markup] = []
    for group in groups:
        cells = [_cell(row) for row in given if row.label.group == group]
        for k in range(0, len(cells), COLUMNS):
            line = cells[k : k + COLUMNS]
            lines.append(html.row(["" if k else group, *line, *[""] * (COLUMNS - len(line))]))
    return html.table([], lines) if lines else Markup()


def _cell(row: Row) -> Markup:
    shown = Markup('<span class="wv-lab">{}</span> <b style="font-weight:550">{}</b>').format(
        row.label.title, short_text(row)
    )
    return Markup('<span title="{}">{}</span>').format(row.label.hint, shown)


_CROWDED = ("", "", " wv-two", " wv-many")
"""CSS class by number of lines: with many lines only the most important figures are shown."""
WAITS = "The curve appears when the line lies on the surface."


def head(
    sections: Sequence[Section], problems: Sequence[str], n_lines: int, active: int, gap: Gap | None, zoomed: bool
) -> Markup:
    """Return the row above the plot; a line without a curve keeps its symbol."""
    own = {s.asked.place: s for s in sections if not s.asked.is_second}
    lines = Markup("").join(_line(place, own.get(place), place == active) for place in range(n_lines))
    seconds = Markup("").join(_second(s) for s in sections if s.asked.is_second)
    notes = Markup("").join(
        Markup('<span class="wv-curve-note">{}</span>').format(html.typeset(text)) for text in problems
    )
    waits = Markup('<span class="dim">{}</span>').format(WAITS) if not sections and not problems else Markup()
    zoom_out = html.link("Whole line", "plot", "whole") if zoomed else Markup()
    name = "Section" if any(s.points is not None for s in own.values()) else "Profile"
    return Markup(
        '<div class="wv-dock wv-lines{crowded}"><b>{name}</b>{lines}{seconds}{notes}{waits}'
        '<span class="wv-end">{zoom_out}{cursor_readout}</span></div>'
    ).format(
        crowded=_CROWDED[min(n_lines, 3)],
        name=name,
        lines=lines,
        seconds=seconds,
        notes=notes,
        waits=waits,
        zoom_out=zoom_out,
        cursor_readout=cursor_readout(gap) if gap is not None else "",
    )


def cursor_readout(gap: Gap) -> Markup:
    """Return distance, height difference and angle between the cursors."""
    return Markup("<span>Δx <b>{}</b>&ensp;Δz <b>{}</b>&ensp;{}</span>").format(
        number(gap.dx_um, 1), with_unit(gap.dz_um, 2, signed=True), with_unit(gap.angle_deg, 2, "°")
    )


def _line(place: int, section: Section | None, active: bool) -> Markup:
    sign = html.chip(LETTERS[place], PROFILE_COLOURS[place])
    about = _numbers(section) if section is not None else ""
    look = Markup('class="wv-line{}" aria-pressed="{}"').format(" sel" if active else "", str(active).lower())
    return Markup('<span {look} aria-label="Line {aria_label}" {pick}>{sign} {about}</span>').format(
        look=look, aria_label=LETTERS[place], pick=html.pick("line", place), sign=sign, about=about
    )


def _numbers(section: Section) -> Markup:
    profile, points = section.profile, section.points
    if points is not None:
        return Markup(
            "spread about the line <b>{}</b>"
            '<span class="dim wv-roomy">68 % of {} points · '
            "{} wide · line: running median</span>"
        ).format(with_unit(points.spread_um, 2), number(len(points), 0), with_unit(points.width_um, 1))
    return Markup('Pt <b>{}</b><span class="dim wv-roomy">{} long, {} wide</span>').format(
        with_unit(profile.pt.value_um, 2), with_unit(profile.length_um, 0), averaging(profile)
    )


def _second(section: Section) -> Markup:
    name = section.asked.of.title if section.asked.of is not None else LAYER_TITLES[section.profile.surface]
    pt = with_unit(section.profile.pt.value_um, 2)
    return Markup('<span class="wv-second"><i></i>{} <span class="dim">Pt {}</span></span>').format(name, pt)


# ----------------------------------------------------------------------------------------------------------- provenance


ZERO: dict[LevelBy, str] = {
    "stage": "the stage's zero",
    "three points": "the plane through three points",
    "plane": "the plane of the whole surface",
    "region": "the plane of a region",
    "form": "the form of the whole surface",
}
"""Names of the height reference by levelling method."""


def source(finding: AnyResult) -> Markup:
    """Return the provenance of a result: regions, points, surface."""
    body = stored_check(finding) if isinstance(finding, GaugeCheck) else numbers(finding)
    return html.head("Where it comes from", "µm") + body + _measured_on(finding)


def surface_name(finding: AnyResult) -> str:
    """Return the name of the surface a result was measured on."""
    return f"field {finding.show}" if finding.show > 0 else "comparison" if finding.show < 0 else "stitched surface"


def _measured_on(finding: AnyResult) -> Markup:
    lines = [
        f"On the {surface_name(finding)}: {LAYER_TITLES[finding.surface]}, filter: {finding.filter}.",
        f"Heights are read from {ZERO[finding.levelling.by]}.",
    ]
    tool = TOOL_OF_RESULT.get(type(finding))
    if tool is not None and tool.on_picture:
        lines = [f"On the {surface_name(finding)}."]
    if finding.simulated:
        lines.append("SIMULATED: not a measurement of a real sample.")
    lines.extend(finding.notes)
    return Markup("").join(small(line) for line in lines)
