"""Presentation of a comparison: surfaces subtracted, alignment, and change."""

from __future__ import annotations

from wafer_viewer.draw.number_format import digits_of_u, number, share, value_and_u, with_unit
from wafer_viewer.gui.widgets import html
from wafer_viewer.model.surface.comparison import (
    FOUND_BY,
    Change,
    Comparison,
    ComparisonFace,
    Registration,
    SurfaceName,
)

FACES: tuple[tuple[ComparisonFace, str], ...] = (
    (ComparisonFace.DIFFERENCE, "Difference"),
    (ComparisonFace.FIRST, "First"),
    (ComparisonFace.SECOND, "Second"),
    (ComparisonFace.BESIDE, "Both"),
)
OUTDATED = "One of the surfaces has changed or was deleted: compare again."
BESIDE_SAID = "The second stands to the right of the first, in the same colours and range."
LITTLE_OVERLAP = 0.5
"""Overlap fraction below which the page warns that little is compared."""
_UM3_PER_PL = 1e3
_LARGE_PL = 1e3


def pair_label(first: SurfaceName, second: SurfaceName) -> str:
    """Return the label of a pair of surfaces in the list."""
    if (first.path, first.result, first.field) == (second.path, second.result, second.field):
        return "Measured and filtered"
    return f"Result {second.result}" if first.path == second.path else second.words


def name_of(comparison: Comparison) -> str:
    """Return the name of a comparison in the list."""
    return pair_label(comparison.first, comparison.second)


def surfaces_sentence(comparison: Comparison) -> str:
    """Return a sentence that names the first and the second surface."""
    return f"First: {comparison.first.words}. Second: {comparison.second.words}."


def change_figures(change: Change) -> str:
    """Return the main figures: changed area in % and Sq of the difference in µm."""
    return html.columns(
        [
            html.figure("Changed", number(100 * change.changed_fraction, 1), "%", 26),
            html.figure("Sq of difference", number(change.sq_um, 2), "µm", 26),
        ]
    )


def numbers(change: Change) -> str:
    """Return the table of difference statistics."""
    rows = [
        ("Mean", with_unit(change.mean_um, 3, signed=True)),
        ("Lowest", with_unit(change.lowest_um, 2, signed=True)),
        ("Highest", with_unit(change.highest_um, 2, signed=True)),
        ("Counts as changed", f"beyond ±{with_unit(change.limit_um, 2)}"),
        ("Volume gained", volume(change.gained_um3)),
        ("Volume lost", volume(change.lost_um3)),
        ("Places compared", number(change.n_points, 0)),
    ]
    return html.head("Second − first") + html.pairs(rows)


def volume(um3: float) -> str:
    """Format a volume in pl, from 1000 pl on in nl."""
    pl = um3 / _UM3_PER_PL
    return with_unit(pl / _LARGE_PL, 2, "nl") if pl >= _LARGE_PL else with_unit(pl, 2, "pl")


def alignment(found: Registration) -> str:
    """Return the table of registration parameters of the second surface, each with its U."""
    rows = [("Found", FOUND_BY[found.by])] if found.by == "same" else []
    if found.by in ("images", "heights"):
        rows += [
            ("Shift x", _with_u(found.x_um, found.u_xy_um, "µm")),
            ("Shift y", _with_u(found.y_um, found.u_xy_um, "µm")),
            ("Turn", _with_u(found.turn_mrad, found.u_turn_mrad, "mrad")),
        ]
    if found.levelled:
        rows += [
            ("Height", _with_u(found.z_um, found.u_z_um, "µm")),
            ("Tilt along x", _with_u(found.tilt_x_mrad, found.u_tilt_mrad, "mrad")),
            ("Tilt along y", _with_u(found.tilt_y_mrad, found.u_tilt_mrad, "mrad")),
            ("Residual, rms", with_unit(found.residual_um, digits_of_u(found.residual_um))),
        ]
    rows.append(("Share of the first compared", share(found.overlap_fraction)))
    how = "" if found.by == "same" else f'<div class="wv-lab">Found {html.safe(FOUND_BY[found.by])}; k = 2.</div>'
    return html.head("Alignment") + how + html.pairs(rows)


def warnings(comparison: Comparison, outdated: bool) -> str:
    """Return warnings: outdated surface, small overlap, missing or different calibration."""
    said = [OUTDATED] if outdated else []
    if comparison.registration.overlap_fraction < LITTLE_OVERLAP:
        said.append(f"Only {share(comparison.registration.overlap_fraction)} of the first surface lies on the second.")
    if not comparison.calibrated:
        said.append("Lengths are uncalibrated, or the calibrations differ.")
    return "".join(f'<div class="wv-lab" style="margin:4px 0">{html.safe(text)}</div>' for text in said)


def _with_u(value: float, expanded: float | None, unit: str) -> str:
    shown, u = value_and_u(value, expanded, signed=True)
    return f"{shown} {unit}" if expanded is None else f"{shown} ± {u} {unit}"
