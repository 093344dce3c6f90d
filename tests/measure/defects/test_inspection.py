"""Defects of made-up patterned wafers: what is planted is found with its size and height, and nothing else counts."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from tests.support.noisy_wafer import PIXEL_UM, SIGMA_UM, Planted, Wafer, wafer
from tests.support.surfaces import calibration, height_map
from wafer_viewer.measure.defects.inspection import golden_of_surface, inspect
from wafer_viewer.model.errors import DiesNotFound, MeasureError
from wafer_viewer.model.inspection.defect import Defect, DefectLimits, DefectRecipe, Inspection, headline, verdict_of
from wafer_viewer.model.inspection.die_grid import DieGrid
from wafer_viewer.model.inspection.golden_die import GoldenDie
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.height_map import HeightMap, Origin
from wafer_viewer.model.surface.recipe import Recipe

BUMP = Planted("bump", 250.0, 392.0, 30, 6)
PIT = Planted("pit", 110.0, 110.0, 8, 8)
SCRATCH = Planted("scratch", 350.0, 150.0, 90, 8)
PLANTED = (BUMP, PIT, SCRATCH)
DULL = DefectRecipe(sensitivity=0.25)


def made(seed: int = 1, planted: tuple[Planted, ...] = PLANTED, **more: object) -> Wafer:
    return wafer(seed, (3, 3), (120, 140), planted, **more)  # pyright: ignore[reportArgumentType]


def inspected(of: Wafer, recipe: DefectRecipe = DULL) -> Inspection:
    return inspect(of.surface, of.grid, recipe)


@pytest.fixture(scope="module")
def found() -> Inspection:
    return inspected(made())


def at(inspection: Inspection, planted: Planted) -> Defect:
    def away(d: Defect) -> float:
        return math.hypot(d.center.x_um - planted.x_um, d.center.y_um - planted.y_um)

    nearest = min(inspection.found, key=away)
    assert away(nearest) < 4 * PIXEL_UM
    return nearest


@pytest.mark.slow
def test_planted_defects_are_found_without_false_ones(found: Inspection) -> None:
    assert len(found.found) == len(PLANTED)
    assert found.reference == "dies"


def test_a_bump_has_its_height_and_size(found: Inspection) -> None:
    bump = at(found, BUMP)
    assert bump.height.value_um == pytest.approx(6 * SIGMA_UM, rel=0.1)
    assert bump.major.value_um == pytest.approx(30 * PIXEL_UM, rel=0.1)
    assert bump.area.value == pytest.approx(math.pi * 225 * PIXEL_UM**2, rel=0.1)
    assert bump.volume.value == pytest.approx(bump.area.value * 6 * SIGMA_UM, rel=0.15)
    assert bump.size_resolved


def test_a_bump_knows_its_die(found: Inspection) -> None:
    bump = at(found, BUMP)
    assert bump.die == "2,1"
    assert bump.in_die is not None
    grid = made().grid
    x_um, y_um = grid.to_stage(2, 1, bump.in_die.x_um, bump.in_die.y_um)
    assert (float(x_um), float(y_um)) == pytest.approx((bump.center.x_um, bump.center.y_um), abs=1.0)


def test_a_small_pit_is_detected_but_its_size_is_not_resolved(found: Inspection) -> None:
    pit = at(found, PIT)
    assert pit.height.value_um < 0
    assert not pit.size_resolved


def test_a_scratch_over_two_dies_is_one_defect_as_long_as_it_is(found: Inspection) -> None:
    scratch = at(found, SCRATCH)
    assert scratch.kind == "scratch"
    assert scratch.major.value_um == pytest.approx(90 * PIXEL_UM, rel=0.15)
    assert scratch.minor.value_um < 8 * PIXEL_UM


@pytest.mark.slow
def test_a_clean_wafer_has_no_defects_and_says_how_much_was_looked_at() -> None:
    clean = made(5, ())
    inspection = inspected(clean)
    assert inspection.found == ()
    grid = clean.grid  # streets that border no other die are not compared
    width_um, height_um = 2 * grid.pitch_x_um + grid.width_um, 2 * grid.pitch_y_um + grid.height_um
    assert inspection.inspected_mm2 == pytest.approx(0.98 * width_um * height_um / 1e6, rel=0.05)
    assert inspection.expected_false_per_mm2 is not None


@pytest.mark.slow
def test_an_area_without_heights_is_counted_and_is_no_row_of_the_list() -> None:
    clean = made(5, ())
    z = clean.surface.z_um.copy()
    z[160:200, 180:240] = np.nan
    inspection = inspected(dataclasses.replace(clean, surface=with_heights(clean.surface, z)))
    assert inspection.defects == ()
    assert inspection.unmeasured_mm2 >= 40 * 60 * PIXEL_UM**2 / 1e6


def test_without_dies_it_is_compared_with_the_form() -> None:
    rng = np.random.default_rng(0)
    z = rng.normal(0, SIGMA_UM, (300, 400)) + 1e-4 * np.arange(400.0)[None, :] ** 2
    z[100:120, 200:230] += 1.0
    inspection = inspect(flat_surface(z), recipe=DULL)
    assert inspection.reference == "form"
    assert "form" in inspection.notes[0]
    (bump,) = inspection.found
    assert bump.height.value_um == pytest.approx(1.0, rel=0.1)
    assert bump.die == ""


def test_a_stain_on_a_plain_surface_shows_in_its_picture() -> None:
    rng = np.random.default_rng(3)
    surface = flat_surface(rng.normal(0, SIGMA_UM, (300, 400)))
    grey = 120 + 20 * np.arange(400) / 400 + rng.normal(0, 3, (300, 400))
    grey[150:162, 220:234] -= 30
    stained = dataclasses.replace(surface, all_in_focus=grey.clip(0, 255).astype(np.uint8))
    inspection = inspect(stained, recipe=DULL)
    (stain,) = inspection.found
    assert stain.evidence == "picture"
    assert math.hypot(stain.center.x_um - 226.5 * PIXEL_UM, stain.center.y_um + 155.5 * PIXEL_UM) < 2 * PIXEL_UM
    assert "compared with what is around" in inspection.notes[1]


@pytest.mark.slow
def test_the_picture_of_a_pattern_without_dies_is_left_out_and_that_is_reported() -> None:
    inspection = inspect(made(1, ()).surface, recipe=DULL)
    assert inspection.recipe.evidence == "height"
    assert "shows a pattern, or nothing, and was not looked at" in inspection.notes[1]


@pytest.mark.slow
def test_what_every_die_has_shows_against_a_stored_golden_die_only() -> None:
    golden = golden_of_surface(made(1, ()).surface, made(1, ()).grid)
    everywhere = tuple(
        Planted("bump", 70.0 + row * 140.37, 60.0 + col * 160.21, 16, 10) for row in range(3) for col in range(3)
    )
    same = made(2, everywhere)
    assert inspected(same).found == ()
    inspection = inspect(same.surface, same.grid, DULL, golden)
    assert inspection.reference == "golden"
    assert sum(d.repeats for d in inspection.found) == 9


@pytest.mark.campaign
def test_what_was_compared_with_a_simulated_golden_die_is_simulated() -> None:
    clean, real = made(1, ()), made(2)
    assert not inspect(real.surface, real.grid, DULL, golden_of_surface(clean.surface, clean.grid)).simulated
    golden = golden_of_surface(clean.surface, clean.grid, simulated=True)
    inspection = inspect(real.surface, real.grid, DULL, golden)
    assert inspection.simulated
    assert inspection.defects
    assert all(defect.simulated for defect in inspection.defects)


@pytest.mark.slow
def test_a_defect_in_a_street_shows_next_to_a_stored_golden_die() -> None:
    clean = made(1, ())
    golden = golden_of_surface(clean.surface, clean.grid)
    in_street = made(2, (Planted("bump", 70.0, 2 * 160.21, 12, 10),))
    inspection = inspect(in_street.surface, in_street.grid, DULL, golden)
    bump = at(inspection, in_street.planted[0])
    assert bump.height.value_um == pytest.approx(10 * SIGMA_UM, rel=0.2)
    assert len(inspection.found) == 1
    assert "compared with those of the other dies" in inspection.notes[-1]
    assert {die.word for die in inspection.dies if not die.defects} == {"clean"}


@pytest.mark.slow
def test_a_clean_die_says_that_its_street_was_not_looked_at() -> None:
    golden = golden_of_surface(made(1, ()).surface, made(1, ()).grid)
    few = made(4, ())
    grid = replace(few.grid, rows=1)
    inspection = inspect(few.surface, grid, DULL, golden)
    assert "not inspected" in inspection.notes[-1]
    assert {die.word for die in inspection.dies} == {"clean, street not inspected"}


def test_the_dial_trades_misses_for_false_counts(found: Inspection) -> None:
    keen, dull = found.expected_false_at(0.9), found.expected_false_at(0.1)
    assert keen is not None
    assert dull is not None
    assert keen > 10 * dull


@pytest.mark.slow
def test_progress_is_reported_and_the_work_can_be_stopped() -> None:
    clean = made(5, ())
    reported: list[float] = []
    with pytest.raises(MeasureError, match="stopped"):
        inspect(clean.surface, clean.grid, progress=reported.append, should_stop=lambda: len(reported) >= 2)
    assert reported == pytest.approx([1 / 3, 2 / 3])


def test_uncalibrated_sizes_have_no_u(found: Inspection) -> None:
    assert at(found, BUMP).height.status == "uncalibrated"


@pytest.mark.slow
def test_what_is_narrow_against_the_focus_window_says_that_it_is_higher_or_deeper() -> None:
    of = made()
    reported = replace(of.surface.provenance, recipe=Recipe(window=9), calibration=calibration())
    inspection = inspect(dataclasses.replace(of.surface, provenance=reported), of.grid, DULL)
    narrow = [any("focus windows (18 px)" in note for note in at(inspection, what).notes) for what in PLANTED]
    assert narrow == [what is not BUMP for what in PLANTED]
    assert at(inspection, SCRATCH).height.status == "not evaluated"
    assert at(inspection, SCRATCH).major.status == at(inspection, BUMP).height.status == "evaluated"


def test_a_surface_without_heights_is_refused() -> None:
    with pytest.raises(MeasureError, match="hardly any measured pixels"):
        inspect(flat_surface(np.full((50, 60), np.nan)))


def test_a_grid_next_to_the_surface_is_refused() -> None:
    clean = made(5, ())
    with pytest.raises(MeasureError, match="No die of the lattice lies on the surface"):
        inspect(clean.surface, replace(clean.grid, x0_um=1e6))


def test_a_golden_die_of_another_size_is_refused() -> None:
    clean = made(5, ())
    golden = golden_of_surface(clean.surface, clean.grid)
    wider: DieGrid = replace(clean.grid, width_um=clean.grid.width_um - 5)
    with pytest.raises(MeasureError, match="dies of"):
        inspect(clean.surface, wider, golden=golden)


@pytest.mark.slow
def test_a_golden_die_that_looks_otherwise_is_refused() -> None:
    clean = made(5, ())
    golden = golden_of_surface(clean.surface, clean.grid)
    upside_down = GoldenDie(golden.header, golden.z_um[::-1, ::-1] * -1, *list(golden.layers.values())[1:])
    with pytest.raises(MeasureError, match="not like the dies"):
        inspect(clean.surface, clean.grid, golden=upside_down)


def flat_surface(z: np.ndarray) -> HeightMap:
    return height_map(z, PIXEL_UM, grey=100)


def with_heights(surface: HeightMap, z: np.ndarray) -> HeightMap:
    origin = np.where(np.isfinite(z), Origin.MEASURED, Origin.NO_TEXTURE).astype(np.uint8)
    return dataclasses.replace(surface, z_um=z, z_raw_um=z, origin=origin)


@pytest.mark.campaign
def test_places_round_the_dies_that_hold_none_are_no_defects_and_that_is_reported() -> None:
    of = wafer(6, (5, 5), (120, 140), no_die=((0, 0), (0, 4), (4, 0), (4, 4)))
    found = inspect(of.surface, replace(of.grid, named=False), DULL)
    assert not found.found
    assert "No die is seen at 4 places round the others: nothing was inspected there." in found.notes
    assert {die.name for die in found.dies if die.state == "missing"} == {"0,0", "4,0", "0,4", "4,4"}
    full = wafer(6, (5, 5), (120, 140))
    assert found.inspected_mm2 < 0.9 * inspect(full.surface, full.grid, DULL).inspected_mm2


@pytest.mark.slow
def test_a_die_that_a_job_names_is_a_defect_where_it_is_missing_at_the_rim() -> None:
    of = wafer(6, (5, 5), (120, 140), no_die=((0, 0),))
    found = inspect(of.surface, of.grid, DULL)
    assert [d.die for d in found.found] == ["0,4"]


def test_few_dies_are_refused_and_keep_their_defects_where_the_form_is_asked_for() -> None:
    four = wafer(3, (2, 2), (120, 140), (Planted("bump", 200.0, 240.0, 30, 100),))
    with pytest.raises(DiesNotFound, match="Only 4 of 4 dies are measured in their middle, and a typical die takes 5"):
        inspect(four.surface, four.grid, DULL)
    inspection = inspect(four.surface, four.grid, DULL, against="form")
    bump = at(inspection, four.planted[0])
    assert (inspection.reference, bump.die) == ("form", "1,0")
    assert {die.name: die.defects for die in inspection.dies} == {"0,0": 0, "1,0": 1, "0,1": 0, "1,1": 0}
    verdict = verdict_of(inspection, DefectLimits(max_per_die=0))
    assert (verdict.word, verdict.failing) == ("fail", ("1,0",))


def test_what_was_not_compared_or_hardly_inspected_is_never_within_limits() -> None:
    four = wafer(3, (2, 2), (120, 140))
    inspection = inspect(four.surface, four.grid, DULL, against="form")
    limits = DefectLimits(max_per_die=9)
    assert verdict_of(inspection, limits).word == "pass"
    assert headline(inspection, limits).endswith("compared with the fitted form: 0 defects, pass.")
    skipped = replace(inspection, dies=tuple(replace(die, defects=None) for die in inspection.dies[:1]))
    assert verdict_of(skipped, limits).not_inspected == ("0,0",)
    hardly = replace(inspection, unmeasured_mm2=9 * inspection.inspected_mm2)
    verdict = verdict_of(hardly, limits)
    assert (verdict.word, round(verdict.inspected_fraction, 2)) == ("no verdict", 0.1)
    assert headline(hardly, limits).startswith("10 % of ")
