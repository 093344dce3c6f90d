"""HTML of measured quantities: symbol, value with U and unit, and the parameters of each kind of result."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from markupsafe import Markup

from wafer_viewer.draw.charts.die_map import site_map_svg, spread_um
from wafer_viewer.draw.charts.profile_plot import groove_svg
from wafer_viewer.draw.colormaps import PROFILE_COLOURS, css_gradient
from wafer_viewer.draw.number_format import NOTHING, THIN, digits_of_u, number, share, value_and_u, with_unit
from wafer_viewer.gui.widgets import html
from wafer_viewer.model.findings import AnyResult
from wafer_viewer.model.gauge import GaugeCheck
from wafer_viewer.model.inspection.defect import Defect
from wafer_viewer.model.inspection.defect_classes import DEFECT_CLASSES
from wafer_viewer.model.measurement.measurements import (
    AreaVolume,
    Chipping,
    CircleSize,
    Coplanarity,
    DieSize,
    KerfWidth,
    Profile,
    Roughness,
    Site,
    SiteRanges,
    StepHeight,
    StepProfile,
    Texture,
)
from wafer_viewer.model.measurement.sections import LETTERS, Gap, Section
from wafer_viewer.model.measurement.tools import TOOL_OF_RESULT
from wafer_viewer.model.quantity import Length, Quantity
from wafer_viewer.model.region import Point
from wafer_viewer.model.surface.height_map import LAYER_TITLES

REGION_COLOUR = "#15202B"
OTHER_COLOUR = "#5B6B7A"
NO_U = {"not evaluated": "U not evaluated", "uncalibrated": "uncalibrated"}
_OTHER_LETTERS: dict[type[AnyResult], str] = {GaugeCheck: "G", Defect: "D"}
"""Symbols of results that no tool makes."""
UNIT_SIGNS = {"um": "µm", "um2": "µm²", "um3": "µm³", "deg": "°", "mrad": "mrad"}
_LARGER = {"um2": ((1e5, 1e-6, "mm²"),), "um3": ((1e5, 1e-6, "nl"), (0.0, 1e-3, "pl"))}
"""Display units by quantity unit: (smallest value, factor, unit sign), largest first."""


@dataclass(frozen=True, slots=True)
class ReadValue:
    """Display unit of a quantity: factor from the quantity's own unit, and unit sign."""

    factor: float
    unit: str


def display_unit(quantity: Quantity) -> ReadValue:
    """Return the display unit: nl or pl for volumes, mm² for large areas, else the unit of measurement."""
    for least, factor, unit in _LARGER.get(quantity.unit, ()):
        if abs(quantity.value) >= least:
            return ReadValue(factor, unit)
    return ReadValue(1.0, UNIT_SIGNS[quantity.unit])


def value_texts(quantity: Quantity, *, signed: bool = False) -> tuple[str, str, str]:
    """Return value, U to two significant digits (a dash if there is none) and unit, as texts."""
    read = display_unit(quantity)
    expanded = None if quantity.expanded is None else quantity.expanded * read.factor
    digits = _plain_digits(quantity) if read.factor == 1 else _digits(quantity.value * read.factor)
    value, u = value_and_u(quantity.value * read.factor, expanded, digits, signed=signed)
    return value, u, read.unit


def format_quantity(quantity: Quantity, *, signed: bool = False) -> str:
    """Format value, U and unit in one line: ``11.86 ± 0.31 µm``."""
    value, u, unit = value_texts(quantity, signed=signed)
    return with_unit_sign(f"{value} ± {u}" if quantity.expanded is not None else value, unit)


def with_unit_sign(text: str, unit: str) -> str:
    """Join a number and its unit, without a space before the degree sign."""
    return f"{text}{unit}" if unit == "°" else f"{text}\u202f{unit}"


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


