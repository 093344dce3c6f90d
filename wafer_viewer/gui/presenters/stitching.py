"""HTML of the stitching: figures, warnings, rejected overlaps. Pure functions."""

from __future__ import annotations

import numpy as np
import viser

from wafer_viewer.draw.number_format import THIN, digits_of_u, number, with_unit
from wafer_viewer.gui.presenters.recipe import notes
from wafer_viewer.gui.widgets import html
from wafer_viewer.model.surface.field_poses import DOUBT_TITLES, Poses, RejectionReason
from wafer_viewer.session.state.snapshot import StitchingInfo

BY_STAGE = "Fields are placed by the stage alone: their overlaps were not compared."
SHOWN, LISTED = 6, 60
"""Number of rejected overlaps listed at first, and in total when unfolded."""
NAMED = 8
"""Largest number of fields named in a sentence."""
Rows = list[tuple[str, str]]


def numbers(info: StitchingInfo) -> str:
    """Return the main figures of the stitching: accepted overlaps, residual steps, uncertainties."""
    rows: Rows = [("Overlaps accepted", f"{number(info.n_believed, 0)} of {number(info.n_overlaps, 0)}")]
    rows += [(f"– {words}", number(n, 0)) for words, n in info.doubts if n]
    if info.step_median_um is not None:
        rows.append(("Step left at a seam, median", _length(info.step_median_um)))
    if info.step_p95_um is not None:
        rows.append(("– 95 % are under", _length(info.step_p95_um)))
    rows += [
        ("Position of a field, U (k = 2)", _plus_minus(info.position_u_um)),
        ("Height of a field, U (k = 2)", _plus_minus(info.height_u_um)),
    ]
    return html.pairs(rows)


def details(info: StitchingInfo) -> str:
    """Return the estimated stage errors, and the form components known only from the stage."""
    rows: Rows = [
        ("Field offset from the stage, rms", _length(info.moved_rms_um)),
        ("– largest", _length(info.moved_max_um)),
        ("Error of the stage, x and y", _length(info.stage_error_um)),
        ("– along z", _length(info.z_error_um)),
    ]
    said = f'<div class="wv-chosen">{html.pairs(rows)}</div>'
    form = [(name[:1].upper() + name[1:], _plus_minus(u)) for name, u in info.form]
    if form:
        head = '<div class="wv-lab">Known only from the stage, U (k = 2) at the edge</div>'
        said += f'<div class="wv-chosen">{head}{html.pairs(form)}</div>'
    return said


def cautions(info: StitchingInfo) -> str:
    """Return the warnings; an excluded field that a note already names is not listed again."""
    noted = " ".join(info.notes)
    unsaid = tuple(n for n in info.left_out if f"ield {n} " not in noted)
    said = [_left_out(unsaid)] if unsaid else []
    if info.n_groups > 1 and not info.n_by_stage:
        said.append(
            f"The fields fall into {info.n_groups} islands: no overlap joins them, so between islands "
            "positions and heights are the stage's."
        )
    return notes((*said, *info.notes), viser.Icon.ALERT_TRIANGLE, "attention")


def by_stage(info: StitchingInfo, n_fields: int) -> tuple[str, str]:
    """Return status text and notes on fields placed by the stage alone; both empty if there are none."""
    if not info.n_by_stage:
        return "", ""
    reasons = "; ".join(note for note in info.notes if "the stage" in note)
    if not info.n_believed:
        return "Stitched by the stage alone", reasons
    return f"{number(info.n_by_stage, 0)} of {number(n_fields, 0)} fields by the stage alone", reasons


def rejected_overlaps(poses: Poses, pixel_um: float) -> str:
    """Return the table of rejected overlaps, largest residual first, blank ones last; empty if there are none."""
    rows = _doubted_rows(poses, pixel_um)
    if not rows:
        return ""
    said = _table(("Fields", "Rejected because", "Offset, µm", "px"), rows[:SHOWN])
    if len(rows) > SHOWN:
        beyond = len(rows) - LISTED
        tail = f'<div class="wv-lab">and {number(beyond, 0)} with smaller offsets</div>' if beyond > 0 else ""
        more = f"<summary><u>{number(len(rows) - SHOWN, 0)} more</u></summary>"
        said += f'<details class="wv-more">{more}{_table((), rows[SHOWN:LISTED])}{tail}</details>'
    return f'<div class="wv-chosen">{said}</div>'


def _table(heads: tuple[str, ...], rows: list[str]) -> str:
    """Return a table with the column widths shared by both tables."""
    widths = '<colgroup><col style="width:74px"><col><col style="width:60px"><col style="width:46px"></colgroup>'
    return html.table(heads, rows, "  nn").replace(">", f">{widths}", 1)


def _doubted_rows(poses: Poses, pixel_um: float) -> list[str]:
    shifts = poses.shifts
    off_um = np.hypot(shifts.residual_x_um, shifts.residual_y_um)
    rows = np.flatnonzero(~shifts.believed)
    blank = shifts.doubt[rows] == RejectionReason.BLANK
    order = np.lexsort((-np.nan_to_num(off_um[rows], nan=-1.0, posinf=-1.0), blank))
    return [_doubted_row(poses, row, float(off_um[row]), pixel_um) for row in rows[order].tolist()]


def _doubted_row(poses: Poses, row: int, off_um: float, pixel_um: float) -> str:
    shifts = poses.shifts
    first, second = (int(poses.numbers[k]) for k in (shifts.first[row], shifts.second[row]))
    doubt = RejectionReason(int(shifts.doubt[row]))
    off = None if doubt is RejectionReason.BLANK else off_um
    figures = [number(off, 2), number(None if off is None else off / pixel_um, 1)]
    return html.row([f"{first}{THIN}–{THIN}{second}", html.safe(DOUBT_TITLES[doubt]), *figures], "  nn")


def _left_out(fields: tuple[int, ...]) -> str:
    if len(fields) == 1:
        return f"Field {fields[0]} is left out: it matches none of its neighbours. Check its frames, or scan it again."
    named, more = [str(n) for n in fields[:NAMED]], len(fields) - NAMED
    names = f"{', '.join(named)} and {more} more" if more > 0 else f"{', '.join(named[:-1])} and {named[-1]}"
    return f"Fields {names} are left out: they match none of their neighbours. Check their frames, or scan them again."


def _length(value_um: float) -> str:
    """Format a length to two significant digits, as uncertainties are."""
    return with_unit(value_um, digits_of_u(value_um))


def _plus_minus(u_um: float) -> str:
    return f"±{THIN}{_length(u_um)}"
