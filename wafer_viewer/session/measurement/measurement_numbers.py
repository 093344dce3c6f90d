"""Formatting of all numbers of a result as text, from the types of its fields."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

from wafer_viewer.draw.number_format import number, share, value_and_u
from wafer_viewer.model.findings import AnyResult
from wafer_viewer.model.measurement.levelling import Levelling
from wafer_viewer.model.measurement.measurements import MeasurementResult
from wafer_viewer.model.quantity import BudgetLine, Length, Quantity
from wafer_viewer.model.region import Point, Region
from wafer_viewer.model.spec import Spec

UNITS = {"um": "µm", "um2": "µm²", "um3": "µm³", "deg": "°", "mrad": "mrad"}
SUFFIXES = {"_um2": "µm²", "_um3": "µm³", "_um": "µm", "_deg": "°", "_mrad": "mrad", "_c": "°C"}
"""Units of plain numbers, by the ending of the field name."""
TITLES = {
    "pt": "Pt",
    "dz": "Δz",
    "flt_t": "FLTt",
    "flt_q": "FLTq",
    "flt_t_minimum_zone": "FLTt, minimum zone",
    "band_9973": "Band with 99.73 %",
    "sdr_fraction": "Sdr",
    "smr1_fraction": "Smr1",
    "smr2_fraction": "Smr2",
    "str_ratio": "Str",
    "en": "En",
    "en_why": "What En says",
    "deviation": "Error",
    "reference": "Certificate at this temperature",
    "at": "Signed at",
    "s": "s",
    "sq": "Sq",
}
"""Symbols and fixed titles of fields; all other names are converted to words."""
OF_ALL = frozenset(MeasurementResult.__struct_fields__)
TOLD_ELSEWHERE = frozenset({"not_evaluated", "budget", "zones", "verdict", "why"})
MOST_WORDS = 160
Pair = tuple[str, str]


def spaced(name: str) -> str:
    """Return an identifier as words: ``StepHeight`` is Step height, ``n_frames`` is n frames."""
    words = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name).replace("_", " ").lower()
    words = re.sub(r" um$", ", µm", words)
    return words[:1].upper() + words[1:]


def title_of(name: str) -> str:
    """Return the title of a field: a symbol, or words without the unit suffix."""
    bare = next((name.removesuffix(suffix) for suffix in SUFFIXES if name.endswith(suffix)), name)
    return TITLES.get(name) or TITLES.get(bare) or spaced(bare)


def quantity_text(quantity: Quantity) -> str:
    """Return a value with its U and unit, ``11.86 ± 0.31 µm``; without a U, the reason for that."""
    unit = UNITS.get(quantity.unit, quantity.unit)
    value, u = value_and_u(quantity.value, quantity.expanded)
    if quantity.expanded is None:
        why = quantity.status if quantity.status == "uncalibrated" else f"U {quantity.status}"
        return f"{value}\u202f{unit}, {why}"
    return f"{value} ± {u}\u202f{unit}"


def numbers_of(finding: AnyResult) -> tuple[Pair, ...]:
    """Return all numbers except the main quantity: quantities first, then the other fields."""
    omitted = {*OF_ALL, *TOLD_ELSEWHERE, finding.main_field}
    names = [name for name in finding.__struct_fields__ if name not in omitted]
    pairs = [(name, pair) for name in names for pair in _pairs_of(title_of(name), name, getattr(finding, name))]
    quantities = [pair for name, pair in pairs if name in finding.quantities]
    return (*quantities, *(pair for _, pair in pairs if pair not in quantities))


def budget_of(finding: AnyResult) -> tuple[BudgetLine, ...]:
    """Return the budget lines of the main quantity's uncertainty (k = 1), or those of the result itself."""
    if finding.main.budget:
        return finding.main.budget
    lines: Any = getattr(finding, "budget", ())
    return tuple(BudgetLine(name=line.name, u=line.u_um) for line in lines)


def not_evaluated(finding: AnyResult) -> tuple[str, ...]:
    """Return the known contributions missing from the uncertainty."""
    return tuple(getattr(finding, "not_evaluated", ()))


def _pairs_of(title: str, name: str, value: Any) -> Iterator[Pair]:
    """Yield a field as text; nothing for empty values and for regions, which are drawn."""
    match value:
        case None | "" | () | Region() | Point() | Levelling():
            return
        case Length():
            yield title, quantity_text(value.quantity)
        case Quantity():
            yield title, quantity_text(value)
        case Spec():
            yield from _of_spec(title, value)
        case tuple():
            yield from _of_many(title, value)
        case str() if len(value) > MOST_WORDS:
            return
        case _:
            yield title, _plain(name, value)


def _of_spec(title: str, spec: Spec) -> Iterator[Pair]:
    """Yield a group of settings or numbers as one line."""
    pairs = [pair for name in spec.__struct_fields__ for pair in _pairs_of(title_of(name), name, getattr(spec, name))]
    if pairs:
        yield title, " · ".join(f"{name[:1].lower()}{name[1:]} {words}" for name, words in pairs)


def _of_many(title: str, values: tuple[Any, ...]) -> Iterator[Pair]:
    if all(isinstance(value, str) for value in values):
        yield title, ", ".join(values)
    elif all(isinstance(value, int | float) for value in values):
        yield title, ", ".join(number(value, 2) for value in values)
    elif not any(isinstance(value, Region | Point) for value in values):
        yield title, f"{len(values)}"


def _plain(name: str, value: object) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return number(value, 0)
    if isinstance(value, float):
        unit = next((unit for suffix, unit in SUFFIXES.items() if name.endswith(suffix)), "")
        if name.endswith("_fraction"):
            return share(value)
        if unit:
            return f"{number(value, 2)}\u202f{unit}"
        return f"{value:.3g}" if 0 < abs(value) < 0.01 else number(value, 3)
    return f"{value}".replace("_", " ")
