"""Quantities with a unit, their expanded uncertainty, and the outcomes of a decision on them."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any, ClassVar, Literal

from wafer_viewer.model.errors import MeasureError, WaferViewerError
from wafer_viewer.model.spec import NonNegative, Positive, Spec

UStatus = Literal["evaluated", "not evaluated", "uncalibrated"]
Unit = Literal["um", "um2", "um3", "deg", "mrad"]


ROUNDING = 1e-9
"""Relative difference of a stored number from one that is derived again."""


COVERAGE_FACTOR = 2.0
"""k of a normal distribution: an expanded uncertainty is so many times the standard uncertainty."""
COVERAGE = math.erf(COVERAGE_FACTOR / math.sqrt(2))
"""Probability that an expanded uncertainty covers the value: 95.45 %."""
Evaluation = Literal["A", "B"]
"""Type of evaluation of a standard uncertainty: A from the scatter of readings, B from other knowledge (GUM 3.3.4)."""
Distribution = Literal["normal", "triangular"]


def coverage_factor(freedom: float | None) -> float:
    """Return k for 95.45 % coverage: the two-sided point of Student's t, 2 for None or infinite degrees of freedom."""
    if freedom is None or math.isinf(freedom):
        return COVERAGE_FACTOR
    from scipy.special import stdtrit

    return float(stdtrit(freedom, (1 + COVERAGE) / 2))


def effective_freedom(parts: Iterable[tuple[float, float | None]]) -> float | None:
    """Return the degrees of freedom of a root sum of squares of standard uncertainties with their own; None: infinite.

    Welch-Satterthwaite formula (GUM G.4.1).
    """
    known = list(parts)
    shares = sum(u**4 / freedom for u, freedom in known if freedom is not None)
    return _root_sum_of_squares(u for u, _ in known) ** 4 / shares if shares > 0 else None


def digits_of_u(expanded: float) -> int:
    """Return the decimals for an uncertainty with two significant digits: 0.31 -> 2, 4.2 -> 1, 17 -> 0."""
    if not math.isfinite(expanded) or expanded <= 0:
        return 2
    digits = 1 - math.floor(math.log10(expanded))
    rounded_up = round(expanded, digits) >= 10 ** (2 - digits)
    return max(0, digits - 1 if rounded_up else digits)


class UncertaintySource(Spec, frozen=True, kw_only=True):
    """Source of a standard uncertainty: how a line of a budget was evaluated.

    freedom: degrees of freedom, None for so many that they do not count. The sensitivity coefficient is in the standard
    uncertainty, which is in the unit of the result.
    """

    error: ClassVar[type[WaferViewerError]] = MeasureError
    name: str
    evaluation: Evaluation = "B"
    distribution: Distribution = "normal"
    freedom: Positive | None = None

    @property
    def source(self) -> dict[str, Any]:
        """Name, type of evaluation, distribution and degrees of freedom, as plain Python values."""
        return {name: getattr(self, name) for name in ("name", "evaluation", "distribution", "freedom")}


class BudgetLine(UncertaintySource, frozen=True, kw_only=True):
    """One line of a quantity's budget: a standard uncertainty (k = 1) in the quantity's unit."""

    u: NonNegative


