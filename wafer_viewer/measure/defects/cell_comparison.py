"""Comparison of a row of cells with their reference: pure, so that rows can run on other workers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.measure.defects.array_rim import beyond_wafer, lies_in_outer_street, open_sides, outer_street
from wafer_viewer.measure.defects.die_form import DieForm
from wafer_viewer.measure.defects.golden_die import SPREAD, ReferenceDie, die_shift, evenly_spaced, robust_sigma
from wafer_viewer.measure.defects.matched_filters import contrast_of, is_plain, spectrum_of, subtract_local_mean
from wafer_viewer.measure.defects.noise_model import NoiseModel, kinds_of, noise_of
from wafer_viewer.measure.defects.scores import (
    Mask,
    Residual,
    add_to_peak_histogram,
    new_counts,
    picture_quotient,
    quotients,
    residual_of,
    scores_of,
)
from wafer_viewer.measure.defects.segmentation import DefectPiece, Where, pieces_of
from wafer_viewer.measure.defects.terraces import over_levels
from wafer_viewer.measure.dies.die_cells import CellGrid, CellSource, CellStrip, Place, Plane, Read, Shift
from wafer_viewer.model.inspection.defect import DefectRecipe

NOISE_CELLS = 24
"""Largest number of cells for the noise estimate."""
NOISE_PIXELS = 20_000_000
"""Largest number of their pixels together; it bounds the memory."""
LEAST_NOISE_CELLS = 5
"""Number of cells for the noise estimate whatever their size."""
LEAST_MEASURED = 0.02
"""Smallest measured fraction of a cell for its comparison."""
LEAST_KNOWN = 0.5
"""Smallest scanned fraction of the cell of a die for its comparison."""

DIFFERS_SIGMA = 5
"""Deviation from the reference, in spreads of its position, from which a pixel differs."""


@dataclass(frozen=True, slots=True, eq=False)
class ComparisonWork:
    """Reference and settings of the comparison of all cells.

    on_dies: cells are dies, which are registered and flattened; excluded: mask of the pixels of every cell to ignore;
    missing: places without a die.
    """

    source: CellSource
    cells: CellGrid
    golden: ReferenceDie
    recipe: DefectRecipe
    on_dies: bool
    excluded: Mask | None = None
    missing: frozenset[Place] = frozenset()


@dataclass(frozen=True, slots=True, eq=False)
class CellResult:
    """Result of one cell: pieces, histogram of peaks, form of the die, compared and missing pixels."""

    place: Place
    pieces: list[DefectPiece] = field(default_factory=list[DefectPiece])
    peaks: NDArray[np.int64] = field(default_factory=new_counts)
    form: DieForm = DieForm()
    compared_px: int = 0
    missing_px: int = 0
    differs_fraction: float = 0.0


def compare_cells(work: ComparisonWork, places: Sequence[Place], noise: NoiseModel) -> list[CellResult]:
    """Compare adjacent cells with their reference; the surface is read once for all of them."""
    strip = work.source.strip(work.cells.around_all(places))
    return [CellResult(place) if strip is None else _result(work, strip, place, noise) for place in places]


def estimate_noise(work: ComparisonWork, places: tuple[Place, ...]) -> NoiseModel:
    """Return the typical noise at each scale, estimated from a subset of the cells."""
    most = min(NOISE_CELLS, max(LEAST_NOISE_CELLS, NOISE_PIXELS // math.prod(work.cells.shape)))
    read = (_residual(work, work.source, place) for place in evenly_spaced(places, most))
    some = [found[0] for found in read if found is not None]
    spectrum = spectrum_of(picture_quotient(residual, work.golden) for residual in some)
    found = [quotients(residual, work.golden, work.recipe, spectrum) for residual in some]
    return noise_of(found, kinds_of(work.golden), spectrum)


@dataclass(frozen=True, slots=True)
class Plainness:
    """Reference of a surface without dies: scatter of heights and of the image, and whether the image is plain."""

    z_um: float
    grey: float
    plain: bool


def estimate_plainness(source: CellSource, cells: CellGrid, places: tuple[Place, ...]) -> Plainness:
    """Estimate the plainness from a few cells: heights over the form, image against its local mean."""
    sides = slice(0, cells.shape[0]), slice(0, cells.shape[1])
    read = (source.read(cells, place, *sides, (0.0, 0.0)) for place in evenly_spaced(places, NOISE_CELLS))
    over = ((over_levels(cell[0], source.levels_um), cell[1]) for cell in read if cell is not None)
    many = [(robust_sigma(z if walls is None else z[~walls]), *contrast_of(grey)) for (z, walls), grey in over]
    z, grey, patterned = np.array(many).reshape(-1, 3).T
    return Plainness(max(1e-6, _usual(z)), max(SPREAD.least_contrast, _usual(grey)), is_plain(patterned))


def _usual(each: NDArray[np.float64]) -> float:
    finite = each[np.isfinite(each)]
    return float(np.median(finite)) if finite.size else 1.0


def _residual(work: ComparisonWork, source: Read, place: Place) -> tuple[Residual, Shift] | None:
    shift = die_shift(source, work.cells, place, work.golden) if work.on_dies else (0.0, 0.0)
    if shift is None:
        return None
    rows, cols = work.cells.shape
    cell = source.read(work.cells, place, slice(0, rows), slice(0, cols), shift)
    if cell is None or np.isfinite(cell[0]).mean() < LEAST_MEASURED:
        return None
    if work.on_dies and np.isfinite(cell[1]).mean() < LEAST_KNOWN:
        return None
    excluded = work.excluded
    if not work.on_dies:
        z_um, excluded = over_levels(cell[0], work.source.levels_um)
        cell = z_um, subtract_local_mean(cell[1]) if work.recipe.evidence != "height" else cell[1]
    elif (beyond := beyond_wafer(cell[0], work.golden.z_um, _sides(work, place))) is not None:
        cell = _less(cell[0], beyond), _less(cell[1], beyond)
    die = work.cells.die if work.on_dies else None
    return residual_of(place, cell, work.golden, work.cells.pixel_um, die, excluded), shift


def _sides(work: ComparisonWork, place: Place) -> frozenset[Place]:
    return open_sides(work.cells, place, work.missing) if work.on_dies else frozenset()


def _less(plane: Plane, mask: Mask) -> Plane:
    return np.where(mask, np.float32(np.nan), plane)


def _result(work: ComparisonWork, strip: CellStrip, place: Place, noise: NoiseModel) -> CellResult:
    found = _residual(work, strip, place)
    if found is None:
        return CellResult(place)
    residual, shift = found
    scores = scores_of(quotients(residual, work.golden, work.recipe, noise.spectrum), noise)
    where, counts = Where(work.cells, shift), new_counts()
    add_to_peak_histogram(scores, work.recipe, work.cells.shape, counts)
    pieces = pieces_of(residual, scores, work.golden.z_spread_um, work.recipe, where)
    compared = np.isfinite(residual.z_um)
    if sides := _sides(work, place):
        grid = work.cells.grid
        pieces = [one for one in pieces if not lies_in_outer_street(grid, place, sides, one.x_um, one.y_um)]
        compared &= ~outer_street(work.cells, sides)
    return CellResult(
        place,
        pieces,
        counts,
        residual.form,
        int(np.count_nonzero(compared)),
        int(np.count_nonzero(residual.missing)),
        _differs(residual.z_um, work.golden.z_spread_um),
    )


def _differs(z_um: Plane, spread_um: Plane) -> float:
    """Return the fraction of the compared pixels that deviate far from the reference."""
    some, by = np.abs(z_um[::3, ::3]), DIFFERS_SIGMA * spread_um[::3, ::3]
    finite = np.isfinite(some) & np.isfinite(by)
    return float((some[finite] > by[finite]).mean()) if finite.any() else 0.0
