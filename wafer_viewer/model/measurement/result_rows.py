"""Rows of a result: its numbers with label and unit, for page, report, table and file alike.

A field of a result is labelled where it is declared: ``rise: Annotated[Length, Label("Rise", signed=True)]``. Without a
label its title is made of its name.
"""

from __future__ import annotations

import re
import typing
from dataclasses import dataclass
from functools import cache

from wafer_viewer.model.quantity import Length, Quantity
from wafer_viewer.model.region import Point, Region
from wafer_viewer.model.spec import Spec

SUFFIXES = ("um2", "um3", "um", "deg", "mrad", "c")
"""Endings of the names of plain numbers that are their unit; c is degrees Celsius."""


@dataclass(frozen=True, slots=True)
class Label:
    """Label of a field of a result.

    hint: its meaning, for a tooltip; group: of fields that are shown side by side; signed: a positive value has a sign;
    digits: decimals of a plain number; listed: False for what is shown elsewhere.
    """

    title: str = ""
    hint: str = ""
    group: str = ""
    signed: bool = False
    digits: int = 2
    listed: bool = True


UNLISTED = Label(listed=False)


@dataclass(frozen=True, slots=True)
class Row:
    """One number, text or group of settings of a result; unit: of a plain number, empty for counts and ratios."""

    field: str
    label: Label
    value: object
    unit: str = ""

    @property
    def name(self) -> str:
        """Name of the field without its unit."""
        return self.field.removesuffix(f"_{self.unit}") if self.unit else self.field

    @property
    def has_settings(self) -> bool:
        """True for a group of settings, false for a number, a text or a place."""
        return isinstance(self.value, Spec) and not isinstance(self.value, Quantity | Point | Region)


@cache
def labels_of(kind: type[Spec]) -> dict[str, Label]:
    """Return the labels of all fields of a result, or of a part of one."""
    hints = typing.get_type_hints(kind, include_extras=True)
    return {name: _label(name, hints[name]) for name in kind.__struct_fields__}


def title_of(kind: type[Spec], name: str) -> str:
    """Return the title of a field."""
    label = labels_of(kind).get(name)
    return label.title if label is not None and label.title else spaced(name)


def rows(part: Spec, omitted: frozenset[str] = frozenset()) -> tuple[Row, ...]:
    """Return the numbers, texts and settings of a result, or of a part of one, in the order of its fields.

    Regions larger than a point are drawn, and what is empty is omitted.
    """
    found = ((name, label, getattr(part, name)) for name, label in labels_of(type(part)).items())
    return tuple(
        Row(name, label, value.quantity if isinstance(value, Length) else value, _unit(name, value))
        for name, label, value in found
        if label.listed and name not in omitted and not _is_empty(value)
    )


def spaced(name: str) -> str:
    """Return an identifier as words: ``StepHeight`` is Step height, ``n_frames`` is n frames."""
    words = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name).replace("_", " ").lower()
    words = re.sub(r" um$", ", µm", words)
    return words[:1].upper() + words[1:]


def _label(name: str, hint: object) -> Label:
    given = next((one for one in getattr(hint, "__metadata__", ()) if isinstance(one, Label)), Label())
    title = given.title or spaced(_without_unit(name))
    return Label(title, given.hint, given.group, given.signed, given.digits, given.listed)


def _without_unit(name: str) -> str:
    unit = _suffix(name)
    return name.removesuffix(f"_{unit}") if unit else name


def _suffix(name: str) -> str:
    return next((unit for unit in SUFFIXES if name.endswith(f"_{unit}")), "")


def _unit(name: str, value: object) -> str:
    """Return the unit of a plain number, by the ending of its name."""
    plain = isinstance(value, int | float) and not isinstance(value, bool)
    return _suffix(name) if plain else ""


def _is_empty(value: object) -> bool:
    """Return whether a field has nothing to say: nothing given, or regions, which are drawn."""
    if isinstance(value, Region):
        return value.kind != "point"
    many = isinstance(value, tuple) and any(isinstance(one, Region) for one in typing.cast(tuple[object, ...], value))
    return value is None or value in ("", ()) or many
