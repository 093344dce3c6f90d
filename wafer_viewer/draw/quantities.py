"""Texts of quantities and of the rows of a result: value, expanded uncertainty and unit."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from wafer_viewer.draw.number_format import THIN, number, share, value_and_u
from wafer_viewer.model.measurement.result_rows import Label, Row, rows
from wafer_viewer.model.quantity import Quantity
from wafer_viewer.model.region import Point, Region
from wafer_viewer.model.spec import SettingField, Spec, settings_of, value_at
from wafer_viewer.model.surface.focus_measures import focus_measures
from wafer_viewer.model.surface.recipe import Recipe

NO_U = {"not evaluated": "U not evaluated", "uncalibrated": "uncalibrated"}
UNIT_SIGNS = {"um": "µm", "um2": "µm²", "um3": "µm³", "deg": "°", "mrad": "mrad", "c": "°C"}
_LARGER = {"um2": ((1e5, 1e-6, "mm²"),), "um3": ((1e5, 1e-6, "nl"), (0.0, 1e-3, "pl"))}
"""Display units by quantity unit: (smallest value, factor, unit sign), largest first."""
FIGURES, MOST_DECIMALS = 3, 4
"""Significant digits of a grouped number, and the largest number of decimals."""


@dataclass(frozen=True, slots=True)
class ReadValue:
    """Display unit of a quantity: factor from the quantity's own unit, and unit sign."""

    factor: float
    unit: str


def display_unit(quantity: Quantity) -> ReadValue:
    """Return the display unit: nl or pl for volumes, mm² for large areas, else the unit of measurement."""
    for least, factor, unit in _LARGER.get(quantity.unit, ()):
        if abs(quantity.value) >= least:
            return ReadValue(factor, unit)
    return ReadValue(1.0, UNIT_SIGNS[quantity.unit])


def value_texts(quantity: Quantity, *, signed: bool = False) -> tuple[str, str, str]:
    """Return value, U to two significant digits (a dash if there is none) and unit, as texts."""
    read = display_unit(quantity)
    expanded = None if quantity.expanded is None else quantity.expanded * read.factor
    digits = _plain_digits(quantity) if read.factor == 1 else _digits(quantity.value * read.factor)
    value, u = value_and_u(quantity.value * read.factor, expanded, digits, signed=signed)
    return value, u, read.unit


def format_quantity(quantity: Quantity, *, signed: bool = False) -> str:
    """Format value, U and unit in one line: ``11.86 ± 0.31 µm``."""
    value, u, unit = value_texts(quantity, signed=signed)
    return with_unit_sign(f"{value} ± {u}" if quantity.expanded is not None else value, unit)


def explained_quantity(quantity: Quantity) -> str:
    """Format value, U and unit in one line; without a U with the reason for that."""
    why = f", {NO_U[quantity.status]}" if quantity.expanded is None and quantity.status in NO_U else ""
    return f"{format_quantity(quantity)}{why}"


def with_unit_sign(text: str, unit: str) -> str:
    """Join a number and its unit, without a space before the degree sign."""
    return f"{text}{unit}" if unit == "°" else f"{text}{THIN}{unit}"


def row_text(row: Row) -> str:
    """Return the value of a row as text, with its unit."""
    return _text(row.value, row.label, row.unit, row.field)


def short_text(row: Row) -> str:
    """Return the value of a row that stands beside others: three significant digits, without U and µm."""
    match row.value:
        case Quantity(unit="um") as length:
            return figures(length.value)
        case Quantity() as quantity:
            return with_unit_sign(number(quantity.value, 1), UNIT_SIGNS[quantity.unit])
        case float() as value if row.field.endswith("_fraction"):
            return f"{figures(100 * value)}{THIN}%"
        case float() as value:
            return number(value, 2, signed=True) if row.label.signed else figures(value)
        case _:
            return row_text(row)


def figures(value: float | None) -> str:
    """Format a number to three significant digits, with at most four decimals."""
    if value is None or not math.isfinite(value) or value == 0:
        return number(value, 2)
    digits = FIGURES - 1 - math.floor(math.log10(abs(value)))
    return number(value, min(MOST_DECIMALS, max(0, digits)))


