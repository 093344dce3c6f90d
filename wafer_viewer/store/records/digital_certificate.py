"""Results as XML for other programs: a digital calibration certificate, DCC 3.1.2 with values by D-SI 2.1.0 (PTB)."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from wafer_viewer.model.quantity import COVERAGE, Quantity, Unit

DCC, SI = "https://ptb.de/dcc", "https://ptb.de/si"
VERSION = "3.1.2"
NOT_GIVEN = "not given"
"""Text where the schema asks for one."""
UNITS: dict[Unit, str] = {
    "um": r"\micro\metre",
    "um2": r"\micro\metre\tothe{2}",
    "um3": r"\micro\metre\tothe{3}",
    "deg": r"\degree",
    "mrad": r"\milli\radian",
}
"""Units in the notation of D-SI."""


@dataclass(frozen=True, slots=True)
class NamedResult:
    """A result: its name, the method, the standard, and its quantities by symbol."""

    name: str
    method: str
    quantities: Sequence[tuple[str, Quantity]]


@dataclass(frozen=True, slots=True)
class CertifiedResults:
    """Contents of the file; day: ISO 8601; country: two letters (ISO 3166-1); statements: verdict and warnings."""

    number: str
    day: str
    country: str
    laboratory: str
    address: str
    email: str
    person: str
    customer: str
    sample: str
    instrument: str
    software: str
    results: Sequence[NamedResult]
    statements: Sequence[str] = field(default_factory=tuple[str, ...])


def results_xml(held: CertifiedResults) -> str:
    """Return the text of the file; quantities without a finite value are left out, and so is a U that is not known."""
    ET.register_namespace("dcc", DCC)
    ET.register_namespace("si", SI)
    root = ET.Element(f"{{{DCC}}}digitalCalibrationCertificate", schemaVersion=VERSION)
    _administrative(_add(root, "administrativeData"), held)
    measured = _add(_add(root, "measurementResults"), "measurementResult")
    _text(measured, "name", "Results")
    results = _add(measured, "results")
    for each in held.results:
        result = _add(results, "result")
        _text(result, "name", each.name)
        _text(result, "description", each.method)
        data = _add(result, "data")
        for symbol, quantity in each.quantities:
            if math.isfinite(quantity.value):
                _quantity(data, symbol, quantity)
    ET.indent(root)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{ET.tostring(root, "unicode")}\n'


def _administrative(part: ET.Element, held: CertifiedResults) -> None:
    software = _add(_add(part, "dccSoftware"), "software")
    _text(software, "name", "Wafer Viewer")
    _add(software, "release", held.software)
    core = _add(part, "coreData")
    for name, value in (
        ("countryCodeISO3166_1", held.country),
        ("usedLangCodeISO639_1", "en"),
        ("mandatoryLangCodeISO639_1", "en"),
        ("uniqueIdentifier", held.number),
        ("beginPerformanceDate", held.day),
        ("endPerformanceDate", held.day),
        ("performanceLocation", "laboratory"),
    ):
        _add(core, name, value)
    item = _add(_add(part, "items"), "item")
    _text(item, "name", held.sample)
    _text(_add(item, "manufacturer"), "name", NOT_GIVEN)
    identification = _add(_add(item, "identifications"), "identification")
    _add(identification, "issuer", "customer")
    _add(identification, "value", held.sample)
    _contact(_add(part, "calibrationLaboratory"), "contact", held.laboratory, held)
    person = _add(_add(part, "respPersons"), "respPerson")
    _text(_add(person, "person"), "name", held.person)
    _contact(part, "customer", held.customer)
    _statements(_add(part, "statements"), (f"Instrument: {held.instrument}", *held.statements))


def _statements(part: ET.Element, texts: Iterable[str]) -> None:
    for text in texts:
        _text(_add(part, "statement"), "declaration", text)


def _contact(part: ET.Element, name: str, who: str, held: CertifiedResults | None = None) -> None:
    contact = _add(part, name)
    _text(contact, "name", who)
    _add(contact, "eMail", held.email or NOT_GIVEN if held is not None else NOT_GIVEN)
    location = _add(contact, "location")
    if held is not None:
        _add(location, "countryCode", held.country)
    _text(location, "further", held.address or NOT_GIVEN if held is not None else NOT_GIVEN)


def _quantity(data: ET.Element, symbol: str, quantity: Quantity) -> None:
    part = _add(data, "quantity")
    _text(part, "name", symbol)
    real = ET.SubElement(part, f"{{{SI}}}real")
    values = [("label", symbol), ("value", _decimal(quantity.value)), ("unit", UNITS[quantity.unit])]
    for name, value in values:
        ET.SubElement(real, f"{{{SI}}}{name}").text = value
    if quantity.expanded is None:
        return
    uncertainty = ET.SubElement(real, f"{{{SI}}}expandedUnc")
    for name, value in (
        ("uncertainty", _decimal(quantity.expanded)),
        ("coverageFactor", _decimal(quantity.k)),
        ("coverageProbability", _decimal(COVERAGE)),
    ):
        ET.SubElement(uncertainty, f"{{{SI}}}{name}").text = value


def _decimal(value: float) -> str:
    return f"{value:.9g}"


def _add(part: ET.Element, name: str, text: str | None = None) -> ET.Element:
    child = ET.SubElement(part, f"{{{DCC}}}{name}")
    child.text = text
    return child


def _text(part: ET.Element, name: str, text: str) -> None:
    """Add an element with a text in English."""
    _add(_add(part, name), "content", text).set("lang", "en")
