"""Certificates of gauge blocks out of digital calibration certificates: DCC 2.4 to 3.x with values by D-SI (PTB)."""

from __future__ import annotations

import dataclasses
import datetime
import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal, NoReturn

from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.gauge import Certificate, GaugeBlock
from wafer_viewer.model.quantity import COVERAGE_FACTOR
from wafer_viewer.store.records.digital_certificate import DCC, SI

Role = Literal["nominal", "measured", "deviation", "variation"]
_ROLES: tuple[tuple[Role, tuple[str, ...]], ...] = (
    ("nominal", ("nominalvalue", "nominal", "nennma")),
    ("variation", ("variationinlength", "variation", "abweichungsspanne")),
    ("deviation", ("measurementerror", "deviation", "abweichung")),
    ("measured", ("measuredvalue", "length", "länge", "measured")),
)
"""Words of a quantity's refType, else of its name or label, by which its role is told; the first that fits holds."""
UM_BY_UNIT = {r"\metre": 1e6, r"\milli\metre": 1e3, r"\micro\metre": 1.0, r"\nano\metre": 1e-3}
"""Units of length in the notation of D-SI."""
MOST_OFF = 0.01
"""Largest deviation of a length from its nominal one, as a fraction; over it a unit is wrong."""
ROUNDED_UM = 0.002
"""Difference of a length from nominal length and deviation that comes of rounding."""
_PERIOD = re.compile(r"P(?:(\d+)Y)?(?:(\d+)M)?(?:(\d+)D)?$")


@dataclass(frozen=True, slots=True)
class _Value:
    """One value of a quantity in um, with U (k = 2) if it is given, and the item that it is of."""

    value_um: float
    expanded_um: float | None
    item: str


def certificate_of_dcc(
    content: bytes, name: str, expires: datetime.date | None = None, blocks: Sequence[str] = ()
) -> Certificate:
    """Return the certificate in a DCC; lengths with U, k and serial numbers. Raises MeasureError, naming the element.

    expires: for a file that states no interval; blocks: serial numbers of two, for a file with more.
    """
    return _Reader(_root(content, name), name).certificate(expires, blocks)


def _root(content: bytes, name: str) -> ET.Element:
    if b"<!DOCTYPE" in content or b"<!ENTITY" in content:
        raise MeasureError(f"{name} has a DOCTYPE, which a DCC has none of: ask the laboratory for the file it issued.")
    try:
        root = ET.fromstring(content)
    except (ET.ParseError, ValueError, LookupError) as fault:
        raise MeasureError(f"{name} is no XML ({fault}): copy it again.") from fault
    if root.tag != f"{{{DCC}}}digitalCalibrationCertificate":
        raise MeasureError(
            f"{name} begins with <{root.tag.rpartition('}')[2]}>, a DCC with <dcc:digitalCalibrationCertificate> of "
            f"{DCC}: choose the certificate, .toml or .xml."
        )
    return root


