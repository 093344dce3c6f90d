"""Adders by planted truth: a wafer inspected twice, turned and moved on the stage, with defects added and removed."""

from __future__ import annotations

import numpy as np
import pytest

from wafer_viewer.measure.defects.adders import adders
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.inspection.die_grid import DieGrid, DieStatus
from wafer_viewer.model.inspection.lot import WaferDefect, WaferDefects
from wafer_viewer.model.spec import replace

GRID = DieGrid(
    pitch_x_um=5000.0, pitch_y_um=4000.0, width_um=4900.0, height_um=3900.0, x0_um=0.0, y0_um=0.0, cols=8, rows=8
)


def wafer(defects: list[WaferDefect], grid: DieGrid = GRID, **changes) -> WaferDefects:
    dies = tuple(
        DieStatus(name=grid.name(c, r), col=c, row=r, state="whole", measured_fraction=1.0, defects=0)
        for c, r in grid.places
    )
    values = {"name": "w1", "grid": grid, "dies": dies, "defects": tuple(defects), "inspected_mm2": 1280.0}
    return WaferDefects(**(values | changes))


def at(number: int, x_um: float, y_um: float, grid: DieGrid = GRID, **changes) -> WaferDefect:
    col, row, _, _ = (int(part[0]) for part in grid.to_die(np.array([x_um]), np.array([y_um])))
    values = {"kind": "Particle", "length_um": 10.0, "width_um": 8.0, "die": grid.name(col, row)}
    return WaferDefect(number=number, x_um=x_um, y_um=y_um, **(values | changes))


def planted(seed: int, n_common: int = 150, n_only: int = 30) -> tuple[WaferDefects, WaferDefects]:
    """Numbers 1 … n_common are in both; the second wafer lies turned and elsewhere, and errs by 1.2 um."""
    rng = np.random.default_rng(seed)
    moved = replace(GRID, x0_um=812.0, y0_um=-377.0, angle_rad=0.02)
    n = n_common + n_only
    cols, rows = rng.integers(0, 8, (2, 2 * n))
    u, v = rng.uniform(50, 4850, 2 * n), rng.uniform(50, 3850, 2 * n)
    here = np.column_stack(GRID.to_stage(cols, rows, u, v))
    there = np.column_stack(moved.to_stage(cols, rows, u, v)) + rng.normal(0, 1.2, (2 * n, 2))
    first = [at(k + 1, *here[k].tolist()) for k in range(n)]
    later = [*range(n_common), *range(n, n + n_only)]
    second = [at(k + 1, *there[k].tolist(), moved) for k in rng.permutation(later).tolist()]
    return wafer(first), wafer(second, moved)


@pytest.mark.parametrize("seed", [1021, 1022, 1023])
def test_planted_adders_are_found_although_the_wafer_lies_elsewhere(seed: int):
    found = adders(*planted(seed))
    same = [pair for pair in found.common if pair.first == pair.second]
    assert len(same) >= 148
    assert len(found.common) - len(same) <= 1
    assert len({*range(181, 211)} - {*found.added}) <= 1
    assert len({*found.added} - {*range(181, 211)}) <= 2
    assert len({*range(151, 181)} - {*found.removed}) <= 1
    assert abs(found.offset_x_um or 0.0) < 1.0
    assert found.by_chance is not None
    assert found.by_chance < 0.02 * 180


@pytest.mark.campaign
def test_coincidences_are_as_many_as_expected():
    rng = np.random.default_rng(1030)
    counted, expected = 0, 0.0
    for _ in range(20):
        x, y = rng.uniform(0, 40_000, (2, 600)), rng.uniform(0, 32_000, (2, 600))
        sizes = {"length_um": 120.0, "width_um": 120.0}
        one, other = (wafer([at(k, x[w, k], y[w, k], **sizes) for k in range(600)]) for w in (0, 1))
        found = adders(one, other)
        counted, expected = counted + len(found.common), expected + (found.by_chance or 0.0)
    assert 0.75 * expected < counted <= expected + 3 * np.sqrt(expected)  # an upper bound: each matches once


def test_each_defect_matches_once_and_the_nearest_first():
    first = wafer([at(1, 1000, 1000), at(2, 1004, 1000)])
    found = adders(first, wafer([at(7, 1003.5, 1000)]))
    assert [(pair.first, pair.second) for pair in found.common] == [(2, 7)]
    assert found.removed == (1,)
    assert [(p.first, p.second) for p in adders(first, wafer([at(7, 1003.5, 1000), at(8, 1000, 1001)])).common] == [
        (1, 8),
        (2, 7),
    ]


def test_a_long_scratch_may_be_seen_in_part_but_only_along_itself():
    scratch = at(1, 2000, 2000, length_um=400.0, width_um=6.0, angle_deg=30.0)
    along, across = (np.deg2rad(30), np.deg2rad(120))
    part = at(2, 2000 + 120 * np.cos(along), 2000 + 120 * np.sin(along), length_um=160.0, width_um=6.0, angle_deg=30.0)
    beside = at(2, 2000 + 30 * np.cos(across), 2000 + 30 * np.sin(across))
    assert len(adders(wafer([scratch]), wafer([part])).common) == 1
    assert adders(wafer([scratch]), wafer([beside])).added == (2,)


def test_the_distance_follows_from_the_uncertainty_or_is_given():
    first, second = wafer([at(1, 1000, 1000)]), wafer([at(1, 1015, 1000)])
    assert adders(first, second).added == (1,)
    assert adders(first, second, within_um=20.0).added == ()
    assert adders(first, second, within_um=14.0).added == (1,)
    unsure = replace(GRID, u_origin_um=8.0)
    assert adders(first, wafer(list(second.defects), unsure)).added == ()
    with pytest.raises(MeasureError, match="within_um is 0"):
        adders(first, second, within_um=0.0)


def test_what_the_other_inspection_did_not_inspect_is_neither_added_nor_removed():
    whole = wafer([at(1, 1000, 1000), at(2, 6000, 1000)])
    dies = tuple(replace(die, state="partly scanned") if die.name == "1,0" else die for die in whole.dies)
    partly = replace(whole, dies=dies, defects=())
    before, after = adders(partly, whole), adders(whole, partly)
    assert (before.added, before.not_inspected_before) == ((1,), (2,))
    assert (after.removed, after.not_inspected_after) == ((1,), (2,))


def test_dies_that_were_numbered_otherwise_are_told_by_their_places():
    first, _ = planted(1024, 40, 0)
    renamed = replace(GRID, x0_um=GRID.x0_um + 2 * GRID.pitch_x_um, first_col=-2)
    again = wafer([at(d.number, d.x_um, d.y_um, renamed) for d in first.defects], renamed)
    found = adders(first, again)
    assert len(found.common) == 40
    assert found.dies == "die 0,0 is die 2,0 before, by place"


def test_without_dies_places_are_those_on_the_stage_and_a_note_says_what_is_unknown():
    bare = WaferDefects(name="a", defects=(at(1, 10, 10), at(2, 500, 500)), inspected_mm2=1.0)
    found = adders(bare, replace(bare, name="b", defects=(at(5, 12, 10), at(6, 800, 10))))
    assert ([p.first for p in found.common], found.added, found.removed) == ([1], (6,), (2,))
    assert "overlooked" in " ".join(found.notes)


def test_wafers_of_two_names_are_compared_and_said_to_be_two():
    one = wafer([], lot="L", wafer="1")
    assert "different wafers: L 1 and L 2" in " ".join(adders(one, replace(one, wafer="2")).notes)
