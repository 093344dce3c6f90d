"""Quantities with a unit, their expanded uncertainty, and the outcomes of a decision on them."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any, ClassVar, Literal

from wafer_viewer.model.errors import MeasureError, WaferViewerError
from wafer_viewer.model.spec import NonNegative, Spec

UStatus = Literal["evaluated", "not evaluated", "uncalibrated"]
Unit = Literal["um", "um2", "um3", "deg", "mrad"]


ROUNDING = 1e-9
"""Relative difference of a stored number from one that is derived again."""


COVERAGE_FACTOR = 2.0
"""k: an expanded uncertainty is so many times the standard uncertainty."""


def digits_of_u(expanded: float) -> int:
    """Return the decimals for an uncertainty with two significant digits: 0.31 -> 2, 4.2 -> 1, 17 -> 0."""
    if not math.isfinite(expanded) or expanded <= 0:
        return 2
    digits = 1 - math.floor(math.log10(expanded))
    rounded_up = round(expanded, digits) >= 10 ** (2 - digits)
    return max(0, digits - 1 if rounded_up else digits)


class BudgetLine(Spec, frozen=True, kw_only=True):
    """One line of a quantity's budget: a standard uncertainty (k = 1) in the quantity's unit."""

    error: ClassVar[type[WaferViewerError]] = MeasureError
    name: str
    u: NonNegative


class Quantity(Spec, frozen=True, kw_only=True):
    """A value in a unit with its expanded uncertainty (k = 2), or the status that explains its absence."""

    error: ClassVar[type[WaferViewerError]] = MeasureError
    value: float
    unit: Unit
    expanded: NonNegative | None = None
    status: UStatus = "not evaluated"
    budget: tuple[BudgetLine, ...] = ()

    @classmethod
    def evaluated(cls, value: float, unit: Unit, budget: tuple[BudgetLine, ...]) -> Quantity:
        """Return a quantity whose expanded uncertainty is twice the root sum of squares of a budget."""
        expanded = COVERAGE_FACTOR * _root_sum_of_squares(line.u for line in budget)
        return cls(value=value, unit=unit, expanded=expanded, status="evaluated", budget=budget)

    def __float__(self) -> float:
        return self.value

    def __str__(self) -> str:
        digits = digits_of_u(self.expanded) if self.expanded is not None else 3
        plus_minus = f" ± {self.expanded:.{digits}f}" if self.expanded is not None else ""
        return f"{self.value:.{digits}f}{plus_minus} {self.unit}"

    @property
    def u(self) -> float | None:
        """Standard uncertainty (k = 1) in the unit; None if it is not evaluated."""
        return None if self.expanded is None else self.expanded / COVERAGE_FACTOR

    def to_dict(self) -> dict[str, Any]:
        """Return value, unit, standard and expanded uncertainty, k, status and budget, as plain Python values."""
        return {
            "value": self.value,
            "unit": self.unit,
            "u": self.u,
            "k": COVERAGE_FACTOR,
            "expanded": self.expanded,
            "status": self.status,
            "budget": {line.name: line.u for line in self.budget},
        }

    @property
    def contradiction(self) -> str | None:
        """Sentence on an uncertainty that is not that of its budget; None if they agree."""
        expanded = COVERAGE_FACTOR * _root_sum_of_squares(line.u for line in self.budget)
        if self.expanded is None or not self.budget or math.isclose(self.expanded, expanded, rel_tol=ROUNDING):
            return None
        return f"U is said to be {self.expanded:.3g} {self.unit}, and is {expanded:.3g} by its budget"


class Contribution(Spec, frozen=True, kw_only=True):
    """One line of a length's uncertainty budget, standard uncertainty (k = 1) in um."""

    error: ClassVar[type[WaferViewerError]] = MeasureError
    name: str
    u_um: NonNegative


class Length(Spec, frozen=True, kw_only=True):
    """A length in um with its expanded uncertainty (k = 2), or the status that explains its absence."""

    error: ClassVar[type[WaferViewerError]] = MeasureError
    value_um: float
    expanded_um: NonNegative | None = None
    status: UStatus = "not evaluated"
    budget: tuple[Contribution, ...] = ()

    @classmethod
    def evaluated(cls, value_um: float, budget: tuple[Contribution, ...]) -> Length:
        """Return a length whose expanded uncertainty is twice the root sum of squares of a budget."""
        expanded_um = COVERAGE_FACTOR * _root_sum_of_squares(c.u_um for c in budget)
        return cls(value_um=value_um, expanded_um=expanded_um, status="evaluated", budget=budget)

    def __float__(self) -> float:
        return self.value_um

    def __str__(self) -> str:
        return str(self.quantity)

    @property
    def u(self) -> float | None:
        """Standard uncertainty (k = 1) in um; None if it is not evaluated."""
        return self.quantity.u

    def to_dict(self) -> dict[str, Any]:
        """Return value, unit, standard and expanded uncertainty, k, status and budget, as plain Python values."""
        return self.quantity.to_dict()

    @property
    def quantity(self) -> Quantity:
        """The length as a general quantity."""
        lines = tuple(BudgetLine(name=c.name, u=c.u_um) for c in self.budget)
        return Quantity(value=self.value_um, unit="um", expanded=self.expanded_um, status=self.status, budget=lines)


def _root_sum_of_squares(parts: Iterable[float]) -> float:
    return math.sqrt(sum(part**2 for part in parts))


Word = Literal["pass", "fail", "inconclusive", "no verdict"]
