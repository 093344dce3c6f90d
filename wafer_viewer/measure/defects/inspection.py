"""Finds what is wrong on a patterned wafer: each die against the typical one, a stored golden one, or the fitted form.

An empty list says nothing by itself: an inspection tells what was compared with what, how much of it was measured, and
how many false defects are to be expected.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import closing

import numpy as np

from wafer_viewer.measure.base.measurement_context import MeasurementContext
from wafer_viewer.measure.defects.background_contrast import LEFT_OUT, LOOKED_AT
from wafer_viewer.measure.defects.border_merge import merged
from wafer_viewer.measure.defects.cell_comparison import (
    CellResult,
    ComparisonWork,
    compared,
    noise_over,
    plainness_over,
)
from wafer_viewer.measure.defects.defect_builder import defect_of
from wafer_viewer.measure.defects.die_level_defects import marked_repeats, whole_die_defects
from wafer_viewer.measure.defects.exclusion_areas import excluded_of, notes_on
from wafer_viewer.measure.defects.golden_die import LEAST_DIES, ReferenceDie, golden_die, golden_of
from wafer_viewer.measure.defects.golden_streets import streets_known, with_own_streets
from wafer_viewer.measure.defects.noise_model import NoiseModel
from wafer_viewer.measure.defects.scores import false_counts
from wafer_viewer.measure.defects.terraces import SEVERAL_LEVELS, WALL_PX, terraced
from wafer_viewer.measure.dies.die_cells import CellGrid, CellSource, Place, source_of
from wafer_viewer.measure.dies.die_status import not_scanned_mm2, statuses, without_bare_rim
from wafer_viewer.model.errors import DiesNotFound, MeasureError
from wafer_viewer.model.inspection.defect import Defect, DefectRecipe, Inspection, Reference
from wafer_viewer.model.inspection.die_grid import DieGrid, DieStatus
from wafer_viewer.model.inspection.golden_die import GoldenDie
from wafer_viewer.model.progress import Progress, ShouldStop
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.height_map import Mosaic

TILE_PX = 1024
"""Without a grid a surface is gone through in squares of so many pixels."""
MOST_DEFECTS = 5000
OTHER_PRODUCT = 0.1
Row = list[CellResult]
RowsBy = Callable[[ComparisonWork, NoiseModel, Sequence[tuple[Place, ...]]], Generator[Row]]
"""Hands that do ``compared(work, row, noise)`` for each of the rows, and give what came of it in their order."""


def inspect(
    surface: Mosaic,
    grid: DieGrid | None = None,
    recipe: DefectRecipe = DefectRecipe(),
    golden: GoldenDie | None = None,
    *,
    calibration_valid: bool = True,
    progress: Progress | None = None,
    should_stop: ShouldStop | None = None,
    rows_by: RowsBy | None = None,
    no_dies: str = "No grid of dies",
) -> Inspection:
    """The defects of a surface, strongest first, with what was inspected.

    grid: where its dies lie; fewer than five measured dies, or no grid: compared with the fitted form. golden: a stored
    golden die to compare with instead, which shows what repeats in every die. progress: told the part done, 0 to 1.
    rows_by: who compares the rows of dies, this thread by default; whoever does, what comes of it is the same. no_dies:
    why there is no grid, for the notes.

    Raises MeasureError where hardly anything is measured, the grid lies beside the surface, the golden die is of
    something else, or the work was stopped.
    """
    reading = MeasurementContext.of(surface, None, calibration_valid)
    source = source_of(surface, reading.layer, recipe.form_order)
    dies = statuses(surface, grid) if grid is not None else ()
    on_dies = without_bare_rim(grid, dies) if grid is not None else None
    work, reference, notes = _work(source, on_dies, recipe, golden, no_dies)
    places = work.cells.grid.places
    noise = noise_over(work, places)
    rows = work.cells.side_by_side(places)
    with closing((rows_by or _one_by_one)(work, noise, rows)) as by_row:
        results = [result for row in _watched(by_row, len(rows), progress, should_stop) for result in row]
    _require_likeness(results, golden)
    whole = whole_die_defects(results, work, reading, noise) if work.on_dies else {}
    defects = _defects(results, whole, work, reading)
    if reference == "golden":
        defects = marked_repeats(defects, sum(result.compared_px > 0 for result in results), surface.pixel_um)
    notes = (*notes, *_of_the_rim(grid, on_dies), *notes_on(recipe.excluded, work.excluded, work.on_dies))
    return _inspection(work, results, defects, reference, notes, reading, grid, dies)


def golden_of_surface(
    surface: Mosaic, grid: DieGrid, recipe: DefectRecipe = DefectRecipe(), **told: str | bool
) -> GoldenDie:
    """The typical die of a surface, to be stored; told: product, name, made_of and the like of its header.

    Raises MeasureError where fewer than five dies are measured.
    """
    reading = MeasurementContext.of(surface, None, True)
    source = source_of(surface, reading.layer, recipe.form_order)
    cells = CellGrid.of(without_bare_rim(grid, statuses(surface, grid)), surface.pixel_um)
    told = {"product": recipe.product, "simulated": surface.provenance.simulated, **told}
    return golden_die(golden_of(source, cells, _on_surface(source, cells)), cells, source.dark, **told)


def _work(
    source: CellSource, grid: DieGrid | None, recipe: DefectRecipe, golden: GoldenDie | None, no_dies: str
) -> tuple[ComparisonWork, Reference, tuple[str, ...]]:
    """What cells are compared with: a stored golden die, the typical one of the dies, or the form."""
    if grid is None:
        if golden is not None:
            raise MeasureError(
                "A golden die is compared die by die: say where the dies lie, or compare with the fitted form."
            )
        return _by_form(source, recipe, no_dies)
    cells = CellGrid.of(grid, source.surface.pixel_um)
    places, excluded = _on_surface(source, cells), excluded_of(recipe.excluded, cells)
    if golden is not None:
        sizes = {"width_um": grid.width_um, "height_um": grid.height_um}
        golden.require_fit(product=recipe.product, pixel_um=source.surface.pixel_um, **sizes)
        stored, notes = with_own_streets(ReferenceDie.stored(golden, cells, source.dark), source, cells, places)
        return ComparisonWork(source, cells, stored, recipe, True, excluded), "golden", notes
    if len(places) < LEAST_DIES:
        dies = "1 die" if len(places) == 1 else f"{len(places)} dies"
        return _by_form(source, recipe, f"{dies} found, {LEAST_DIES} needed to compare die to die")
    try:
        median = golden_of(source, cells, places)
    except DiesNotFound as few:
        return _by_form(source, recipe, few.brief)
    return ComparisonWork(source, cells, median, recipe, True, excluded), "dies", ()


def _by_form(source: CellSource, recipe: DefectRecipe, why: str) -> tuple[ComparisonWork, Reference, tuple[str, ...]]:
    """In squares, against what lies on the form everywhere; the picture, where it is plain, against what is around."""
    surface = source.surface
    rows, cols = surface.shape
    n_rows, n_cols = math.ceil(rows / TILE_PX), math.ceil(cols / TILE_PX)
    side = math.ceil(rows / n_rows) * surface.pixel_um, math.ceil(cols / n_cols) * surface.pixel_um
    half = surface.pixel_um / 2
    tiles = DieGrid(
        pitch_x_um=side[1],
        pitch_y_um=side[0],
        width_um=side[1],
        height_um=side[0],
        x0_um=surface.x0_um - half,
        y0_um=surface.y0_um + half - n_rows * side[0],
        rows=n_rows,
        cols=n_cols,
    )
    cells = CellGrid.of(tiles, surface.pixel_um)
    source = terraced(source, recipe.form_order)
    by = plainness_over(source, cells, tiles.places)
    notes = [f"{why}: compared with the fitted form."]
    if recipe.evidence != "height":
        notes.append(LOOKED_AT if by.plain else LEFT_OUT)
    if len(source.levels_um) > 1:
        notes.append(SEVERAL_LEVELS.format(len(source.levels_um), WALL_PX))
    seen = recipe if by.plain else replace(recipe, evidence="height")
    return (
        ComparisonWork(source, cells, ReferenceDie.nothing(cells.shape, by.z_um, by.grey), seen, False),
        "form",
        tuple(notes),
    )


def _of_the_rim(grid: DieGrid | None, on_dies: DieGrid | None) -> tuple[str, ...]:
    bare = len(on_dies.left_out) - len(grid.left_out) if grid is not None and on_dies is not None else 0
    places = "1 place" if bare == 1 else f"{bare} places"
    return (f"No die is seen at {places} round the others: nothing was inspected there.",) if bare else ()


def _on_surface(source: CellSource, cells: CellGrid) -> tuple[Place, ...]:
    """The dies whose middle lies on the surface. Raises MeasureError where there is none."""
    surface, grid = source.surface, cells.grid
    found: list[Place] = []
    for place in grid.places:
        x_um, y_um = (float(a) for a in grid.to_stage(*place, grid.width_um / 2, grid.height_um / 2))
        row, col = (surface.y0_um - y_um) / surface.pixel_um, (x_um - surface.x0_um) / surface.pixel_um
        if 0 <= row < surface.shape[0] and 0 <= col < surface.shape[1]:
            found.append(place)
    if not found:
        raise MeasureError("No die of the grid lies on the surface: give its origin in stage um, or find the dies.")
    return tuple(found)


def _one_by_one(work: ComparisonWork, noise: NoiseModel, rows: Sequence[tuple[Place, ...]]) -> Generator[Row]:
    return (compared(work, row, noise) for row in rows)


def _watched(rows: Iterable[Row], n: int, progress: Progress | None, should_stop: ShouldStop | None) -> Iterator[Row]:
    for k, row in enumerate(rows, 1):
        if should_stop is not None and should_stop():
            raise MeasureError("The inspection was stopped: nothing of it is kept.")
        if progress is not None:
            progress(k / n)
        yield row


def _require_likeness(results: Sequence[CellResult], golden: GoldenDie | None) -> None:
    """A golden die from which most dies differ nearly everywhere is none of theirs."""
    differing = [result.differs_fraction for result in results if result.compared_px]
    if not differing:
        raise MeasureError("No die could be compared: the grid lies where the surface is not measured.")
    if golden is not None and float(np.median(differing)) > OTHER_PRODUCT:
        raise MeasureError(
            f"The golden die {golden.title} is not like the dies of this surface: {np.median(differing):.0%} of them "
            "differs; choose one of this product."
        )


def _defects(
    results: Sequence[CellResult], whole: dict[str, Defect], work: ComparisonWork, reading: MeasurementContext
) -> tuple[Defect, ...]:
    """Strongest first and numbered, those of a whole die instead of what lies on it."""
    pieces = [
        piece for result in results for piece in result.pieces if work.cells.grid.name(*result.place) not in whole
    ]
    together = merged(pieces, work.cells.pixel_um)
    strongest = sorted(together, key=lambda group: -max(piece.score for piece in group))[:MOST_DEFECTS]
    single = [defect_of(group, work.cells, reading, work.recipe, work.on_dies) for group in strongest]
    ordered = sorted([*whole.values(), *single], key=lambda d: -d.score)
    return tuple(replace(defect, number=n, name=f"Defect {n}") for n, defect in enumerate(ordered, 1))


def _inspection(
    work: ComparisonWork,
    results: Sequence[CellResult],
    defects: tuple[Defect, ...],
    reference: Reference,
    notes: tuple[str, ...],
    reading: MeasurementContext,
    grid: DieGrid | None,
    dies: Sequence[DieStatus],
) -> Inspection:
    """What was compared with what, and what came of it."""
    mm2 = work.cells.pixel_um**2 / 1e6
    inspected_mm2 = sum(result.compared_px for result in results) * mm2
    counted = false_counts(np.sum([result.peaks for result in results], axis=0), inspected_mm2)
    most = (f"Only the strongest {MOST_DEFECTS} places are listed.",) if len(defects) >= MOST_DEFECTS else ()
    return Inspection(
        recipe=work.recipe,
        reference=reference,
        grid=grid,
        dies=_with_defects(dies, defects, not work.on_dies or streets_known(work.golden, work.cells)),
        defects=defects,
        inspected_mm2=inspected_mm2,
        unmeasured_mm2=sum(_missing_px(result, work.cells) for result in results) * mm2,
        not_scanned_mm2=not_scanned_mm2(reading.surface) if grid is None else 0.0,
        threshold_sigma=work.recipe.threshold_sigma,
        expected_false_per_mm2=counted.at(work.recipe.threshold_sigma),
        false_counts=counted,
        surface=reading.layer,
        product=work.recipe.product,
        simulated=reading.surface.provenance.simulated,
        notes=(*(grid.notes if grid is not None else ()), *notes, *most),
    )


def _missing_px(result: CellResult, cells: CellGrid) -> int:
    """A cell of which nothing was compared lacks all its pixels."""
    return result.missing_px if result.compared_px else math.prod(cells.shape)


def _with_defects(dies: Sequence[DieStatus], defects: Sequence[Defect], streets: bool) -> tuple[DieStatus, ...]:
    """How many defects lie on every die; streets: whether these were looked at."""
    on = Counter(defect.die for defect in defects)
    return tuple(replace(die, defects=on[die.name], street_inspected=streets) for die in dies)