def answer(name: str, quantity: Quantity, signed: bool = False) -> Markup:
    """Return the card with a quantity in large type."""
    value, u, unit = value_texts(quantity, signed=signed)
    if quantity.expanded is not None:
        uncertainty = with_unit_sign(f"± {u}", unit)
        below = Markup('{} <span class="dim" style="font-size:13px">expanded, k = 2</span>').format(uncertainty)
    else:
        below = Markup('<span style="color:var(--attention)">{}</span>').format(
            NO_U.get(quantity.status, "U not evaluated")
        )
    return Markup(
        '<div class="wv-answer"><div class="wv-lab">{name}</div>'
        '<div class="wv-big" style="font-size:40px">{value}<span class="wv-unit"> {unit}</span></div>'
        '<div style="font-size:17px;color:var(--ink2);font-weight:500">{below}</div></div>'
    ).format(name=name, value=value, unit=unit, below=below)


def card(finding: AnyResult, name: str) -> Markup:
    """Return the card with a result's main quantity."""
    named = " · ".join(part for part in (name, main_label(finding)) if part)
    return answer(named, finding.main, _is_signed(finding))


def budget(quantity: Quantity) -> Markup:
    """Return the uncertainty budget: contributions, then combined and expanded uncertainty."""
    if not quantity.budget or quantity.expanded is None:
        why = "A calibration of the rig gives it one." if quantity.status == "uncalibrated" else ""
        word = NO_U.get(quantity.status, "U not evaluated")
        return html.head("Uncertainty") + html.empty(f"{word[0].upper()}{word[1:]}.", why)
    read = display_unit(quantity)
    digits = max(3, digits_of_u(quantity.expanded * read.factor) + 1)
    lines = [(line.name[:1].upper() + line.name[1:], line.u * read.factor) for line in quantity.budget]
    rows = [html.row([name, number(u, digits)], " n") for name, u in lines]
    combined = math.sqrt(sum(u**2 for _, u in lines))
    total = f"{number(combined, digits)} · {number(2 * combined, digits)}"
    rows.append(html.row(["Combined · expanded, k = 2", total], " n", look="strong"))
    return html.head("Uncertainty", f"{read.unit}, k = 1") + html.table([], rows, " n")


def averaging(profile: Profile | StepProfile) -> str:
    """Format the averaging width across the line."""
    return with_unit(profile.line.width_um, 1) if profile.line.width_um else "one pixel"


def _plain_digits(quantity: Quantity) -> int:
    """Return the decimals of a value in its own unit: 2, or up to 4 (three digits) for lengths under 1 µm."""
    small = quantity.unit == "um" and 0 < abs(quantity.value) < 1
    return min(4, max(2, _digits(quantity.value) - 1)) if small else 2


def _digits(value: float) -> int:
    """Return the decimals that show a value without U to four digits."""
    return max(0, 3 - math.floor(math.log10(abs(value)))) if value else 2


def _is_signed(finding: AnyResult) -> bool:
    tool = TOOL_OF_RESULT.get(type(finding))
    return tool.signed if tool is not None else True


LISTED = 8
"""Number of chips or bumps listed, the worst first."""


def kerf(finding: KerfWidth) -> Markup:
    """Return extreme widths, angle between the edges, and edge points of a kerf."""
    return html.pairs(
        [
            ("Narrowest", format_quantity(finding.narrowest.quantity)),
            ("Widest", format_quantity(finding.widest.quantity)),
            ("Angle between the edges", format_quantity(finding.angle)),
            ("Kerf on the picture", finding.kerf),
            ("Edge points", number(finding.points, 0)),
        ]
    )


def die(finding: DieSize) -> Markup:
    """Return size, rotation, squareness and centre of a die."""
    return html.pairs(
        [
            ("Width", format_quantity(finding.width.quantity)),
            ("Height", format_quantity(finding.height.quantity)),
            ("Rotation", format_quantity(finding.rotation, signed=True)),
            ("Squareness, angle over 90°", format_quantity(finding.squareness, signed=True)),
            ("Centre x, y", _place(finding.center)),
            ("Rim on the picture", finding.die),
            ("Edge points", number(finding.points, 0)),
        ]
    )