class Quantity(Spec, frozen=True, kw_only=True):
    """A value in a unit with its expanded uncertainty (95.45 %), or the status that explains its absence.

    k: coverage factor of the expanded uncertainty, by the effective degrees of freedom of its budget.
    """

    error: ClassVar[type[WaferViewerError]] = MeasureError
    value: float
    unit: Unit
    expanded: NonNegative | None = None
    k: Positive = COVERAGE_FACTOR
    status: UStatus = "not evaluated"
    budget: tuple[BudgetLine, ...] = ()

    @classmethod
    def evaluated(cls, value: float, unit: Unit, budget: tuple[BudgetLine, ...]) -> Quantity:
        """Return a quantity whose expanded uncertainty is k times the root sum of squares of a budget."""
        k, u = _combined((line.u, line.freedom) for line in budget)
        return cls(value=value, unit=unit, expanded=k * u, k=k, status="evaluated", budget=budget)

    def __float__(self) -> float:
        return self.value

    @property
    def k_text(self) -> str:
        """The coverage factor as it stands beside a value."""
        return f"k = {self.k:.3g}"

    def __str__(self) -> str:
        digits = digits_of_u(self.expanded) if self.expanded is not None else 3
        plus_minus = f" ± {self.expanded:.{digits}f}" if self.expanded is not None else ""
        return f"{self.value:.{digits}f}{plus_minus} {self.unit}"

    @property
    def u(self) -> float | None:
        """Standard uncertainty (k = 1) in the unit; None if it is not evaluated."""
        return None if self.expanded is None else self.expanded / self.k

    @property
    def freedom(self) -> float | None:
        """Effective degrees of freedom of the budget; None for so many that they do not count."""
        return effective_freedom((line.u, line.freedom) for line in self.budget)

    def to_dict(self) -> dict[str, Any]:
        """Return value, unit, u, k, U, coverage, degrees of freedom, status and budget, as plain Python values.

        Each line of the budget has name, u in the unit, type of evaluation, distribution and degrees of freedom.
        """
        return {
            "value": self.value,
            "unit": self.unit,
            "u": self.u,
            "k": self.k,
            "expanded": self.expanded,
            "coverage": COVERAGE,
            "freedom": self.freedom,
            "status": self.status,
            "budget": [{**line.source, "u": line.u} for line in self.budget],
        }

    @property
    def contradiction(self) -> str | None:
        """Sentence on an uncertainty that is not that of its budget; None if they agree."""
        k, u = _combined((line.u, line.freedom) for line in self.budget)
        expanded = k * u
        if self.expanded is None or not self.budget:
            return None
        if not math.isclose(self.k, k, rel_tol=ROUNDING):
            return f"k is said to be {self.k:.3g}, and is {k:.3g} by its budget"
        if math.isclose(self.expanded, expanded, rel_tol=ROUNDING):
            return None
        return f"U is said to be {self.expanded:.3g} {self.unit}, and is {expanded:.3g} by its budget"


class Contribution(UncertaintySource, frozen=True, kw_only=True):
    """One line of a length's uncertainty budget, standard uncertainty (k = 1) in um."""

    u_um: NonNegative

    @property
    def general(self) -> BudgetLine:
        """The line as that of a general quantity."""
        return BudgetLine(**self.source, u=self.u_um)


class Length(Spec, frozen=True, kw_only=True):
    """A length in um with its expanded uncertainty (95.45 %), or the status that explains its absence.

    k: coverage factor of the expanded uncertainty, by the effective degrees of freedom of its budget.
    """

    error: ClassVar[type[WaferViewerError]] = MeasureError
    value_um: float
    expanded_um: NonNegative | None = None
    k: Positive = COVERAGE_FACTOR
    status: UStatus = "not evaluated"
    budget: tuple[Contribution, ...] = ()

    @classmethod
    def evaluated(cls, value_um: float, budget: tuple[Contribution, ...]) -> Length:
        """Return a length whose expanded uncertainty is k times the root sum of squares of a budget."""
        k, u_um = _combined((line.u_um, line.freedom) for line in budget)
        return cls(value_um=value_um, expanded_um=k * u_um, k=k, status="evaluated", budget=budget)

    def __float__(self) -> float:
        return self.value_um

    def __str__(self) -> str:
        return str(self.quantity)

    @property
    def u(self) -> float | None:
        """Standard uncertainty (k = 1) in um; None if it is not evaluated."""
        return self.quantity.u

    def to_dict(self) -> dict[str, Any]:
        """Return what `Quantity.to_dict` returns."""
        return self.quantity.to_dict()

    @property
    def freedom(self) -> float | None:
        """Effective degrees of freedom of the budget; None for so many that they do not count."""
        return self.quantity.freedom

    @property
    def quantity(self) -> Quantity:
        """The length as a general quantity."""
        lines = tuple(line.general for line in self.budget)
        return Quantity(
            value=self.value_um, unit="um", expanded=self.expanded_um, k=self.k, status=self.status, budget=lines
        )


def _combined(parts: Iterable[tuple[float, float | None]]) -> tuple[float, float]:
    """Return coverage factor and combined standard uncertainty of standard uncertainties with degrees of freedom."""
    known = list(parts)
    return coverage_factor(effective_freedom(known)), _root_sum_of_squares(u for u, _ in known)


def _root_sum_of_squares(parts: Iterable[float]) -> float:
    return math.sqrt(sum(part**2 for part in parts))


Word = Literal["pass", "fail", "inconclusive", "no verdict"]
