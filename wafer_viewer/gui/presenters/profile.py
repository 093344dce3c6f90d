"""HTML above the profile plot: symbol, Pt, length and width of each line, cursor read-out. Pure functions."""

from __future__ import annotations

from collections.abc import Sequence

from wafer_viewer.draw.colormaps import PROFILE_COLOURS
from wafer_viewer.draw.number_format import number, with_unit
from wafer_viewer.gui.presenters.measurement import averaging
from wafer_viewer.gui.widgets import html
from wafer_viewer.model.measurement.section_lines import LETTERS, Gap
from wafer_viewer.model.measurement.sections import Section
from wafer_viewer.model.surface.height_map import LAYER_TITLES

_CROWDED = ("", "", " wv-two", " wv-many")
"""CSS class by number of lines: with many lines only the most important figures are shown."""
WAITS = "The curve appears when the line lies on the surface."


def head(
    sections: Sequence[Section], problems: Sequence[str], n_lines: int, active: int, gap: Gap | None, zoomed: bool
) -> str:
    """Return the row above the plot; a line without a curve keeps its symbol."""
    own = {s.asked.place: s for s in sections if not s.asked.is_second}
    lines = "".join(_line(place, own.get(place), place == active) for place in range(n_lines))
    seconds = "".join(_second(s) for s in sections if s.asked.is_second)
    notes = "".join(f'<span class="wv-curve-note">{html.safe(html.with_micro_sign(text))}</span>' for text in problems)
    waits = f'<span class="dim">{WAITS}</span>' if not sections and not problems else ""
    whole = f'<span class="wv-link" {html.pick("plot", "whole")}>Whole line</span>' if zoomed else ""
    name = "Section" if any(s.points is not None for s in own.values()) else "Profile"
    return (
        f'<div class="wv-dock wv-lines{_CROWDED[min(n_lines, 3)]}"><b>{name}</b>{lines}{seconds}{notes}{waits}'
        f'<span class="wv-end">{whole}{cursor_readout(gap) if gap is not None else ""}</span></div>'
    )


def cursor_readout(gap: Gap) -> str:
    """Return distance, height difference and angle between the cursors."""
    return (
        f"<span>Δx <b>{number(gap.dx_um, 1)}</b>&ensp;Δz <b>{with_unit(gap.dz_um, 2, signed=True)}</b>&ensp;"
        f"{with_unit(gap.angle_deg, 2, '°')}</span>"
    )


def _line(place: int, section: Section | None, active: bool) -> str:
    sign = html.chip(LETTERS[place], PROFILE_COLOURS[place])
    about = _numbers(section) if section is not None else ""
    look = f'class="wv-line{" sel" if active else ""}" aria-pressed="{str(active).lower()}"'
    return f'<span {look} aria-label="Line {LETTERS[place]}" {html.pick("line", place)}>{sign} {about}</span>'


def _numbers(section: Section) -> str:
    profile, points = section.profile, section.points
    if points is not None:
        return (
            f"spread about the line <b>{with_unit(points.spread_um, 2)}</b>"
            f'<span class="dim wv-roomy">68 % of {number(len(points), 0)} points · '
            f"{with_unit(points.width_um, 1)} wide · line: running median</span>"
        )
    return (
        f"Pt <b>{with_unit(profile.pt.value_um, 2)}</b>"
        f'<span class="dim wv-roomy">{with_unit(profile.length_um, 0)} long, {averaging(profile)} wide</span>'
    )


def _second(section: Section) -> str:
    name = section.asked.of.title if section.asked.of is not None else LAYER_TITLES[section.profile.surface]
    pt = with_unit(section.profile.pt.value_um, 2)
    return f'<span class="wv-second"><i></i>{html.safe(name)} <span class="dim">Pt {pt}</span></span>'
