"""Difference of two results, with the sources of uncertainty that both have counted once."""

from __future__ import annotations

import math
from collections.abc import Iterator

from wafer_viewer.measure.base.measurement_context import PIXEL_SCALE, TEMPERATURE, Z_SCALE
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.findings import AnyResult
from wafer_viewer.model.quantity import BudgetLine, Quantity, effective_freedom
from wafer_viewer.model.region import Region

PROPORTIONAL = (Z_SCALE, PIXEL_SCALE, TEMPERATURE)
"""Sources that change both values in proportion, as long as they have one calibration and one temperature."""


def difference(first: AnyResult, second: AnyResult, *, quantity: str = "", same_surface: bool = True) -> Quantity:
    """Return the first result less the second one, with its uncertainty.

    Parameters
    ----------
    first, second : result
        Results with one calibration, such as two step heights on a surface, or one before and one after a process.
    quantity : str, optional
        Field of both results, such as ``'sq'``. Default '': the main one of each.
    same_surface : bool, optional
        Whether both are of one surface. Default True: where they have the same places they have the same noise. With
        False noise is independent, as in two scans.

    Returns
    -------
    Quantity
        The difference. Its budget has a line for each source of either result.

    Raises
    ------
    MeasureError
        If a result does not have the quantity, or the two are in different units.

    Notes
    -----
    Scales and temperature are correlated fully: what they add is in proportion to the difference. Everything else is
    taken as independent, but for results of one surface with the same places, of which all sources are alike. Where
    different inputs overlap, such as the upper face of one step and the lower face of another, the noise of both may
    add up, and its uncertainties are added, not their squares.
    """
    a, b = (_quantity(result, quantity) for result in (first, second))
    if a.unit != b.unit:
        raise MeasureError(f"One value is in {a.unit} and the other in {b.unit}: they have no difference.")
    value = a.value - b.value
    if a.expanded is None or b.expanded is None:
        status = a.status if a.expanded is None else b.status
        return Quantity(value=value, unit=a.unit, status=status)
    alike = same_surface and type(first) is type(second) and [*_inputs(first)] == [*_inputs(second)]
    crossed = same_surface and not alike and _inputs_cross(first, second)
    return Quantity.evaluated(value, a.unit, tuple(_lines(a, b, alike=alike, crossed=crossed)))


def _quantity(result: AnyResult, name: str) -> Quantity:
    found = result.quantities.get(name) if name else result.main
    if found is None:
        raise MeasureError(
            f"A {type(result).__name__} has no quantity {name!r}: choose one of {', '.join(result.quantities)}."
        )
    return found


def _lines(a: Quantity, b: Quantity, *, alike: bool, crossed: bool) -> Iterator[BudgetLine]:
    """Yield a line for each source of either quantity."""
    of_a, of_b = ({line.name: line for line in each.budget} for each in (a, b))
    signs = [math.copysign(1.0, each.value) for each in (a, b)]
    for name in dict.fromkeys((*of_a, *of_b)):
        both = [line for line in (of_a.get(name), of_b.get(name)) if line is not None]
        u_a, u_b = (line.u if line is not None else 0.0 for line in (of_a.get(name), of_b.get(name)))
        if name in PROPORTIONAL:
            u = abs(signs[0] * u_a - signs[1] * u_b)
        elif alike:
            u = abs(u_a - u_b)
        else:
            u = u_a + u_b if crossed else math.hypot(u_a, u_b)
        freedom = effective_freedom((line.u, line.freedom) for line in both)
        evaluation = "A" if any(line.evaluation == "A" for line in both) else "B"
        distribution = both[0].distribution if len({line.distribution for line in both}) == 1 else "normal"
        yield BudgetLine(name=name, evaluation=evaluation, distribution=distribution, freedom=freedom, u=u)


def _inputs_cross(first: AnyResult, second: AnyResult) -> bool:
    """Return whether an input of one result overlaps another input of the other one."""
    return any(
        name != other and any(_overlap(place, with_) for place in places for with_ in others)
        for name, places in _inputs(first)
        for other, others in _inputs(second)
    )


def _inputs(result: AnyResult) -> Iterator[tuple[str, tuple[Region, ...]]]:
    """Yield the inputs of a result by name, with the further regions of a face."""
    for name in result.input_fields:
        more: tuple[Region, ...] = getattr(result, f"also_{name}", ())
        yield name, (getattr(result, name), *more)


def _overlap(a: Region, b: Region) -> bool:
    (ax0, ay0, ax1, ay1), (bx0, by0, bx1, by1) = a.bounds_um, b.bounds_um
    return ax0 < bx1 and bx0 < ax1 and ay0 < by1 and by0 < ay1
