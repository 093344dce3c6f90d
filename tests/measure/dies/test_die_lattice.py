"""The lattice of dies: found on patterned surfaces whose lattice is known, and refused where it is none."""

from __future__ import annotations

import dataclasses
import math
from collections import Counter
from functools import cache

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from tests.support.patterned_surface import Wafer
from tests.support.patterned_surface import made as freshly_made
from tests.support.surfaces import calibration
from wafer_viewer.measure.dies import lattice_refinement
from wafer_viewer.measure.dies.die_lattice import find_dies, on_surface, pitches
from wafer_viewer.measure.dies.die_status import statuses, without_bare_rim
from wafer_viewer.model.acquisition.sample import Alignment
from wafer_viewer.model.errors import MeasureError, PlanError
from wafer_viewer.model.inspection.die_grid import DieGrid, DieStatus
from wafer_viewer.model.measurement.feature import Die, Dies
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import decode, encode, replace
from wafer_viewer.model.surface.height_map import HeightMap

MOST_PPM, MOST_PX = 50, 0.25
made = cache(freshly_made)
TURNED = {"straight": Wafer(), "turned by 0.3": Wafer(angle_deg=0.3, seed=2), "turned by 3": Wafer(angle_deg=-3)}
OTHERS = {
    "street above and brighter": Wafer(die_over_street_um=-3, street_grey=60, die_grey=150),
    "narrow and tall": Wafer(pitch_x_um=90.4, width_um=78.0, pitch_y_um=240.9, height_um=217.0),
    "flat, in the picture alone": Wafer(die_over_street_um=0.0),
    "grey, in the heights alone": Wafer(street_grey=90.0, noise_grey=90.0),
}


def require_found(grid: DieGrid, wafer: Wafer) -> None:
    """Pitch, angle and the corners of its first and last die are those of the wafer."""
    true = wafer.grid
    assert abs(grid.pitch_x_um / true.pitch_x_um - 1) < MOST_PPM * 1e-6
    assert abs(grid.pitch_y_um / true.pitch_y_um - 1) < MOST_PPM * 1e-6
    assert math.degrees(grid.angle_rad) == pytest.approx(wafer.angle_deg, abs=0.002)
    col, row, _, _ = true.to_die(*grid.to_stage(0, 0, grid.width_um / 2, grid.height_um / 2))
    for at in ((0, 0), (grid.cols - 1, grid.rows - 1)):
        off = np.subtract(grid.corner(*at), true.corner(int(col) + at[0], int(row) + at[1]))
        assert np.abs(off).max() < MOST_PX * wafer.pixel_um
    assert grid.width_um == pytest.approx(wafer.width_um, abs=MOST_PX * wafer.pixel_um)
    assert grid.height_um == pytest.approx(wafer.height_um, abs=MOST_PX * wafer.pixel_um)


@pytest.mark.campaign(at_least_one=True)
@pytest.mark.parametrize("wafer", (TURNED | OTHERS).values(), ids=(TURNED | OTHERS).keys())
def test_the_lattice_is_found_to_a_quarter_pixel(wafer):
    grid = find_dies(made(wafer))
    require_found(grid, wafer)
    assert (grid.by, grid.first_col, grid.first_row) == ("found", 0, 0)
    assert 0 < grid.u_pitch_um < 200e-6 * grid.pitch_x_um


@pytest.mark.campaign(at_least_one=True)
@pytest.mark.parametrize(("evidence", "other"), [("height", "all_in_focus"), ("picture", "z_um")])
def test_either_evidence_is_enough(evidence, other):
    surface = made()
    blank = dataclasses.replace(surface, **{other: np.zeros_like(getattr(surface, other))})
    grid = find_dies(blank, evidence=evidence)
    require_found(grid, Wafer())
    assert grid == find_dies(surface, evidence=evidence), "the other evidence is not looked at"


def with_rough_rims(wafer: Wafer) -> HeightMap:
    """The surface with walls unmeasured, and within 24 um of them heights that are rough and full of holes."""
    surface, rng = made(wafer), np.random.default_rng(1)
    x, y = np.meshgrid(np.arange(wafer.cols), np.arange(wafer.rows - 1, -1, -1))
    _, _, u, v = wafer.grid.to_die(x * wafer.pixel_um, y * wafer.pixel_um)
    inside_um = np.minimum(np.minimum(u, wafer.width_um - u), np.minimum(v, wafer.height_um - v))
    rim = (inside_um > 0) & (inside_um < 24)
    rough, holes = (gaussian_filter(rng.standard_normal(surface.shape), px) for px in (1, 2))
    z_um = np.where(rim, surface.z_um + 2 * rough / rough.std(), surface.z_um).astype(np.float32)
    z_um[(np.abs(inside_um) < 8) | (rim & (holes > 0.15))] = np.nan
    return dataclasses.replace(surface, z_um=z_um, z_raw_um=z_um)