def circle(finding: CircleSize) -> Markup:
    """Return radius, roundness and centre of a circle."""
    return html.pairs(
        [
            ("Radius", format_quantity(finding.radius.quantity)),
            ("Roundness RONt", format_quantity(finding.roundness.quantity)),
            ("Centre x, y", _place(finding.center)),
            ("Inside on the picture", finding.inside),
            ("Edge points", number(finding.points, 0)),
        ]
    )


def chipping(finding: Chipping) -> Markup:
    """Return chip threshold, totals over all chips, and a table of the worst."""
    table = html.pairs(
        [
            ("Deeper than", with_unit(finding.limit_um)),
            ("Chips", number(finding.n_chips, 0)),
            ("Their area", format_quantity(finding.area)),
            ("Longest", format_quantity(finding.longest.quantity)),
            ("Share of the edge chipped", share(finding.chipped_fraction)),
            ("Length of the edge", with_unit(finding.edge_length_um, 1)),
            ("Die on the", f"{finding.die} side"),
        ]
    )
    if not finding.chips:
        return table
    rows = [
        html.row(
            [_place(chip.place), number(chip.depth_um), number(chip.length_um, 1), number(chip.area_um2, 1)], " nnn"
        )
        for chip in finding.chips[:LISTED]
    ]
    return table + html.table(["Chip at x, y", "Depth", "Length", "Area"], rows, " nnn") + _more(finding.n_chips)


def coplanarity(finding: Coplanarity) -> Markup:
    """Return statistics of all bumps, and a table of those furthest from the plane."""
    reference = {"least_squares": "least squares", "seating": "seating plane"}[finding.options.reference]
    table = html.pairs(
        [
            ("Plane", reference),
            ("Bumps", number(finding.n_bumps, 0)),
            *([("Left out, cut or not measured", number(finding.left_out, 0))] if finding.left_out else []),
            ("Mean height", format_quantity(finding.mean_height.quantity)),
            ("Range of heights", format_quantity(finding.height_range.quantity)),
            ("Tilt of the plane", with_unit(finding.tilt_mrad, 2, "mrad")),
        ]
    )
    rows = [
        html.row(
            [
                _place(bump.place),
                number(bump.deviation.value_um, 2, signed=True),
                number(bump.height.value_um),
                number(bump.diameter_um, 1),
            ],
            " nnn",
        )
        for bump in finding.bumps[:LISTED]
    ]
    return (
        table + html.table(["Bump at x, y", "Off plane", "Height", "Diameter"], rows, " nnn") + _more(finding.n_bumps)
    )


def _place(place: Point) -> str:
    return f"{number(place.x_um, 1)}, {number(place.y_um, 1)}"


def _more(count: int) -> Markup:
    if count <= LISTED:
        return Markup()
    text = f"The worst {LISTED} of {count}; all are in the exported table."
    return Markup('<div class="wv-lab" style="margin-top:4px">{}</div>').format(text)


MOST_ROWS = 12
"""Number of sites listed, the largest ranges first; the map shows all."""


def sites(ranges: SiteRanges) -> Markup:
    """Return the map with its colour scale, and the table of the largest ranges."""
    n, measured = len(ranges.sites), [site for site in ranges.sites if site.range is not None]
    size = f"{number(ranges.site_width_um, 1)} × {number(ranges.site_height_um, 1)}{THIN}µm"
    pairs = [("Sites, columns × rows", f"{ranges.cols} × {ranges.rows}"), ("Size of a site", size)]
    if len(measured) < n:
        pairs.append(("Without a range", f"{n - len(measured)} of {n}"))
    return html.pairs(pairs) + site_map_svg(ranges) + _scale(ranges) + _table(measured)


def _scale(ranges: SiteRanges) -> Markup:
    low, high = (f"{number(um, 2)}{THIN}µm" for um in spread_um(ranges))
    gradient = css_gradient("mako").replace("to top", "to right")
    return Markup(
        '<div class="wv-site-scale"><span>{}</span><i style="background:{}"></i><span>{}</span></div>'
    ).format(low, gradient, high)


