"""Dies that differ as a full: none on wafers without a defect, and slivers of dies say nothing."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from tests.bench.bench_die_states import planted
from tests.support.campaigns import drawn_after
from tests.support.noisy_wafer import wafer
from tests.support.patterned_surface import Wafer, made
from tests.support.surfaces import calibration
from wafer_viewer.measure.base.measurement_context import MeasurementContext
from wafer_viewer.measure.defects.cell_comparison import CellResult, ComparisonWork
from wafer_viewer.measure.defects.die_form import DieForm
from wafer_viewer.measure.defects.die_level import die_forms, whole_die_defects
from wafer_viewer.measure.defects.golden_die import ReferenceDie
from wafer_viewer.measure.defects.inspection import inspect
from wafer_viewer.measure.dies.die_cells import CellGrid, source_of
from wafer_viewer.measure.dies.die_lattice import find_dies, over_surface
from wafer_viewer.model.inspection.defect import DefectRecipe
from wafer_viewer.model.spec import replace

DIE_KINDS = {"tilted die", "missing die", "bowed die", "discoloured die"}
LEVEL = DieForm(tilt=(1e-4, -1e-4), u_tilt=1e-5, known=1.0)


def kinds(**odd: DieForm) -> dict[str, str]:
    """What is said of the dies of a level wafer in which some are odd, by name."""
    of = wafer(1, (3, 4), (60, 80))
    cells = CellGrid.of(of.grid, of.surface.pixel_um)
    reference = ReferenceDie.nothing(cells.shape, 0.05, 0.01)
    work = ComparisonWork(source_of(of.surface, "unsmoothed", 2), cells, reference, DefectRecipe(), True)
    results = [CellResult(at, form=odd.get(f"die{n}", LEVEL)) for n, at in enumerate(of.grid.places)]
    reading = MeasurementContext.of(of.surface, None, False)
    found = whole_die_defects(die_forms(results, set()), set(), work, reading)
    return {name: defect.kind for name, defect in found.items()}


def test_a_tilted_die_is_distinguished_from_the_sliver_of_one():
    odd = dataclasses.replace(LEVEL, tilt=(0.05, 0.0))
    assert list(kinds(die5=odd).values()) == ["tilted die"]
    assert kinds(die5=dataclasses.replace(odd, known=0.1)) == {}
    assert kinds(die5=dataclasses.replace(odd, u_tilt=0.02)) == {}, "it may be level"
    assert list(kinds(die5=dataclasses.replace(LEVEL, bow_um=-1.8)).values()) == ["bowed die"]
    assert list(kinds(die5=dataclasses.replace(LEVEL, brightness=0.2)).values()) == ["discoloured die"]


def test_a_die_that_is_lower_and_tilted_is_tilted_and_one_that_is_lower_alone_is_missing():
    low = dataclasses.replace(LEVEL, offset_um=-3.0)
    assert list(kinds(die5=low).values()) == ["missing die"]
    assert list(kinds(die5=dataclasses.replace(low, tilt=(0.02, 0.0))).values()) == ["tilted die"]


@pytest.mark.campaign(at_least_one=True)
@pytest.mark.parametrize("seed", [10, 4])
def test_every_die_is_measured_and_named_beside_other_defects(seed: int):
    made_up = planted(seed)
    assert made_up is not None
    surface, grid = made_up.wafer.surface, made_up.wafer.grid
    surface = dataclasses.replace(surface, provenance=replace(surface.provenance, calibration=calibration()))
    found = inspect(surface, over_surface(grid, surface))
    named = {d.die: d.kind for d in found.defects if d.kind in DIE_KINDS - {"discoloured die"}}
    planted_kinds = {grid.name(*at): kind for at, (kind, _) in made_up.dies.items() if kind != "discoloured die"}
    assert named == planted_kinds
    dies = {die.name: die for die in found.dies}
    for at, (kind, size) in made_up.dies.items():
        measured = dies[grid.name(*at)].measured
        if kind == "missing die":
            assert measured is None
            continue
        assert measured is not None
        tilt_mrad, bow_um = size * (kind == "tilted die"), size * (kind == "bowed die")
        assert measured.tilt_x.expanded is not None
        assert measured.tilt_mrad == pytest.approx(tilt_mrad, abs=max(1.0, 3 * measured.tilt_x.expanded))
        assert measured.bow.value_um == pytest.approx(bow_um, abs=0.15)
    particles = [one for one in made_up.local if one.kind != "stain"]
    hit = [
        any(math.hypot(d.center.x_um - p.x_um, d.center.y_um - p.y_um) < p.size_um for d in found.found)
        for p in particles
    ]
    assert np.mean(hit) >= 0.85, "they are found on tilted dies too"


@pytest.mark.campaign
def test_a_missing_die_at_the_rim_is_named_and_the_ground_beyond_the_array_is_not():
    for at in ((0, 3), (6, 0)):  # in a side of the array, and at a corner of it
        drawn = made(no_die=(at,))
        found = inspect(drawn, over_surface(Wafer().grid, drawn))
        assert [(d.die, d.kind) for d in found.defects if d.kind in DIE_KINDS] == [(f"{at[0]},{at[1]}", "missing die")]


@pytest.mark.slow
@pytest.mark.parametrize("seed", drawn_after(1, range(3)))
def test_a_wafer_without_a_defect_has_no_tilted_die(seed: int):
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
    assert not DIE_KINDS & {defect.kind for defect in inspection.defects}
