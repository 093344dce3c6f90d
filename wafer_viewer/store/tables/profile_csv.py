"""Profile table for spreadsheets: a block of columns per curve, with header lines on their sources."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from itertools import zip_longest

from wafer_viewer.model.measurement.sections import Section
from wafer_viewer.model.surface.height_map import LAYER_TITLES

COLUMNS = ("distance_um", "x_um", "y_um", "z_um")


def profiles_csv(sections: Sequence[Section], software_version: str) -> str:
    """Return the table; lines that begin with ``#`` state the sources, empty cells are unmeasured heights."""
    text = io.StringIO()
    text.writelines(f"# {line}\n" for line in _heading(sections, software_version))
    table = csv.writer(text, lineterminator="\n")
    table.writerow([f"{section.title} {column}" for section in sections for column in COLUMNS])
    blocks = [_rows(section) for section in sections]
    nothing = [""] * len(COLUMNS)
    table.writerows([cell for part in row for cell in part] for row in zip_longest(*blocks, fillvalue=nothing))
    return text.getvalue()


def _heading(sections: Sequence[Section], software_version: str) -> list[str]:
    simulated = any(section.profile.simulated for section in sections)
    return [
        f"Wafer Viewer {software_version}: profiles, um, stage coordinates",
        *(["SIMULATED: not measurements of a real sample."] if simulated else []),
        *(_about(section) for section in sections),
    ]


def _about(section: Section) -> str:
    profile = section.profile
    (xa, ya), (xb, yb) = ((p.x_um, p.y_um) for p in profile.line.points)
    facts = [
        section.source,
        f"from ({xa:.2f}, {ya:.2f}) to ({xb:.2f}, {yb:.2f}) um",
        f"width {profile.line.width_um:g} um",
        LAYER_TITLES[profile.surface],
        f"filter {profile.filter}",
        f"levelled by {section.asked.levelling.by}",
        "SIMULATED" if profile.simulated else "real",
        f"Pt {profile.pt.value_um:.6g} um ({profile.pt.status})",
        *profile.notes,
    ]
    return f"{section.title}: {'; '.join(facts)}"


def _rows(section: Section) -> list[list[str]]:
    curve = section.curve
    columns = (curve.distance_um, curve.x_um, curve.y_um, curve.z_um)
    return [["" if v != v else f"{v:.4f}" for v in row] for row in zip(*(c.tolist() for c in columns), strict=True)]
