"""Result table for spreadsheets: one line per number with unit, U or the reason for its absence, and position."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator
from dataclasses import dataclass, replace

from wafer_viewer.model.findings import AnyResult, MeasurementResults
from wafer_viewer.model.measurement.edge_and_bump_shapes import Bump, Chip, Chipping, Coplanarity
from wafer_viewer.model.measurement.measurement import MeasurementResult
from wafer_viewer.model.quantity import Length, Quantity
from wafer_viewer.model.region import Region

COLUMNS = (
    *("number", "name", "kind", "quantity", "value", "U", "unit", "k", "status"),
    *("x_um", "y_um", "surface", "filter", "levelled by", "show", "simulated"),
)
UNITS = ("um2", "um3", "um", "deg", "mrad")
"""Name suffixes that give the unit of a plain number; without one it is a count or a ratio, unit 1."""
OF_ALL = frozenset(MeasurementResult.__struct_fields__)


@dataclass(frozen=True, slots=True)
class CsvNumber:
    """One number of a result; status is empty for numbers without an uncertainty."""

    name: str
    value: float
    unit: str
    expanded: float | None = None
    status: str = ""


def findings_csv(findings: MeasurementResults) -> str:
    """Return the table; U is expanded (k = 2). x_um, y_um: centre of the first region; show 0: entire surface."""
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(COLUMNS)
    for finding in findings.items:
        for number in _numbers(finding):
            table.writerow([*_identity_cells(finding), *_cells(number), *_where(finding), *_processing_cells(finding)])
        for number, place in _parts(finding):
            table.writerow([*_identity_cells(finding), *_cells(number), *place, *_processing_cells(finding)])
    return text.getvalue()


def _numbers(finding: AnyResult) -> Iterator[CsvNumber]:
    """Yield the numbers of a result, the main one first."""
    found = [n for name in finding.__struct_fields__ if name not in OF_ALL and (n := _number(finding, name))]
    main = finding.main
    return iter(sorted(found, key=lambda n: (n.value, n.unit, n.status) != (main.value, main.unit, main.status)))


def _parts(finding: AnyResult) -> Iterator[tuple[CsvNumber, list[str]]]:
    """Yield the numbers of each chip or bump of a result, with its position."""
    parts: dict[str, tuple[Chip | Bump, ...]] = {}
    if isinstance(finding, Chipping):
        parts["chip"] = finding.chips
    if isinstance(finding, Coplanarity):
        parts["bump"] = finding.bumps
    for kind, found in parts.items():
        for k, part in enumerate(found, 1):
            at = [f"{part.place.x_um:.2f}", f"{part.place.y_um:.2f}"]
            numbers = (n for name in part.__struct_fields__ if (n := _number(part, name)))
            yield from ((replace(n, name=f"{kind} {k} {n.name}"), at) for n in numbers)


def _number(finding: AnyResult | Chip | Bump, name: str) -> CsvNumber | None:
    match getattr(finding, name):
        case Length() as length:
            return _of_quantity(name, length.quantity)
        case Quantity() as quantity:
            return _of_quantity(name, quantity)
        case int() | float() as value:
            unit = next((unit for unit in UNITS if name.endswith(f"_{unit}")), "")
            return CsvNumber(name.removesuffix(f"_{unit}") if unit else name, value, unit or "1")
        case _:
            return None


def _of_quantity(name: str, quantity: Quantity) -> CsvNumber:
    return CsvNumber(name, quantity.value, quantity.unit, quantity.expanded, quantity.status)


def _identity_cells(finding: AnyResult) -> list[object]:
    return [finding.number, finding.name, finding.__struct_config__.tag]


def _cells(number: CsvNumber) -> list[object]:
    known = number.expanded is not None
    return [
        number.name,
        f"{number.value:.6g}",
        f"{number.expanded:.2g}" if known else "",
        number.unit,
        2 if known else "",
        number.status,
    ]


def _where(finding: AnyResult) -> list[str]:
    places = (getattr(finding, name) for name in finding.__struct_fields__)
    bounds = next((place.bounds_um for place in places if isinstance(place, Region)), None)
    if bounds is None:
        return ["", ""]
    return [f"{(bounds[0] + bounds[2]) / 2:.2f}", f"{(bounds[1] + bounds[3]) / 2:.2f}"]


def _processing_cells(finding: AnyResult) -> list[object]:
    simulated = "SIMULATED" if finding.simulated else ""
    return [finding.surface, finding.filter, finding.levelling.by, finding.show, simulated]
