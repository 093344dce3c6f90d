"""HTML of the exposure that was found, and of the bracket that is proposed. Pure."""

from __future__ import annotations

from markupsafe import Markup

from wafer_viewer.draw.number_format import number, share, with_unit
from wafer_viewer.gui.widgets import html
from wafer_viewer.model.acquisition.exposure import ExposureLevels, FoundExposure
from wafer_viewer.session.state.snapshot import Snapshot


def result(snapshot: Snapshot) -> Markup:
    """Return the exposure found and what it was found from, as long as the plan has it; else empty."""
    found, job = snapshot.exposure, snapshot.draft.job
    if found is None or job is None or job.exposures_us not in (found.single_us, found.bracket_us):
        return Markup()
    single = found.single
    exposure_us = with_unit(single.exposure_us, _digits(single.exposure_us), "µs")
    facts = (
        f"Brightest pixels at {share(single.level, 0)} of white in field {single.brightest_field}; looked at "
        f"{_fields(found)}, {len(found.z_um)} positions over {with_unit(found.z_um[-1], 1)}."
    )
    return html.note("good", f"{exposure_us} suits the brightest field", facts) + _bracket(found, job.exposures_us)


def _bracket(found: FoundExposure, exposures_us: tuple[float, ...]) -> Markup:
    """Return the proposed bracket with its figures and the link that takes it; empty if there is none."""
    if not found.bracket:
        return Markup()
    rows = [html.row(_cells(levels), "nnn") for levels in found.bracket]
    table = html.table(["Exposure, µs", "Clipped", "Dark"], rows, "nnn")
    if exposures_us == found.bracket_us:
        return table
    dark = f"{share(found.single.dark_fraction)} of the pixels are darker than 5 % of white"
    link = Markup('<span class="wv-link" {}>Take the bracket</span>').format(
        html.command_pick("bracket", action="Plan saved")
    )
    return html.note("attention", "One exposure leaves dark areas", f"{dark}: a bracket shows them.", link) + table


def _cells(levels: ExposureLevels) -> list[str]:
    exposure = number(levels.exposure_us, _digits(levels.exposure_us))
    return [exposure, share(levels.clipped_fraction), share(levels.dark_fraction)]


def _digits(exposure_us: float) -> int:
    return 0 if exposure_us >= 100 else 1


def _fields(found: FoundExposure) -> str:
    n = len(found.fields)
    return f"field {found.fields[0]}" if n == 1 else f"fields {', '.join(map(str, found.fields))}"