class _Reader:
    """Reader of one file."""

    def __init__(self, root: ET.Element, name: str) -> None:
        self._root, self._name = root, name

    def certificate(self, expires: datetime.date | None, chosen: Sequence[str]) -> Certificate:
        core = self._part(self._root, "administrativeData", "coreData")
        issued = self._day(core, "issueDate", "endPerformanceDate")
        laboratory = self._part(self._root, "administrativeData", "calibrationLaboratory")
        signed = any(element.tag.endswith("}Signature") for element in self._root)
        version = self._root.get("schemaVersion", "")
        certificate = self._certified(
            {
                "number": self._text(core, "uniqueIdentifier"),
                "laboratory": self._content(self._part(laboratory, "contact", "name"), "calibrationLaboratory"),
                "issued": issued,
                "expires": expires or self._due(issued),
                "note": f"From {self._name}, DCC {version}{'; its signature was not checked' if signed else ''}",
            },
            chosen,
        )
        for length in certificate.blocks or (certificate,):
            value_um, nominal_um = length.value_um or 0.0, length.nominal_um or 1.0
            if abs(value_um - nominal_um) > MOST_OFF * nominal_um:
                self._wrong(f"states {value_um:g} um for a nominal length of {nominal_um:g} um: a unit is wrong")
        return certificate

    def _certified(self, about: dict[str, object], chosen: Sequence[str]) -> Certificate:
        items = list(self._items())
        serials = [serial for _, serial in items]
        if len(set(serials)) < len(serials):
            self._wrong(f"names the serial number {max(serials, key=serials.count)} twice in dcc:items")
        found: dict[Role, list[_Value]] = {role: list(self._values(role)) for role, _ in _ROLES}
        lengths = [self._length(found, k, len(items), *items[k]) for k in range(len(items))]
        variations = [value.value_um for value in found["variation"]]
        if variations:
            about["variation_um"] = max(variations)
        if len(lengths) == 1:
            (step,) = lengths
            parts = tuple(re.split(r"\s*[/,;]\s*", step.serial_number))
            return Certificate(
                **about,  # type: ignore[arg-type]
                nominal_um=step.nominal_um,
                value_um=step.value_um,
                expanded_um=step.expanded_um,
                serial_numbers=parts,
            )
        if missing := [serial for serial in chosen if serial not in serials]:
            self._wrong(f"has no block {missing[0]} in dcc:items: it has {', '.join(serials)}")
        if len(lengths) > 2 and len(chosen) != 2:
            self._wrong(f"has {len(lengths)} blocks in dcc:items, {', '.join(serials)}: choose two by --blocks")
        used = tuple(length for length in lengths if not chosen or length.serial_number in chosen)
        return Certificate(**about, blocks=used)  # type: ignore[arg-type]

    def _items(self) -> Iterator[tuple[str, str]]:
        """Yield id and serial number of each item; an item of items is those."""
        part = self._part(self._root, "administrativeData", "items")
        items = [item for item in part.iter(f"{{{DCC}}}item") if item.find(f".//{{{DCC}}}item") is None]
        if not items:
            self._wrong("has no dcc:item in dcc:items")
        for item in items:
            known = item.findall(f"{{{DCC}}}identifications/{{{DCC}}}identification")
            serial = [one for one in known if "serial" in _words(one)] or [
                one for one in known if one.findtext(f"{{{DCC}}}issuer", "") == "manufacturer"
            ]
            value = (serial[0].findtext(f"{{{DCC}}}value") or "").strip() if serial else ""
            if not value:
                self._wrong("has a dcc:item without a serial number: dcc:identification of the issuer manufacturer")
            yield item.get("id", ""), value

    def _length(self, found: dict[Role, list[_Value]], place: int, n_items: int, item: str, serial: str) -> GaugeBlock:
        nominal, measured, deviation = (
            self._of_item(found[role], role, place, n_items, item, serial)
            for role in ("nominal", "measured", "deviation")
        )
        if nominal is None:
            self._wrong(f"gives no nominal length of block {serial}: a dcc:quantity with refType basic_nominalValue")
        known = measured or deviation
        if known is None:
            self._wrong(f"gives no length of block {serial}: a dcc:quantity with refType basic_measuredValue")
        value_um = known.value_um if measured else nominal.value_um + known.value_um
        if measured and deviation and abs(nominal.value_um + deviation.value_um - value_um) > ROUNDED_UM:
            off = f"{nominal.value_um:g} {deviation.value_um:+g} um"
            self._wrong(f"states {value_um:g} um for block {serial}, and as deviation {off}: one of them is wrong")
        expanded_um = known.expanded_um if known.expanded_um is not None else (deviation or known).expanded_um
        if expanded_um is None:
            self._wrong(f"gives no U of block {serial}: si:expandedUnc with si:uncertainty and si:coverageFactor")
        return GaugeBlock(serial_number=serial, nominal_um=nominal.value_um, value_um=value_um, expanded_um=expanded_um)

    def _of_item(
        self, values: list[_Value], role: Role, place: int, n_items: int, item: str, serial: str
    ) -> _Value | None:
        """Return the value of a block: the one that refers to it, else by its place among those without a reference."""
        own = [value for value in values if item and value.item == item]
        if len(own) > 1:
            self._wrong(f"gives {len(own)} {role} values of block {serial}: it must be one")
        others = [value for value in values if not value.item]
        if own or not others:
            return own[0] if own else None
        if len(others) != n_items:
            self._wrong(f"has {len(others)} {role} values and {n_items} dcc:item: refer from each to its item by refId")
        return others[place]

    def _values(self, role: Role) -> Iterator[_Value]:
        ids = {item.get("id", "") for item in self._root.iter(f"{{{DCC}}}item")} - {""}
        for result in self._root.iter(f"{{{DCC}}}result"):
            of_result = _referred(result, ids)
            for quantity in result.iter(f"{{{DCC}}}quantity"):
                if _role(quantity) == role:
                    item = _referred(quantity, ids) or of_result
                    yield from (dataclasses.replace(value, item=item) for value in self._si_values(quantity))

    def _si_values(self, quantity: ET.Element) -> Iterator[_Value]:
        title = _title(quantity)
        real, many = quantity.find(f"{{{SI}}}real"), quantity.find(f"{{{SI}}}realListXMLList")
        if real is not None:
            yield self._value(
                real, title, real.findtext(f"{{{SI}}}value"), real.findtext(f"{{{SI}}}unit"), _uncertainty(real)
            )
        elif many is not None:
            values, units = ((many.findtext(f"{{{SI}}}{name}XMLList") or "").split() for name in ("value", "unit"))
            us, ks = (_list(many, *names) for names in (_U_LISTS, _K_LISTS))
            for k, value in enumerate(values):
                u = (us[k % len(us)], ks[k % len(ks)]) if us and ks and len(us) in (1, len(values)) else None
                yield self._value(many, title, value, units[k % len(units)] if units else None, u)
        else:
            self._wrong(f"has no si:real in the dcc:quantity '{title}'")

    def _value(
        self, real: ET.Element, title: str, value: str | None, unit: str | None, uncertainty: tuple[str, str] | None
    ) -> _Value:
        um = UM_BY_UNIT.get((unit or "").strip())
        if um is None:
            self._wrong(f"gives '{title}' in {unit or 'no unit'}: si:unit must be one of {', '.join(UM_BY_UNIT)}")
        value_um = um * self._number(value, "si:value", title)
        if uncertainty is None:
            if any("ncertainty" in part.tag or "Unc" in part.tag for part in real):
                self._wrong(f"gives U of '{title}' without si:coverageFactor: it must have both")
            return _Value(value_um, None, "")
        u_um = um * self._number(uncertainty[0], "si:uncertainty", title)
        k = self._number(uncertainty[1], "si:coverageFactor", title)
        if not (u_um > 0 and k > 0):
            self._wrong(f"gives U {uncertainty[0]} with k {uncertainty[1]} of '{title}': both must be over 0")
        return _Value(value_um, u_um * COVERAGE_FACTOR / k, "")

    def _number(self, text: str | None, element: str, title: str) -> float:
        try:
            number = float(text or "")
        except ValueError:
            number = math.nan
        if not math.isfinite(number):
            self._wrong(f"has {text!r} as {element} of '{title}': it must be a number")
        return number

    def _due(self, issued: datetime.date) -> datetime.date:
        """Return the end of the interval that a statement gives after the issue."""
        for period in self._root.iter(f"{{{DCC}}}period"):
            found = _PERIOD.match((period.text or "").strip())
            if found and any(found.groups()):
                try:
                    return _after(issued, *(int(part or 0) for part in found.groups()))
                except (ValueError, OverflowError):
                    self._wrong(f"has {period.text!r} as dcc:period, which no calendar reaches")
        return self._wrong(
            "does not say until when it is valid (dcc:period of a dcc:statement): give the day by --expires"
        )

    def _day(self, part: ET.Element, *names: str) -> datetime.date:
        text = next((found for name in names if (found := part.findtext(f"{{{DCC}}}{name}"))), "").strip()
        try:
            return datetime.date.fromisoformat(text)
        except ValueError:
            return self._wrong(f"has {text!r} as dcc:{names[-1]}: it must be a day such as 2026-03-14")

    def _part(self, element: ET.Element, *names: str) -> ET.Element:
        for name in names:
            below = element.find(f"{{{DCC}}}{name}")
            if below is None:
                self._wrong(f"has no dcc:{name} in {element.tag.rpartition('}')[2]}")
            element = below
        return element

    def _text(self, element: ET.Element, name: str) -> str:
        text = (self._part(element, name).text or "").strip()
        return text or self._wrong(f"has an empty dcc:{name}")

    def _content(self, element: ET.Element, of: str) -> str:
        text = (element.findtext(f"{{{DCC}}}content") or "").strip()
        return text or self._wrong(f"has no name of the dcc:{of}")

    def _wrong(self, how: str) -> NoReturn:
        raise MeasureError(f"{self._name} {how}.")