@pytest.mark.slow
def test_dies_with_rough_rims_are_found_by_what_repeats():
    wafer = Wafer(rows=250, cols=360, die_over_street_um=15, noise_um=0.05)
    grid = find_dies(with_rough_rims(wafer))
    assert (grid.pitch_x_um, grid.pitch_y_um) == pytest.approx((wafer.pitch_x_um, wafer.pitch_y_um), abs=0.2)


@pytest.mark.slow
def test_a_missing_field_leaves_the_lattice_and_names_its_dies():
    surface = made(gap=Region.rectangle(600, 500, 900, 800), no_die=((2, 2),))
    grid = find_dies(surface)
    require_found(grid, Wafer())
    by_name = {die.name: die for die in statuses(surface, grid)}
    col, row, _, _ = grid.to_die(np.array([750.0, 560.0]), np.array([650.0, 400.0]))
    assert by_name[grid.name(int(col[0]), int(row[0]))].state == "not scanned"
    assert by_name[grid.name(int(col[1]), int(row[1]))].state == "missing"
    states = Counter(die.state for die in by_name.values())
    assert states["partly scanned"] == 8
    assert {die.state for die in by_name.values() if die.col == 0} == {"whole"}, "a sliver of 2 % is no die"
    assert states["whole"] == len(by_name) - 8 - 2


def places(wafer):
    """(col, row) of every place of the wafer's lattice that touches its surface, slivers among them, and the lowest,
    leftmost one of those that are no slivers."""
    grid, (rows, cols) = on_surface(wafer.grid, made(wafer)), (wafer.rows, wafer.cols)
    col, row, _, _ = wafer.grid.to_die(*grid.to_stage(0, 0, grid.width_um / 2, grid.height_um / 2))
    x, y = np.meshgrid(np.arange(cols) * wafer.pixel_um, np.arange(rows) * wafer.pixel_um)
    at_col, at_row, u, v = wafer.grid.to_die(x, y)
    on = (u > 0) & (u < wafer.width_um) & (v > 0) & (v < wafer.height_um)
    touched = set(zip(at_col[on].astype(int).tolist(), at_row[on].astype(int).tolist(), strict=True))
    return touched, (int(col), int(row))


