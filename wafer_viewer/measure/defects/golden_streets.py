"""Streets for a stored golden die, which has none, from the wafer's own dies. Pure."""

from __future__ import annotations

import dataclasses

import numpy as np

from wafer_viewer.measure.defects.golden_die import LEAST_DIES, ReferenceDie, die_shift, evenly_spaced, golden_of
from wafer_viewer.measure.dies.die_cells import CellGrid, CellSource, Place, Plane
from wafer_viewer.model.errors import MeasureError

LAID_BY = 8
"""Number of dies used to find the offset between the wafer's median die and the stored one."""
NOT_INSPECTED = "The streets are not in the golden die, and too few dies are measured to compare them: not inspected."
BY_THEMSELVES = "The streets are not in the golden die: each is compared with those of the other dies."


def add_median_streets(
    stored: ReferenceDie, source: CellSource, cells: CellGrid, places: tuple[Place, ...]
) -> tuple[ReferenceDie, tuple[str, ...]]:
    """Return a stored golden die with the median streets of this surface, and notes on them.

    Without five measured dies the streets remain unknown.
    """
    if not sum(cells.street):
        return stored, ()
    try:
        own = golden_of(source, cells, places) if len(places) >= LEAST_DIES else None
    except MeasureError:
        own = None
    off = _lies_off(stored, own, source, cells) if own is not None else None
    if own is None or off is None:
        return stored, (NOT_INSPECTED,)
    return _beside(stored, own, off), (BY_THEMSELVES,)


def streets_known(golden: ReferenceDie, cells: CellGrid) -> bool:
    """Return whether the reference of a cell knows its streets, or has none; tested at the line next to the die."""
    top, left = cells.street
    beside = golden.z_um[top - 1] if top else golden.z_um[:, left - 1]
    return not (top or left) or bool(np.isfinite(beside).any())


def _lies_off(stored: ReferenceDie, own: ReferenceDie, source: CellSource, cells: CellGrid) -> np.ndarray | None:
    """Return the offset (down, right) in pixels of the stored die relative to the wafer's own median die."""
    some = evenly_spaced(tuple(own.shifts), LAID_BY)
    laid = {place: die_shift(source, cells, place, stored) for place in some}
    off = [np.subtract(shift, own.shifts[place]) for place, shift in laid.items() if shift is not None]
    return np.median(off, axis=0) if off else None


def _beside(stored: ReferenceDie, own: ReferenceDie, off: np.ndarray) -> ReferenceDie:
    pairs = {
        "z_um": _levelled(_moved(own.z_um, off), stored.z_um),
        "picture": _levelled(_moved(own.picture, off), stored.picture),
        "z_spread_um": _moved(own.z_spread_um, off),
        "picture_spread": _moved(own.picture_spread, off),
    }
    planes = {name: np.where(np.isfinite(stored.z_um), getattr(stored, name), plane) for name, plane in pairs.items()}
    return dataclasses.replace(stored, **planes)


def _moved(plane: Plane, off: np.ndarray) -> Plane:
    from scipy.ndimage import shift

    return np.asarray(shift(plane, -off, order=1, cval=np.nan), np.float32)


def _levelled(plane: Plane, like: Plane) -> Plane:
    """Shift a plane to the level of the stored die, by pixels known in both."""
    return plane - np.float32(np.nanmedian(plane - like))
