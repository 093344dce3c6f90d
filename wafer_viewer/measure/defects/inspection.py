"""Inspection of a patterned wafer: each die against the median die, a stored golden die or its own surroundings.

An empty list of defects is no result by itself. An inspection reports the reference, the measured area and the expected
number of false defects.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import replace as with_changes

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.measure.base.measurement_context import MeasurementContext
from wafer_viewer.measure.defects.cell_comparison import (
    CellResult,
    ComparisonWork,
    compare_cells,
    estimate_noise,
    estimate_plainness,
)
from wafer_viewer.measure.defects.defect_builder import defect_of, mark_repeaters, on_lattice
from wafer_viewer.measure.defects.die_level import die_forms, measured_die, whole_die_defects
from wafer_viewer.measure.defects.golden_die import (
    ReferenceDie,
    add_median_streets,
    golden_die,
    golden_of,
    streets_measured,
)
from wafer_viewer.measure.defects.matched_filters import LEFT_OUT, LOOKED_AT
from wafer_viewer.measure.defects.noise_model import NoiseModel
from wafer_viewer.measure.defects.scores import false_counts
from wafer_viewer.measure.defects.segmentation import merge_border_pieces
from wafer_viewer.measure.defects.terraces import SEVERAL_LEVELS, TERRACES, terraced
from wafer_viewer.measure.dies.die_cells import CellGrid, CellSource, Place, source_of
from wafer_viewer.measure.dies.die_status import not_scanned_mm2, statuses, without_bare_rim
from wafer_viewer.measure.dies.lattice_evidence import bounds_of
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.inspection.defect import (
    FORM_SEES,
    Against,
    Defect,
    DefectRecipe,
    Inspection,
    Reference,
    require_dies_for,
)
from wafer_viewer.model.inspection.die_grid import DieGrid, DieMeasurement, DieStatus
from wafer_viewer.model.inspection.golden_die import GoldenDie
from wafer_viewer.model.progress import Progress, ShouldStop
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.height_map import Mosaic

NO_DIES = "No area was left out: the recipe's are areas of dies, and nothing was compared die by die."
Mask = NDArray[np.bool_]


def exclusion_mask(regions: Sequence[Region], cells: CellGrid) -> Mask | None:
    """Return the mask of a cell, bool [row, col], for regions in um from the die's lower left corner.

    None where no pixel is excluded.
    """
    out = np.zeros(cells.shape, bool)
    for region in regions:
        rows, cols = _around(region, cells)
        u_um, v_um = cells.in_die(
            np.arange(rows.start, rows.stop)[:, None] + 0.0, np.arange(cols.start, cols.stop) + 0.0
        )
        out[rows, cols] |= region.contains(u_um, v_um)
    return out if out.any() else None


def notes_on(regions: Sequence[Region], excluded: Mask | None, on_dies: bool) -> tuple[str, ...]:
    """Return the note on the excluded areas; none if no area was requested."""
    if not regions:
        return ()
    if not on_dies:
        return (NO_DIES,)
    share = 0.0 if excluded is None else float(excluded.mean())
    areas = "1 area" if len(regions) == 1 else f"{len(regions)} areas"
    return (f"Left out of every die, as the recipe asks: {areas}, {100 * share:.2g} % of die and street.",)


def _around(region: Region, cells: CellGrid) -> tuple[slice, slice]:
    """Return the rows and columns of a cell that may intersect a region."""
    x0, y0, x1, y1 = (um / cells.pixel_um for um in region.bounds_um)
    top, left = cells.street[0] + cells.grid.height_um / cells.pixel_um, cells.street[1]
    return _within(top - y1, top - y0, cells.shape[0]), _within(left + x0, left + x1, cells.shape[1])


def _within(low: float, high: float, n: int) -> slice:
    return slice(min(n, max(0, int(low) - 1)), min(n, max(0, int(high) + 2)))


TILE_PX = 1024
"""Approximate largest side of a tile of a surface without a die grid, px."""
BEYOND_STEPS = 32
"""Sample points along each side of a cell for the part of it that lies beyond the surface."""
MOST_DEFECTS = 5000
"""Largest number of defects of an inspection, the strongest ones."""
OTHER_PRODUCT = 0.1
"""Median fraction of a die that differs, above which the golden die is of another product."""
Row = list[CellResult]
RowsBy = Callable[[ComparisonWork, NoiseModel, Sequence[tuple[Place, ...]]], Generator[Row]]
"""Runner of ``compared(work, row, noise)`` for each row, which yields the results in row order."""


def inspect(
    surface: Mosaic,
    grid: DieGrid | None = None,
    recipe: DefectRecipe = DefectRecipe(),
    golden: GoldenDie | None = None,
    *,
    against: Against = "dies",
    calibration_valid: bool = True,
    progress: Progress | None = None,
    should_stop: ShouldStop | None = None,
    rows_by: RowsBy | None = None,
) -> Inspection:
    """Inspect a surface for defects.

    Each die is compared with the median die of the surface or with a stored golden die. Without a grid, or if asked
    for, the surface is compared with the fitted form.

    Parameters
    ----------
    surface : Mosaic
        The surface; heights are read from the layer that its recipe measures on.
    grid : DieGrid, optional
        Die lattice, in stage um. Without one the surface is compared with the fitted form.
    recipe : DefectRecipe, optional
        Settings of the inspection, by default those of `DefectRecipe()`.
    golden : GoldenDie, optional
        A stored golden die to compare with instead of the median die, which also shows defects that repeat in every
        die. It takes a `grid`.
    against : {"dies", "form"}, default "dies"
        "form" compares with the fitted form also where a grid is given, which then places and counts the defects.
    calibration_valid : bool, default True
        False: lengths of defects have the status "uncalibrated" and no uncertainty, as without a calibration.
    progress : callable, optional
        Called with the completed fraction, 0 to 1.
    should_stop : callable, optional
        Returns True if the inspection should stop; called while the rows of dies are compared.
    rows_by : callable, optional
        Runner for the rows of dies: takes the work, the noise model and the rows, and yields the results in row order.
        By default this thread. The result does not depend on it.

    Returns
    -------
    Inspection
        The defects, strongest first, with a record of what was inspected: reference, states of the dies, inspected and
        unmeasured area in mm2, threshold in sigma, expected number of false defects per mm2, and notes.

    Raises
    ------
    DiesNotFound
        If fewer than five dies are measured and no `golden` is given: two or three dies have no typical one.
    MeasureError
        If hardly anything is measured; the limits are of defects per die and no grid is given; the grid lies off the
        surface, or where the surface is not measured; a golden die is given without a grid; the golden die is of
        another product, pixel size or die size, or most dies are not like it; or the inspection was stopped.

    Notes
    -----
    An empty list of defects is no result by itself, hence the record of the measured area and of the expected false
    defects. At most the 5000 strongest places are listed, with a note. Empty places connected to the rim of a lattice
    that does not name its dies are not inspected. The areas that the recipe excludes apply only where dies are
    compared.
    """
    require_dies_for(recipe.limits, grid is not None)
    reading = MeasurementContext.of(surface, None, calibration_valid)
    source = source_of(surface, reading.layer, recipe.form_order)
    dies = statuses(surface, grid) if grid is not None else ()
    on_dies = without_bare_rim(surface, grid, dies) if grid is not None and against == "dies" else None
    work, reference, notes = _work(source, on_dies, recipe, golden)
    missing = missing_dies(dies, work) if work.on_dies else set[Place]()
    work = with_changes(work, missing=frozenset(missing))
    places = work.cells.grid.places
    noise = estimate_noise(work, places)
    rows = work.cells.side_by_side(places)
    with closing((rows_by or _one_by_one)(work, noise, rows)) as by_row:
        results = [result for row in _watched(by_row, len(rows), progress, should_stop) for result in row]
    _require_likeness(results, golden)
    forms = die_forms(results, missing) if work.on_dies else {}
    whole_dies = whole_die_defects(forms, missing, work, reading) if work.on_dies else {}
    defects = _defects(results, whole_dies, work, reading)
    if grid is not None and not work.on_dies:
        defects = on_lattice(defects, grid)
    if reference == "golden":
        defects = mark_repeaters(defects, sum(result.compared_px > 0 for result in results), surface.pixel_um)
    notes = (*notes, *_of_the_rim(grid, on_dies), *notes_on(recipe.excluded, work.excluded, work.on_dies))
    simulated = surface.provenance.simulated or (golden is not None and golden.header.simulated)
    defects = tuple(replace(defect, simulated=simulated) for defect in defects)
    measured = {work.cells.grid.name(*place): measured_die(form, reading) for place, form in forms.items()}
    dies = _with_defects(dies, defects, work, results, measured)
    return _inspection(work, results, defects, reference, notes, reading, grid, dies, simulated)


def golden_of_surface(
    surface: Mosaic, grid: DieGrid, recipe: DefectRecipe = DefectRecipe(), **metadata: str | bool
) -> GoldenDie:
    """Return the median die of a surface as a golden die, for storage.

    Parameters
    ----------
    surface : Mosaic
        The surface; heights are read from the layer that its recipe measures on.
    grid : DieGrid
        Die lattice, in stage um.
    recipe : DefectRecipe, optional
        Gives the order of the form that is removed first, and the product. By default `DefectRecipe()`.
    **metadata : str or bool
        Fields of the header: `product`, `name`, `made_of`, `made_at`, `software_version`, `simulated`. By default the
        product of the recipe, and whether the surface is simulated.

    Returns
    -------
    GoldenDie
        Robust median and robust standard deviation (1.4826 MAD) over the dies, of the heights over the form in um and
        of the all-in-focus image in grey levels; float32 [row, col] at the pixel size of the surface, without the
        streets.

    Raises
    ------
    MeasureError
        If hardly anything is measured, no die of the lattice lies on the surface, or fewer than five dies are measured
        in their middle (`DiesNotFound`).
    TypeError
        If `metadata` names no field of the header, or one that follows from the surface (`dies`, `pixel_um`,
        `width_um`, `height_um`).

    Notes
    -----
    At most 32 dies, evenly spaced, are used; they are registered to each other to subpixel accuracy.
    """
    reading = MeasurementContext.of(surface, None, True)
    source = source_of(surface, reading.layer, recipe.form_order)
    cells = CellGrid.of(without_bare_rim(surface, grid, statuses(surface, grid)), surface.pixel_um)
    metadata = {"product": recipe.product, "simulated": surface.provenance.simulated, **metadata}
    return golden_die(golden_of(source, cells, _on_surface(source, cells)), cells, source.dark, **metadata)


def _work(
    source: CellSource, grid: DieGrid | None, recipe: DefectRecipe, golden: GoldenDie | None
) -> tuple[ComparisonWork, Reference, tuple[str, ...]]:
    """Return the comparison work, reference kind and notes.

    The reference is a stored golden die, the median die, or the form.

    Raises
    ------
    DiesNotFound
        If fewer than five dies are measured, and no golden die is given.
    MeasureError
        If a golden die is given without a lattice of dies.
    """
    if grid is None:
        if golden is not None:
            raise MeasureError(
                "A golden die is compared die by die: say where the dies lie, or compare with the fitted form."
            )
        return _by_form(source, recipe)
    cells = CellGrid.of(grid, source.surface.pixel_um)
    places, excluded = _on_surface(source, cells), exclusion_mask(recipe.excluded, cells)
    if golden is not None:
        sizes = {"width_um": grid.width_um, "height_um": grid.height_um}
        golden.require_fit(product=recipe.product, pixel_um=source.surface.pixel_um, **sizes)
        stored, notes = add_median_streets(ReferenceDie.stored(golden, cells, source.dark), source, cells, places)
        return ComparisonWork(source, cells, stored, recipe, True, excluded), "golden", notes
    return ComparisonWork(source, cells, golden_of(source, cells, places), recipe, True, excluded), "dies", ()


def _by_form(source: CellSource, recipe: DefectRecipe) -> tuple[ComparisonWork, Reference, tuple[str, ...]]:
    """Return the work for tiles compared with the fitted form, and a plain image with its local mean."""
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
    by = estimate_plainness(source, cells, tiles.places)
    notes = [FORM_SEES]
    if recipe.evidence != "height":
        notes.append(LOOKED_AT if by.plain else LEFT_OUT)
    if len(source.levels_um) > 1:
        notes.append(SEVERAL_LEVELS.format(len(source.levels_um), TERRACES.wall_px))
    shown = recipe if by.plain else replace(recipe, evidence="height")
    return (
        ComparisonWork(source, cells, ReferenceDie.nothing(cells.shape, by.z_um, by.grey), shown, False),
        "form",
        tuple(notes),
    )


def _of_the_rim(grid: DieGrid | None, on_dies: DieGrid | None) -> tuple[str, ...]:
    bare = len(on_dies.left_out) - len(grid.left_out) if grid is not None and on_dies is not None else 0
    places = "1 place" if bare == 1 else f"{bare} places"
    return (f"No die is seen at {places} round the others: nothing was inspected there.",) if bare else ()


def _on_surface(source: CellSource, cells: CellGrid) -> tuple[Place, ...]:
    """Return the dies with their centre on the surface. Raises MeasureError where there is none."""
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
    return (compare_cells(work, row, noise) for row in rows)


def _watched(rows: Iterable[Row], n: int, progress: Progress | None, should_stop: ShouldStop | None) -> Iterator[Row]:
    for k, row in enumerate(rows, 1):
        if should_stop is not None and should_stop():
            raise MeasureError("The inspection was stopped: nothing of it is kept.")
        if progress is not None:
            progress(k / n)
        yield row


def _require_likeness(results: Sequence[CellResult], golden: GoldenDie | None) -> None:
    """Raise MeasureError if no die was compared, or most dies differ nearly everywhere from the golden die."""
    differing = [result.differs_fraction for result in results if result.compared_px]
    if not differing:
        raise MeasureError("No die could be compared: the grid lies where the surface is not measured.")
    if golden is not None and float(np.median(differing)) > OTHER_PRODUCT:
        raise MeasureError(
            f"The golden die {golden.title} is not like the dies of this surface: {np.median(differing):.0%} of them "
            "differs; choose one of this product."
        )


def _defects(
    results: Sequence[CellResult], whole_dies: dict[str, Defect], work: ComparisonWork, reading: MeasurementContext
) -> tuple[Defect, ...]:
    """Return defects numbered by descending score; nothing else is said of a die that is missing."""
    missing = {name for name, defect in whole_dies.items() if defect.kind == "missing die"}
    pieces = [
        piece for result in results for piece in result.pieces if work.cells.grid.name(*result.place) not in missing
    ]
    together = merge_border_pieces(pieces, work.cells.pixel_um)
    strongest = sorted(together, key=lambda group: -max(piece.score for piece in group))[:MOST_DEFECTS]
    single = [defect_of(group, work.cells, reading, work.recipe, work.on_dies) for group in strongest]
    ordered = sorted([*whole_dies.values(), *single], key=lambda d: -d.score)
    return tuple(replace(defect, number=n, name=f"Defect {n}") for n, defect in enumerate(ordered, 1))


def missing_dies(dies: Sequence[DieStatus], work: ComparisonWork) -> set[Place]:
    """Return the places of the compared lattice at which no die is seen."""
    return {(die.col, die.row) for die in dies if die.state == "missing"}.intersection(work.cells.grid.places)


def _inspection(
    work: ComparisonWork,
    results: Sequence[CellResult],
    defects: tuple[Defect, ...],
    reference: Reference,
    notes: tuple[str, ...],
    reading: MeasurementContext,
    grid: DieGrid | None,
    dies: Sequence[DieStatus],
    simulated: bool,
) -> Inspection:
    """Assemble the inspection record."""
    mm2 = work.cells.pixel_um**2 / 1e6
    inspected_mm2 = sum(result.compared_px for result in results) * mm2
    counted = false_counts(np.sum([result.peaks for result in results], axis=0), inspected_mm2)
    most = (f"Only the strongest {MOST_DEFECTS} places are listed.",) if len(defects) >= MOST_DEFECTS else ()
    return Inspection(
        recipe=work.recipe,
        reference=reference,
        grid=grid,
        dies=tuple(dies),
        defects=defects,
        inspected_mm2=inspected_mm2,
        unmeasured_mm2=sum(_missing_px(result, work) for result in results) * mm2,
        not_scanned_mm2=not_scanned_mm2(reading.surface) if grid is None else 0.0,
        threshold_sigma=work.recipe.threshold_sigma,
        expected_false_per_mm2=counted.at(work.recipe.threshold_sigma),
        false_counts=counted,
        surface=reading.layer,
        product=work.recipe.product,
        simulated=simulated,
        notes=(*(grid.notes if grid is not None else ()), *notes, *most),
    )


def _missing_px(result: CellResult, work: ComparisonWork) -> float:
    """Return the missing pixels of a cell, all of them if it was not compared.

    What lies beyond the surface is missing only in a lattice that names its dies.
    """
    cells = work.cells
    missing = result.missing_px if result.compared_px else math.prod(cells.shape)
    if cells.grid.named:
        return missing
    steps = (np.arange(BEYOND_STEPS) + 0.5) / BEYOND_STEPS
    x_um, y_um = cells.to_stage(result.place, steps[:, None] * cells.shape[0] - 0.5, steps * cells.shape[1] - 0.5)
    low_x, low_y, high_x, high_y = bounds_of(work.source.surface)
    inside = (x_um > low_x) & (x_um < high_x) & (y_um > low_y) & (y_um < high_y)
    return max(0.0, missing - float((~inside).mean()) * math.prod(cells.shape))


def _with_defects(
    dies: Sequence[DieStatus],
    defects: Sequence[Defect],
    work: ComparisonWork,
    results: Sequence[CellResult],
    measured: Mapping[str, DieMeasurement],
) -> tuple[DieStatus, ...]:
    """Return die statuses with defect counts, None where a die was not compared, and with their measurements."""
    on = Counter(defect.die for defect in defects)
    streets = not work.on_dies or streets_measured(work.golden, work.cells)
    named = work.cells.grid.name
    skipped = {named(*result.place) for result in results if work.on_dies and not result.compared_px} - on.keys()
    counts = {die.name: None if die.name in skipped else on[die.name] for die in dies}
    return tuple(
        replace(die, defects=counts[die.name], street_inspected=streets, measured=measured.get(die.name))
        for die in dies
    )
