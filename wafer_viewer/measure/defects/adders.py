"""Adders: defects of two inspections of one wafer, matched by place."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.measure.defects.lot_statistics import require_wafers
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.inspection.lot import (
    UM2_PER_MM2,
    CommonDefect,
    StatisticsRow,
    WaferComparison,
    WaferDefect,
    WaferDefects,
)

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Place = tuple[int, int]
MOST_CHI_SQUARED = 6.18
"""Squared distance of two places in standard deviations that 95.45 % of the same defects do not exceed."""
LEAST_U_UM = 2.0
"""Standard uncertainty along each axis of the distance of two places of tools: they agree within 5 um at best."""
EXTENT_SHARE = 1 / (4 * 3**0.5)
"""Standard uncertainty of a centre over the length of its defect, which may be seen by half: uniform to a quarter."""
MOST_PAIRS = 4_000_000
"""Most pairs of defects over which coincidences are summed; of more, evenly chosen ones stand for all."""


def adders(first: WaferDefects, second: WaferDefects, *, within_um: float | None = None) -> WaferComparison:
    """Compare two inspections of one wafer: common, added and removed defects.

    Parameters
    ----------
    first, second : WaferDefects
        The earlier and the later inspection.
    within_um : float, optional
        Largest distance of the same defect, um. By default it follows from the uncertainty of both places.

    Returns
    -------
    WaferComparison
        Numbers of the defects; those on dies that the other inspection did not inspect are neither added nor removed.

    Raises
    ------
    MeasureError
        If `within_um` is not above 0, or the dies have different pitches.

    Notes
    -----
    Each defect is matched once, the nearest pairs first. Places are compared on the dies where both inspections have
    them, so that the wafer may lie elsewhere on the stage. Dies correspond by their numbers, or by their places where
    more defects match so.

    The variance of a place is the sum of those of the lattice's corner and pitch, of the edges of the outline, and of
    the extent of the defect, which may be seen in part: uniform over a half of its length and width. Two places agree
    within the ellipse that holds 95.45 % of a normal distribution of both, which is 5 um at least. Distances are
    compared in standard deviations then.

    For `by_chance` all defects of the second inspection are spread at random over the dies that both inspected; it is
    the expected number of pairs that agree, an upper bound.
    """
    if within_um is not None and not within_um > 0:
        raise MeasureError(f"within_um is {within_um:g}: it must be over 0.")
    require_wafers((first, second))
    of_first = _Places.of(first, first, (0, 0))
    candidates = [_Places.of(second, first, shift) for shift in dict.fromkeys(((0, 0), _shift(first, second)))]
    matched = [(_matched(of_first, places, within_um), places) for places in candidates]
    pairs, of_second = max(matched, key=lambda one: len(one[0]))
    return _comparison(first, second, pairs, (of_first, of_second), within_um)


@dataclass(frozen=True, slots=True, eq=False)
class _Places:
    """Defects in the coordinates of the first inspection, with covariances [n, 2, 2] and (col, row) of their dies."""

    xy_um: Floats
    covariance: Floats
    dies: tuple[Place, ...]
    inspected: frozenset[Place]
    shift: Place

    @classmethod
    def of(cls, wafer: WaferDefects, first: WaferDefects, shift: Place) -> _Places:
        """Return the places of a wafer; shift: die of the first wafer that its die 0,0 is."""
        own = np.array([(d.x_um, d.y_um) for d in wafer.defects]).reshape(-1, 2)
        inspected = frozenset((die.col + shift[0], die.row + shift[1]) for die in wafer.inspected_dies)
        if wafer.grid is None or first.grid is None:
            return cls(
                own - _origin(wafer, first) + _origin(first, wafer), _covariance(wafer, 0.0), (), inspected, shift
            )
        cols, rows, u_um, v_um = wafer.grid.to_die(*own.T)
        cols, rows = cols + shift[0], rows + shift[1]
        xy_um = np.column_stack(first.grid.to_stage(cols, rows, u_um, v_um))
        turn_rad = first.grid.angle_rad - wafer.grid.angle_rad
        covariance = _covariance(wafer, turn_rad)
        far = np.column_stack((cols, rows)) * wafer.grid.u_pitch_um
        covariance[:, [0, 1], [0, 1]] += wafer.grid.u_origin_um**2 + far**2
        return cls(xy_um, covariance, tuple(zip(cols.tolist(), rows.tolist(), strict=True)), inspected, shift)


def _origin(wafer: WaferDefects, other: WaferDefects) -> Floats:
    """Return the wafer's centre if both wafers have one, else zero."""
    center = wafer.center if other.center is not None else None
    return np.zeros(2) if center is None else np.array([center.x_um, center.y_um])