def short_number(value: float) -> str:
    """Format a number to three significant digits, without zeros at its end."""
    if isinstance(value, int) or not value or not math.isfinite(value):
        return number(value, 0)
    text = number(value, max(0, FIGURES - 1 - math.floor(math.log10(abs(value)))))
    return text.rstrip("0").rstrip(".,") if "." in text or "," in text else text


def _plain(value: float) -> str:
    """Format a number without a unit: three decimals, more of a small one, none of one in thousands."""
    if 0 < abs(value) < 0.001:
        return power_of_ten(value)
    return number(value, 5 if abs(value) < 0.01 else 3 if abs(value) < 10 else 1 if abs(value) < 1000 else 0)


def power_of_ten(value: float) -> str:
    """Format a small number to three significant digits as ``1.15 × 10⁻⁵``."""
    exponent = math.floor(math.log10(abs(value)))
    raised = f"{exponent}".translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
    return f"{short_number(value / 10.0**exponent)}{THIN}×{THIN}10{raised}"


def place_text(place: Point) -> str:
    """Return x and y of a point."""
    return f"{number(place.x_um, 1)}, {number(place.y_um, 1)}"


def setting_text(field: SettingField, value: Any, unit: str = "") -> str:
    """Return the value of a setting as text: the title of a choice, yes or no, or a number with its unit."""
    setting = field.setting
    if setting.titles:
        return setting.titles.get(value, f"{value}")
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int | float):
        return f"{short_number(value)}{THIN}{unit or setting.unit}".rstrip(THIN)
    return setting.empty if value is None else FROM_DATA if value == "auto" else f"{value}"


FROM_DATA = "from the data"


def recipe_rows(recipe: Recipe, requested: Recipe | None = None) -> list[tuple[str, str]]:
    """Return title and value of the settings that have an effect; of those chosen by `requested` as ``auto`` alone."""
    settings = settings_of(Recipe)
    paths = [path for path in settings if path not in recipe.unused]
    if requested is not None:
        paths = [path for path in paths if value_at(requested, path) == "auto" != value_at(recipe, path)]
        paths = [path for path in paths if path not in requested.unused]
    measure = focus_measures()[recipe.focus_measure]
    told = {"focus_measure": f"{measure.title}: {measure.description}"}
    guided = "× distance to the guide" if recipe.levy.mode == "guided" else ""
    return [
        (
            settings[path].setting.title,
            told.get(path)
            or setting_text(settings[path], value_at(recipe, path), guided if path == "levy.alpha" else ""),
        )
        for path in paths
    ]


def settings_text(spec: Spec) -> str:
    """Return a group of settings or numbers in one line."""
    return " · ".join(f"{row.label.title[:1].lower()}{row.label.title[1:]} {row_text(row)}" for row in rows(spec))


def _text(value: Any, label: Label, unit: str, field: str) -> str:
    match value:
        case Quantity():
            return format_quantity(value, signed=label.signed)
        case Point():
            return place_text(value)
        case Region():
            return place_text(value.points[0])
        case Spec():
            return settings_text(value)
        case tuple():
            return _text_of_many(value, label)
        case bool():
            return "yes" if value else "no"
        case int():
            return number(value, 0)
        case float() if field.endswith("_fraction"):
            return share(value)
        case float() if unit:
            return with_unit_sign(number(value, label.digits, signed=label.signed), UNIT_SIGNS[unit])
        case float():
            return _plain(value)
        case _:
            return f"{value}".replace("_", " ")


def _text_of_many(values: Sequence[Any], label: Label) -> str:
    if all(isinstance(value, str) for value in values):
        return ", ".join(values)
    if all(isinstance(value, int | float) for value in values):
        return ", ".join(number(value, label.digits) for value in values)
    return f"{len(values)}"


def _plain_digits(quantity: Quantity) -> int:
    """Return the decimals of a value in its own unit: 2, or up to 4 (three digits) for lengths under 1 µm."""
    small = quantity.unit == "um" and 0 < abs(quantity.value) < 1
    return min(4, max(2, _digits(quantity.value) - 1)) if small else 2


def _digits(value: float) -> int:
    """Return the decimals that show a value without U to four digits."""
    return max(0, 3 - math.floor(math.log10(abs(value)))) if value else 2
