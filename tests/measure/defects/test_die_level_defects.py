"""Dies that differ as a full: none on wafers without a defect, and slivers of dies say nothing."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tests.support.campaigns import drawn_after
from tests.support.noisy_wafer import wafer
from tests.support.patterned_surface import Wafer, made
from wafer_viewer.measure.base.measurement_context import MeasurementContext
from wafer_viewer.measure.defects.cell_comparison import CellResult, ComparisonWork
from wafer_viewer.measure.defects.defect_builder import whole_die_defects
from wafer_viewer.measure.defects.golden_die import ReferenceDie
from wafer_viewer.measure.defects.inspection import inspect
from wafer_viewer.measure.dies.die_cells import CellGrid, source_of
from wafer_viewer.measure.dies.die_lattice import find_dies
from wafer_viewer.model.inspection.defect import DefectRecipe

LEVEL, TILTED = (1e-4, -1e-4), (0.05, 0.0)


def dies(**odd: CellResult) -> dict[str, str]:
    """What is said of the dies of a level wafer in which some are odd, by name."""
    of = wafer(1, (3, 4), (60, 80))
    cells = CellGrid.of(of.grid, of.surface.pixel_um)
    work = ComparisonWork(
        source_of(of.surface, "unsmoothed", 2),
        cells,
        ReferenceDie.nothing(cells.shape, 0.05, 0.01),
        DefectRecipe(),
        True,
    )
    results = [
        odd.get(f"die{n}", CellResult(place, compared_px=4000, tilt=LEVEL)) for n, place in enumerate(of.grid.places)
    ]
    results = [dataclasses.replace(result, place=place) for result, place in zip(results, of.grid.places, strict=True)]
    found = whole_die_defects(results, work, MeasurementContext.of(of.surface, None, False), None)  # pyright: ignore[reportArgumentType]
    return {name: defect.kind for name, defect in found.items()}


def test_a_tilted_die_is_distinguished_from_the_sliver_of_one():
    odd = CellResult((0, 0), compared_px=4000, tilt=TILTED)
    assert list(dies(die5=odd).values()) == ["tilted die"]
    assert dies(die5=dataclasses.replace(odd, compared_px=300)) == {}


@pytest.mark.slow
@pytest.mark.parametrize("seed", drawn_after(1, range(3)))
def test_a_wafer_without_a_defect_has_no_tilted_die(seed):
    """Turned by half a degree, a tenth unmeasured, dies cut on all sides."""
    dice = np.random.default_rng(seed)
    pitch = float(dice.uniform(120, 150)), float(dice.uniform(95, 120))
    surface = made(
        Wafer(
            rows=560, cols=700, pixel_um=1.0, pitch_x_um=pitch[0], pitch_y_um=pitch[1], width_um=96.0, height_um=76.0,
            x0_um=float(dice.uniform(0, 120)), y0_um=float(dice.uniform(0, 95)), angle_deg=0.5, die_over_street_um=8.0,
            noise_um=0.2, unmeasured_fraction=0.1, seed=seed,
        )
    )  # fmt: skip
    inspection = inspect(surface, find_dies(surface))
    assert inspection.reference == "dies"
    assert not {"tilted die", "missing die"} & {defect.kind for defect in inspection.defects}