def corners(wafer):
    """Those in the four corners, three to a side, one in the middle, and the lowest, leftmost place of the surface."""
    every, (left, low) = places(wafer)
    (first, right), (lowest, high) = ((min(each), max(each)) for each in zip(*every, strict=True))
    out = {(c, r) for c, r in every if min(c - first, right - c) + min(r - lowest, high - r) < 3}
    return out, ((first + right) // 2, (lowest + high) // 2), (left, low)


@pytest.mark.slow
def test_the_corners_of_a_round_wafer_hold_no_dies_and_one_in_the_middle_is_missing():
    out, middle, (left, low) = corners(Wafer())
    surface = made(no_die=(*sorted(out), middle))
    grid = on_surface(Wafer().grid, surface)
    dies = statuses(surface, grid)
    assert min(die.measured_fraction for die in dies) > 0.05
    out &= {(die.col + left, die.row + low) for die in dies}
    assert {(die.col + left, die.row + low) for die in dies if die.state == "missing"} == {*out, middle}
    left_out = {(c + left, r + low) for c, r in set(grid.places) - set(without_bare_rim(surface, grid, dies).places)}
    assert left_out == out
    named = replace(grid, named=True)
    assert without_bare_rim(surface, named, dies) is named


def test_dies_missing_next_to_a_gap_within_the_wafer_are_no_rim():
    surface = made(gap=Region.rectangle(600, 500, 900, 800), no_die=((3, 3),))
    grid = on_surface(Wafer().grid, surface)
    assert without_bare_rim(surface, grid, statuses(surface, grid)) == grid


@pytest.mark.campaign
def test_a_lattice_is_found_whose_corners_hold_no_dies(monkeypatch):
    few = dataclasses.replace(lattice_refinement.REFINEMENT, cells_pixels=1)
    monkeypatch.setattr(lattice_refinement, "REFINEMENT", few)
    out, _, _ = corners(Wafer())
    surface = made(no_die=tuple(sorted(out)))
    grid = find_dies(surface)
    require_found(grid, Wafer())
    missing = [(die.col, die.row) for die in statuses(surface, grid) if die.state == "missing"]
    assert len(missing) > 4
    middles = [grid.to_stage(col, row, grid.width_um / 2, grid.height_um / 2) for col, row in missing]
    col, row, _, _ = Wafer().grid.to_die(*np.transpose(middles))
    assert set(zip(col.astype(int).tolist(), row.astype(int).tolist(), strict=True)) <= out


@pytest.mark.campaign
def test_a_turned_surface_has_only_the_dies_that_lie_on_it():
    surface = made(TURNED["turned by 3"])
    grid = find_dies(surface)
    dies = statuses(surface, grid)
    assert {die.state for die in dies} == {"whole", "cut"}
    assert len(dies) + len(grid.left_out) == grid.rows * grid.cols
    assert all(0.9 < die.measured_fraction < 1 for die in dies if die.state == "whole")


def test_a_die_cut_by_the_edge_of_the_wafer_is_known():
    surface = made()
    off_wafer = np.broadcast_to(surface.x_um > 1340.0, surface.shape)
    z = np.where(off_wafer, np.float32(-40), surface.z_um)
    grey = np.where(off_wafer, np.uint8(5), surface.all_in_focus)
    surface = dataclasses.replace(surface, z_um=z, z_raw_um=z, all_in_focus=grey)
    dies = statuses(surface, on_surface(Wafer().grid, surface))
    cut = {die.state for die in dies if die.col == max(die.col for die in dies)}
    assert cut == {"cut"}


@pytest.mark.campaign
def test_few_and_large_dies_are_found():
    wafer = Wafer(pitch_x_um=620.0, width_um=560.0, pitch_y_um=540.0, height_um=490.0, angle_deg=0.5)
    grid = find_dies(made(wafer))
    assert grid.pitch_x_um == pytest.approx(620.0, abs=0.2)
    assert grid.pitch_y_um == pytest.approx(540.0, abs=0.2)


@pytest.mark.campaign(at_least_one=True)
@pytest.mark.parametrize(
    ("wafer", "sentence"),
    [
        (Wafer(pitch_x_um=900, width_um=800), "0 whole dies found, 2 needed; they seem to repeat every 900.0 x"),
        (
            Wafer(pitch_x_um=2000, width_um=1900, pitch_y_um=2000, height_um=1900),
            "nothing repeats|0 whole dies found, 2 needed",
        ),
        (Wafer(angle_deg=8.0), "The dies are turned by 8.0 degrees and at most 5 can be found: turn the wafer"),
    ],
)
def test_what_is_no_lattice_is_refused_in_a_sentence(wafer, sentence):
    with pytest.raises(MeasureError, match=sentence) as message:
        find_dies(made(wafer))
    assert str(message.value).count(". ") == 0
    assert "give pitch, origin and size of the dies instead" in str(message.value)


@pytest.mark.slow
def test_noise_and_a_blank_surface_are_no_dies():
    surface = made()
    noise = np.random.default_rng(5).standard_normal(surface.shape).astype(np.float32)
    plain = dataclasses.replace(surface, z_um=noise, z_raw_um=noise, all_in_focus=np.full(surface.shape, 80, np.uint8))
    with pytest.raises(MeasureError, match="No dies are found, because nothing repeats along x or y"):
        find_dies(plain)
    with pytest.raises(MeasureError, match="shows no contrast that dies could be found by"):
        find_dies(plain, evidence="picture")


def every_other_die_another(grey: int):
    """Dies with another brightness inside, in every other column."""
    wafer = Wafer(noise_grey=2.0, pitch_x_um=160.0, width_um=140.0)
    surface = made(wafer)
    col, _, u, v = wafer.grid.to_die(surface.x_um[None, :], surface.y_um[:, None])
    other = (col % 2 == 1) & (u > 5) & (u < 135) & (v > 5) & (v < 116)
    return dataclasses.replace(surface, all_in_focus=np.where(other, np.uint8(grey), surface.all_in_focus))


@pytest.mark.campaign
def test_where_every_other_die_is_another_two_dies_repeat():
    assert find_dies(every_other_die_another(125), evidence="picture").pitch_x_um == pytest.approx(320.0, abs=0.1)


@pytest.mark.slow
def test_every_other_die_nearly_another_leaves_the_pitch_open():
    with pytest.raises(MeasureError, match="The pitch along x is ambiguous"):
        find_dies(every_other_die_another(118), evidence="picture")


@pytest.mark.campaign
def test_the_pitch_has_its_uncertainty_only_with_a_calibration():
    surface = made()
    grid = find_dies(surface)
    assert {length.status for length in pitches(surface, grid)} == {"uncalibrated"}
    valid = dataclasses.replace(surface, provenance=replace(surface.provenance, calibration=calibration()))
    along_x, _ = pitches(valid, grid)
    assert along_x.status == "evaluated"
    assert along_x.expanded_um == pytest.approx(2 * grid.u_pitch_um)
    assert {length.status for length in pitches(valid, replace(grid, by="given", u_pitch_um=0.0))} == {"not evaluated"}


def test_places_on_the_stage_and_on_a_die_are_one_and_the_same():
    grid = Wafer(angle_deg=2.0).grid
    x_um, y_um = grid.to_stage(np.array([3, -1]), np.array([2, 0]), np.array([10.0, -5.0]), np.array([4.0, 90.0]))
    col, row, u_um, v_um = grid.to_die(x_um, y_um)
    assert (col.tolist(), row.tolist()) == ([3, -1], [2, 0])
    assert np.allclose((u_um, v_um), [[10, -5], [4, 90]])
    assert grid.outline(1, 1).area_um2 == pytest.approx(grid.width_um * grid.height_um)
    assert decode(encode(grid, "json"), DieGrid, "grid", "json") == grid


def test_a_job_names_the_same_dies():
    dies = Dies(width_um=180, height_um=120, rows=3, cols=4, pitch_x_um=200, pitch_y_um=150, left_out=("0,2",))
    alignment = Alignment(rotation_rad=0.02, shift_x_um=30.0, shift_y_um=-8.0)
    grid = DieGrid.of(dies, alignment)
    assert len(grid.places) == 11
    present, back = dies.all(), grid.as_dies(alignment).all()
    assert [die.name for die in back] == [die.name for die in present]
    assert np.allclose([(d.x_um, d.y_um) for d in back], [(d.x_um, d.y_um) for d in present])
    assert len(grid.as_dies().listed) == 11
    with pytest.raises(PlanError, match="lists its dies one by one"):
        DieGrid.of(Dies(width_um=1, height_um=1, listed=(Die(name="A", x_um=0, y_um=0),)))


def test_what_cannot_be_a_lattice_is_refused():
    with pytest.raises(MeasureError, match=r"DieGrid\.width_um is 250"):
        replace(Wafer().grid, width_um=250.0)
    with pytest.raises(MeasureError, match="No die of the lattice lies on the surface"):
        on_surface(replace(Wafer().grid, pitch_x_um=9000.0, x0_um=2000.0), made())


def test_only_a_whole_die_that_was_looked_at_is_clean():
    die = DieStatus(name="1,1", col=1, row=1, state="whole", measured_fraction=1.0)
    assert die.word == "not inspected"
    assert replace(die, defects=0).word == "clean"
    assert (replace(die, defects=1).word, replace(die, defects=7).word) == ("1 defect", "7 defects")
    assert replace(die, state="partly scanned", defects=0).word == "partly scanned"
    assert replace(die, measured_fraction=0.6, defects=0).word == "clean, 40% of it unmeasured"
    assert replace(die, street_inspected=False, defects=0).word == "clean, street not inspected"


@pytest.mark.campaign
def test_the_wafer_of_the_virtual_rig():
    from tests.support.virtual_wafer import virtual_wafer
    from wafer_viewer.rigs.virtual.scenes.wafer import PITCH_X_UM, PITCH_Y_UM, TRENCH_UM, is_whole_die

    surface = virtual_wafer(pixel_um=3.0)
    grid = find_dies(surface)
    assert grid.pitch_x_um == pytest.approx(PITCH_X_UM, rel=5e-5)
    assert grid.pitch_y_um == pytest.approx(PITCH_Y_UM, rel=5e-5)
    x_um, y_um = grid.corner(5, 6)
    assert (x_um - TRENCH_UM / 2 + 1) % PITCH_X_UM == pytest.approx(1, abs=0.75)
    assert (y_um - TRENCH_UM / 2 + 1) % PITCH_Y_UM == pytest.approx(1, abs=1.0)
    cells = {
        (math.floor(x / PITCH_X_UM), math.floor(y / PITCH_Y_UM))
        for die in statuses(surface, grid)
        if die.state == "whole"
        for x, y in [grid.to_stage(die.col, die.row, grid.width_um / 2, grid.height_um / 2)]
    }
    assert cells == {(c, r) for c in range(-7, 7) for r in range(-9, 9) if is_whole_die(c, r)}