def _covariance(wafer: WaferDefects, turn_rad: float) -> Floats:
    """Return the covariance of each centre by the extent and the edges of its defect."""
    values = [(d.length_um, d.width_um, np.deg2rad(d.angle_deg) + turn_rad, d.u_um) for d in wafer.defects]
    length, width, angle, edge = np.array(values).reshape(-1, 4).T
    along, across = (EXTENT_SHARE * length) ** 2 + edge**2, (EXTENT_SHARE * width) ** 2 + edge**2
    c, s = np.cos(angle), np.sin(angle)
    xy = c * s * (along - across)
    parts = (c**2 * along + s**2 * across, xy, xy, s**2 * along + c**2 * across)
    return np.stack(parts, axis=-1).reshape(-1, 2, 2)


def _shift(first: WaferDefects, second: WaferDefects) -> Place:
    """Return the die of the first wafer at whose place die 0,0 of the second lies."""
    if first.grid is None or second.grid is None:
        return 0, 0
    middle = second.grid.to_stage(0, 0, second.grid.width_um / 2, second.grid.height_um / 2)
    x, y = np.array(middle).ravel() - _origin(second, first) + _origin(first, second)
    col, row, _, _ = first.grid.to_die(np.array([x]), np.array([y]))
    return int(col[0]), int(row[0])


def _matched(first: _Places, second: _Places, within_um: float | None) -> list[tuple[int, int]]:
    """Return the index pairs of the same defects, nearest first and each once."""
    taken_first: set[int] = set()
    taken_second: set[int] = set()
    pairs: list[tuple[int, int]] = []
    for _, i, j in sorted(_near(first, second, within_um)):
        if i not in taken_first and j not in taken_second:
            taken_first.add(i)
            taken_second.add(j)
            pairs.append((i, j))
    return sorted(pairs)


def _near(first: _Places, second: _Places, within_um: float | None) -> Iterator[tuple[float, int, int]]:
    """Yield distance and indices of the pairs that may be the same defect."""
    from scipy.spatial import KDTree

    if not (len(first.xy_um) and len(second.xy_um)):
        return
    widest = np.linalg.eigvalsh(second.covariance)[:, -1].max() + LEAST_U_UM**2
    reach = np.sqrt(MOST_CHI_SQUARED * (np.linalg.eigvalsh(first.covariance)[:, -1] + widest))
    others = KDTree(second.xy_um).query_ball_point(first.xy_um, reach if within_um is None else within_um)
    for i, near in enumerate(others):
        away = second.xy_um[near] - first.xy_um[i]
        squared = _chi_squared(away, first.covariance[i] + second.covariance[near])
        distance = squared if within_um is None else (away**2).sum(axis=1)
        limit = MOST_CHI_SQUARED if within_um is None else within_um**2
        yield from ((float(distance[k]), i, near[k]) for k in np.flatnonzero(distance <= limit))


def _chi_squared(away: Floats, covariance: Floats) -> Floats:
    whole = covariance + LEAST_U_UM**2 * np.eye(2)
    return np.einsum("ni,nij,nj->n", away, np.linalg.inv(whole), away)


# -------------------------------------------------------------------------------------------------------------- results


def _comparison(
    first: WaferDefects,
    second: WaferDefects,
    pairs: Sequence[tuple[int, int]],
    places: tuple[_Places, _Places],
    within_um: float | None,
) -> WaferComparison:
    of_first, of_second = places
    away = np.array([of_second.xy_um[j] - of_first.xy_um[i] for i, j in pairs]).reshape(-1, 2)
    offset = np.median(away, axis=0).tolist() if pairs else (None, None)
    removed, not_inspected_after = _split(first, of_first, {i for i, _ in pairs}, of_second.inspected)
    added, not_inspected_before = _split(second, of_second, {j for _, j in pairs}, of_first.inspected)
    common = tuple(
        CommonDefect(first=first.defects[i].number, second=second.defects[j].number, dx_um=float(dx), dy_um=float(dy))
        for (i, j), (dx, dy) in zip(pairs, away, strict=True)
    )
    return WaferComparison(
        first=first.name,
        second=second.name,
        common=common,
        added=_numbers(added),
        removed=_numbers(removed),
        not_inspected_before=_numbers(not_inspected_before),
        not_inspected_after=_numbers(not_inspected_after),
        offset_x_um=offset[0],
        offset_y_um=offset[1],
        by_chance=_coincidences(first, of_first, of_second, within_um),
        dies=_words(first, second, of_second.shift),
        listed=tuple(
            chain(
                _listed("added", added),
                _listed("removed", removed),
                _listed("not inspected before", not_inspected_before),
                _listed("not inspected after", not_inspected_after),
                _common_rows(second, common),
            )
        ),
        simulated=first.simulated or second.simulated,
        notes=tuple(dict.fromkeys((*_notes(first, second), *first.notes, *second.notes))),
    )