def _after(day: datetime.date, years: int, months: int, days: int) -> datetime.date:
    month = day.month - 1 + months
    first = datetime.date(day.year + years + month // 12, month % 12 + 1, 1)
    return first + datetime.timedelta(days=day.day - 1 + days)


def _words(element: ET.Element) -> str:
    """Return refType, name and label of an element in small letters."""
    texts = [element.get("refType", ""), *(part.text or "" for part in element.iter(f"{{{DCC}}}content"))]
    labels = (part.text or "" for part in element.iter(f"{{{SI}}}label"))
    return " ".join([*texts, *labels]).lower()


def _title(quantity: ET.Element) -> str:
    name = quantity.findtext(f"{{{DCC}}}name/{{{DCC}}}content") or quantity.findtext(f".//{{{SI}}}label")
    return (name or quantity.get("refType") or "without a name").strip()


def _role(quantity: ET.Element) -> Role | None:
    """Return the role of a quantity by its refType; where that tells none, by name and label."""
    for words in (quantity.get("refType", "").lower(), _words(quantity)):
        for role, marks in _ROLES:
            if any(mark in words for mark in marks):
                return role
    return None


def _referred(element: ET.Element, ids: set[str]) -> str:
    """Return the item that an element refers to, by refId or itemRef; empty for none."""
    references = element.get("refId", "").split()
    return next((reference for reference in references if reference in ids), "")


_U_LISTS = ("uncertaintyXMLList", "valueExpandedMUXMLList")
_K_LISTS = ("coverageFactorXMLList",)


def _list(element: ET.Element, *names: str) -> list[str]:
    found = (part for name in names for part in element.iter(f"{{{SI}}}{name}"))
    return next((part.text.split() for part in found if part.text), [])


def _uncertainty(real: ET.Element) -> tuple[str, str] | None:
    """Return U and k of a value, by D-SI up to 2.1 and from 2.2 on; None where there is none, or no k."""
    for part in real.iter():
        u = part.findtext(f"{{{SI}}}uncertainty") or part.findtext(f"{{{SI}}}valueExpandedMU")
        k = part.findtext(f"{{{SI}}}coverageFactor")
        if u is not None and k is not None:
            return u, k
    return None
