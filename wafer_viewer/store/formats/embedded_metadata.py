"""Metadata embedded in surface files: warnings for people; lattice and provenance for programs."""

from __future__ import annotations

import datetime
import json
import re
from contextlib import suppress
from typing import Any

import msgspec

from wafer_viewer.model.errors import DatasetError, WaferViewerError, parser_errors_as
from wafer_viewer.model.spec import decode, encode, replace
from wafer_viewer.model.surface.height_map import HeightMap, Mosaic, Origin, Provenance
from wafer_viewer.store.formats.surface_strips import Strips

OURS = "WaferViewer"
"""Key of the machine-readable text in formats with named texts."""
LINE_LETTERS = 200
_SIMULATED = "SIMULATED"
_STATED = re.compile(rf"\b{_SIMULATED}\b")


class EmbeddedMetadata(msgspec.Struct, frozen=True):
    """Lattice of a written file, and provenance of its surface."""

    pixel_um: float
    x0_um: float
    y0_um: float
    rows: int
    cols: int
    provenance: Provenance
    kind: str = "height"


def caveats(provenance: Provenance, today: str | None = None) -> tuple[str, ...]:
    """Return the warnings on the numbers: 'SIMULATED', and 'uncalibrated' with the reason; empty if there are none.

    today: an ISO 8601 date, by default the current one.
    """
    day = today or datetime.date.today().isoformat()
    calibration = provenance.calibration
    problem = "no calibration" if calibration is None else calibration.problem(calibration.setup, day)
    return ((_SIMULATED,) if provenance.simulated else ()) + ((f"uncalibrated: {problem}",) if problem else ())


def title(surface: HeightMap | Mosaic) -> str:
    """Return a readable title with the program version and the caveats."""
    return "; ".join((f"Heights by Wafer Viewer {surface.provenance.software_version}", *caveats(surface.provenance)))


def heading(strips: Strips) -> list[str]:
    """Return the header lines of a text file; the last ones are machine-readable, split into short lines."""
    surface, (rows, cols) = strips.surface, strips.shape
    return [
        f"Wafer Viewer {surface.provenance.software_version}: heights in um, stage coordinates",
        *caveats(surface.provenance),
        f"x = {surface.x0_um:.4f} + col * {strips.pixel_um:.8g}, y = {surface.y0_um:.4f} - row * {strips.pixel_um:.8g}",
        f"{rows} rows, {cols} columns",
        f"origin: {', '.join(f'{o.value} {o.name.lower()}' for o in Origin if o < Origin.NOT_COVERED)}",
        f"input checksum: {surface.provenance.input_checksum or 'none'}",
        *(f"{OURS}: {part}" for part in _in_short_lines(about(strips))),
    ]


def _in_short_lines(text: str) -> list[str]:
    """Split JSON into lines without blanks: some programs fail at a line or word of some hundred characters."""
    escaped = text.replace(" ", "\\u0020")
    return [escaped[start : start + LINE_LETTERS] for start in range(0, len(escaped), LINE_LETTERS)]


def about(strips: Strips) -> str:
    """Return the machine-readable text: one line of ASCII JSON."""
    surface, provenance = strips.surface, strips.surface.provenance
    facts = {
        "software": f"Wafer Viewer {provenance.software_version}",
        "unit": "um",
        "caveats": caveats(provenance),
        "pixel_um": strips.pixel_um,
        "x0_um": surface.x0_um,
        "y0_um": surface.y0_um,
        "rows": strips.shape[0],
        "cols": strips.shape[1],
        "provenance": json.loads(encode(provenance, "json")),
    }
    return json.dumps(facts, ensure_ascii=True, separators=(",", ":"))


def parse_metadata(text: str | None) -> EmbeddedMetadata | None:
    """Parse the machine-readable text; None if there is none or it is of an incompatible version."""
    foreign = DatasetError(f"{OURS} has another form.")
    with suppress(WaferViewerError), parser_errors_as(lambda _: foreign):
        facts: Any = json.loads(text or "")
        provenance = decode(json.dumps(facts["provenance"]), Provenance, OURS, "json")
        return msgspec.convert({**facts, "provenance": provenance}, EmbeddedMetadata)
    return None


def provenance_of(metadata: EmbeddedMetadata | None, embedded: str | None, *texts: str | None) -> Provenance | None:
    """Return the provenance of a surface that was read, None if its file says nothing of it.

    A title or comment for people that says SIMULATED counts, and so does `embedded`, the machine-readable text, where
    it could not be parsed: other programs drop or change one and leave the other.
    """
    readable = texts if metadata is not None else (*texts, embedded)
    stated = any(_STATED.search(text or "") for text in readable)
    if metadata is None:
        return Provenance(simulated=True) if stated else None
    return replace(metadata.provenance, simulated=metadata.provenance.simulated or stated)
