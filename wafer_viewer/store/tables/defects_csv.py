"""Defect table for spreadsheets: one line per defect, lengths in um; unmeasured areas are marked as such."""

from __future__ import annotations

import csv
import io

from wafer_viewer.model.inspection.defect import Defect, Inspection
from wafer_viewer.model.quantity import Quantity

COLUMNS = (
    *("number", "die", "u_um", "v_um", "x_um", "y_um", "class", "class by rules", "reasons", "judgement", "judged by"),
    *("judged at", "note", "height_um", "U height_um", "major_um", "U major_um", "minor_um", "U minor_um", "angle_deg"),
    *("area_um2", "U area_um2", "volume_um3", "score", "confidence", "scale_px", "evidence", "size resolved"),
    *("repeats", "simulated"),
)


def defects_csv(inspection: Inspection) -> str:
    """Return the table; U is expanded (k = 2), empty if not evaluated.

    x_um, y_um are stage coordinates; u_um, v_um are relative to the lower left corner of the die. Heights are empty for
    unmeasured areas, lateral sizes where they are not resolved.
    """
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(COLUMNS)
    table.writerows(_row(defect) for defect in inspection.defects)
    return text.getvalue()


def _row(defect: Defect) -> list[object]:
    return [*_where(defect), *_review_cells(defect), *_sizes(defect), *_quality_cells(defect)]


def _where(defect: Defect) -> list[object]:
    at = defect.in_die
    in_die = [f"{at.x_um:.3f}", f"{at.y_um:.3f}"] if at is not None else ["", ""]
    return [defect.number, defect.die, *in_die, f"{defect.center.x_um:.3f}", f"{defect.center.y_um:.3f}"]


def _review_cells(defect: Defect) -> list[object]:
    reasons = "; ".join(defect.reasons)
    by = (defect.judgement, defect.judged_by, defect.judged_at, defect.note)
    return [defect.seen_as, defect.kind, reasons, *by]


def _sizes(defect: Defect) -> list[str]:
    measured, resolved = defect.kind != "unmeasured", defect.size_resolved
    height = _pair(defect.height.quantity) if measured else ["", ""]
    lengths = [*_pair(defect.major.quantity), *_pair(defect.minor.quantity)] if resolved else [""] * 4
    angle = [f"{defect.angle_deg:.1f}"] if resolved else [""]
    area = _pair(defect.area) if resolved else ["", ""]
    return [*height, *lengths, *angle, *area, f"{defect.volume.value:.6g}" if measured else ""]


def _pair(quantity: Quantity) -> list[str]:
    return [f"{quantity.value:.6g}", "" if quantity.expanded is None else f"{quantity.expanded:.2g}"]


def _quality_cells(defect: Defect) -> list[object]:
    yes = {True: "yes", False: "no"}
    return [
        f"{defect.score:.2f}",
        f"{defect.confidence:.2f}",
        f"{defect.scale_px:g}",
        defect.evidence,
        yes[defect.size_resolved],
        yes[defect.repeats],
        "SIMULATED" if defect.simulated else "",
    ]