def _table(measured: list[Site]) -> Markup:
    largest = sorted(measured, key=lambda site: -(site.range.value_um if site.range else 0.0))[:MOST_ROWS]
    more = f"the largest {len(largest)} of {len(measured)}" if len(largest) < len(measured) else ""
    return html.head("Range of each site", more) + html.table(
        ["Middle x, y", "Measured", "Range"], [_row(site) for site in largest], " nn"
    )


def _row(site: Site) -> Markup:
    where = f"{number(site.x_um, 1)}, {number(site.y_um, 1)}"
    value = number(site.range.value_um, 3) if site.range is not None else ""
    return html.row([where, share(site.measured_fraction), value], " nn")


def step(finding: StepHeight) -> Markup:
    """Return both faces, their relative tilt, the step at the joint, and the definition of h."""
    rows = [
        _face(_named("Upper", finding.also_upper), finding.upper_mean_um, finding.upper_sq_um, finding.upper_points),
        _face(_named("Lower", finding.also_lower), finding.lower_mean_um, finding.lower_sq_um, finding.lower_points),
    ]
    pairs = [("Relative tilt", _tilt(finding))]
    if finding.at_joint is not None:
        pairs.append(("Step at the joint", format_quantity(finding.at_joint.quantity)))
    return html.table(["Face", "Mean", "Sq", "Points"], rows, " nnn") + html.pairs(pairs) + _small(finding.definition)


def groove(finding: StepProfile) -> Markup:
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


def not_evaluated(finding: AnyResult) -> Markup:
    """Return the contributions that are not evaluated, hence not in the budget; empty if there are none."""
    missing: tuple[str, ...] = getattr(finding, "not_evaluated", ())
    return _small(f"Not evaluated: {', '.join(missing)}.") if missing else Markup()


def _tilt(finding: StepHeight) -> str:
    if finding.tilt is not None:
        return format_quantity(finding.tilt)
    return with_unit(finding.relative_tilt_mrad, 2, "mrad")


def _named(face: str, others: tuple[object, ...]) -> str:
    return f"{face}, {1 + len(others)} regions" if others else face


def _face(name: str, mean_um: float, sq_um: float, points: int) -> Markup:
    return html.row([name, number(mean_um, 2, signed=True), number(sq_um, 2), number(points, 0)], " nnn")


def _small(line: str) -> Markup:
    return Markup('<div class="wv-lab" style="margin-top:4px">{}</div>').format(html.with_micro_sign(line))


Cells = Sequence[tuple[str, str]]
COLUMNS = 3
FIGURES, MOST_DECIMALS = 3, 4
"""Significant digits of a texture height, and the largest number of decimals."""

MEANINGS = {
    "Sa": "Arithmetical mean height",
    "Sq": "Root mean square height",
    "Sz": "Highest peak over lowest pit",
    "Sp": "Highest peak over the mean",
    "Sv": "Lowest pit under the mean",
    "Ssk": "Skewness: over 0 peaks, under 0 valleys prevail",
    "Sku": "Kurtosis: 3 for normal heights",
    "Sdq": "Root mean square slope",
    "Sdr": "How much larger the surface is than its projection",
    "Sk": "Height of the core",
    "Spk": "Reduced height of the peaks over the core",
    "Svk": "Reduced depth of the valleys under the core",
    "Smr1": "Material ratio where peaks end",
    "Smr2": "Material ratio where valleys begin",
    "Sal": "Autocorrelation length: the shortest distance at which heights no longer correlate",
    "Str": "Texture aspect ratio: near 1 isotropic, near 0 with a lay",
    "Std": "Texture direction, across the lay, counter-clockwise from x",
    "Ra": "Arithmetical mean height of the whole evaluation length",
    "Rq": "Root mean square height of the whole evaluation length",
    "Rt": "Highest over lowest of the whole evaluation length",
    "Rsk": "Skewness: over 0 peaks, under 0 valleys prevail",
    "Rku": "Kurtosis: 3 for normal heights",
    "Rz": "Highest over lowest, mean of the sections",
    "Rp": "Highest peak, mean of the sections",
    "Rv": "Lowest pit, mean of the sections",
}
"""Tooltips of the parameters."""