def _split(
    wafer: WaferDefects, places: _Places, matched: set[int], inspected: frozenset[Place]
) -> tuple[list[WaferDefect], list[WaferDefect]]:
    """Return the unmatched defects: those on dies that the other inspection inspected, and the others."""
    alone = [k for k in range(len(wafer.defects)) if k not in matched]
    known = [k for k in alone if not places.dies or not inspected or places.dies[k] in inspected]
    return [wafer.defects[k] for k in known], [wafer.defects[k] for k in sorted({*alone} - {*known})]


def _numbers(defects: Sequence[WaferDefect]) -> tuple[int, ...]:
    return tuple(defect.number for defect in defects)


def _coincidences(wafer: WaferDefects, first: _Places, second: _Places, within_um: float | None) -> float | None:
    """Return the expected number of pairs that agree by chance; None if the area is not known."""
    both = first.inspected & second.inspected
    grid = wafer.grid
    area_um2 = len(both) * grid.pitch_x_um * grid.pitch_y_um if grid is not None else 0.0
    area_um2 = area_um2 or wafer.inspected_mm2 * UM2_PER_MM2
    if not area_um2:
        return None
    n_pairs = len(first.xy_um) * len(second.xy_um)
    if within_um is not None or not n_pairs:
        return n_pairs * np.pi * (within_um or 0.0) ** 2 / area_um2
    every = -(-n_pairs // MOST_PAIRS)
    some = second.covariance[::every] + LEAST_U_UM**2 * np.eye(2)
    sizes = sum(float(np.sqrt(np.linalg.det(own + some)).sum()) for own in first.covariance)
    return np.pi * MOST_CHI_SQUARED * sizes / area_um2 * len(second.xy_um) / len(some)


def _words(first: WaferDefects, second: WaferDefects, shift: Place) -> str:
    if first.grid is not None and second.grid is not None:
        return "dies by their numbers" if shift == (0, 0) else f"die 0,0 is die {shift[0]},{shift[1]} before, by place"
    both = first.center is not None and second.center is not None
    return "places from the wafer's centre" if both else "places on the stage"


def _notes(first: WaferDefects, second: WaferDefects) -> Iterator[str]:
    if first.wafer and second.wafer and (first.lot, first.wafer) != (second.lot, second.wafer):
        yield f"The files state different wafers: {first.title} and {second.title}."
    if not (first.inspected_dies and second.inspected_dies):
        yield "Without dies it is not known what the other inspection inspected: added may have been overlooked."


def _listed(name: str, defects: Sequence[WaferDefect]) -> Iterator[StatisticsRow]:
    for defect in defects:
        die = f"die {defect.die}, " if defect.die else ""
        remark = f"{die}x {defect.x_um:.1f}, y {defect.y_um:.1f} um"
        length = defect.length_um if defect.resolved else None
        yield StatisticsRow(
            table=name, item=f"{defect.number}", quantity=defect.kind, value=length, unit="um", remark=remark
        )


def _common_rows(second: WaferDefects, common: Sequence[CommonDefect]) -> Iterator[StatisticsRow]:
    by_number = {defect.number: defect for defect in second.defects}
    for pair in common:
        (row,) = _listed("common", [by_number[pair.second]])
        before = f"was {pair.first}, moved by {pair.dx_um:.1f}, {pair.dy_um:.1f} um"
        yield StatisticsRow(
            table=row.table,
            item=row.item,
            quantity=row.quantity,
            value=row.value,
            unit=row.unit,
            remark=f"{row.remark}; {before}",
        )