def texture(finding: Texture) -> Markup:
    """Return all texture parameters by family, and the measured fraction."""
    families: list[tuple[str, Cells]] = [
        ("Height", (("Sa", _um(finding.sa)), ("Sq", _um(finding.sq)), ("Sz", _um(finding.sz)))),
        ("", (("Sp", _um(finding.sp)), ("Sv", _um(finding.sv)))),
        ("", (("Ssk", number(finding.ssk, 2, signed=True)), ("Sku", number(finding.sku, 2)))),
        ("Hybrid", (("Sdq", figures(finding.sdq)), ("Sdr", _percent(finding.sdr_fraction)))),
        ("Functional", (("Sk", _um(finding.sk)), ("Spk", _um(finding.spk)), ("Svk", _um(finding.svk)))),
        ("", (("Smr1", _percent(finding.smr1_fraction)), ("Smr2", _percent(finding.smr2_fraction)))),
        ("Spatial", (("Sal", _um(finding.sal)), ("Str", number(finding.str_ratio, 2)), ("Std", _std(finding)))),
    ]
    return _family_table(families) + _measured(finding)


def roughness(finding: Roughness) -> Markup:
    """Return all roughness parameters, the sampling lengths, and the measured fraction."""
    families: list[tuple[str, Cells]] = [
        ("Evaluation", (("Ra", _um(finding.ra)), ("Rq", _um(finding.rq)), ("Rt", _um(finding.rt)))),
        ("", (("Rsk", number(finding.rsk, 2, signed=True)), ("Rku", number(finding.rku, 2)))),
        ("Sections", (("Rz", _um(finding.rz)), ("Rp", _um(finding.rp)), ("Rv", _um(finding.rv)))),
    ]
    each = f"{finding.sections} × {with_unit(finding.section_um, 1)}"
    return _family_table(families) + _measured(finding, ("Sampling lengths", each))


def figures(value: float | None) -> str:
    """Format a number to three significant digits, with at most four decimals."""
    if value is None or not math.isfinite(value) or value == 0:
        return number(value, 2)
    digits = FIGURES - 1 - math.floor(math.log10(abs(value)))
    return number(value, min(MOST_DECIMALS, max(0, digits)))


def _family_table(families: Sequence[tuple[str, Cells]]) -> Markup:
    rows = [html.row([family, *_padded(cells)]) for family, cells in families]
    return html.table([], rows)


def _padded(cells: Cells) -> list[str]:
    """Return the cells of a row, padded to `COLUMNS` so that all row lines have one length."""
    return [*(_cell(*cell) for cell in cells), *[""] * (COLUMNS - len(cells))]


def _cell(name: str, value: str) -> Markup:
    shown = Markup('<span class="wv-lab">{}</span> <b style="font-weight:550">{}</b>').format(name, value)
    return Markup('<span title="{}">{}</span>').format(MEANINGS.get(name, ""), shown)


def _measured(finding: Texture | Roughness, *more: tuple[str, str]) -> Markup:
    return html.pairs([*more, ("Points", number(finding.points, 0)), ("Measured", share(finding.measured_fraction))])


def _um(length: Length | None) -> str:
    return NOTHING if length is None else figures(length.value_um)


def _percent(fraction: float | None) -> str:
    return NOTHING if fraction is None else f"{figures(100 * fraction)}\u202f%"


def _std(finding: Texture) -> str:
    return NOTHING if finding.std is None else f"{number(finding.std.value, 1)}°"


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
        Markup('<span class="wv-curve-note">{}</span>').format(html.with_micro_sign(text)) for text in problems
    )
    waits = Markup('<span class="dim">{}</span>').format(WAITS) if not sections and not problems else Markup()
    zoom_out = (
        Markup('<span class="wv-link" {}>Whole line</span>').format(html.pick("plot", "whole")) if zoomed else Markup()
    )
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
