"""Statistics of several wafers: yield and kill ratio by hand, the control chart by planted truth."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from tests.support.datasets.inspections import GRID, defect, inspection
from wafer_viewer.measure.defects.lot_statistics import (
    BY_TEST,
    lot_statistics,
    proportion,
    ratio_limits,
    stacked_defects,
)
from wafer_viewer.model.acquisition.sample import Sample
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.inspection.defect import Inspection
from wafer_viewer.model.inspection.die_grid import DieGrid, DieStatus
from wafer_viewer.model.inspection.lot import WaferDefect, WaferDefects
from wafer_viewer.model.inspection.wafer_map import MapDie, WaferMap
from wafer_viewer.model.quantity import Length
from wafer_viewer.model.spec import replace


def wafer(found: Inspection, name: str = "w1", lot: str = "L1") -> WaferDefects:
    return WaferDefects.of(found, name, Sample(lot=lot, wafer_id=name, notch="down"))


def counted(name: str, n: int, area_mm2: float) -> WaferDefects:
    """A wafer with so many defects, without dies."""
    defects = tuple(WaferDefect(number=k, kind="Particle", x_um=0.0, y_um=0.0) for k in range(n))
    return WaferDefects(name=name, defects=defects, inspected_mm2=area_mm2)


# A lot of two wafers of 10 x 5 dies. Scratches lie on 20 dies, of which 12 fail the test; of the 80 dies without a
# scratch 8 fail. Yield: 80 of 100. Kill ratio: 1 - (8 / 20) / (72 / 80) = 0.5556, a loss of 0.5556 * 20 / 100.
WORKED = DieGrid(
    pitch_x_um=1000.0, pitch_y_um=1000.0, width_um=1000.0, height_um=1000.0, x0_um=0.0, y0_um=0.0, cols=10, rows=5
)


def worked(name: str) -> tuple[WaferDefects, WaferMap]:
    dies = tuple(
        DieStatus(name=WORKED.name(c, r), col=c, row=r, state="whole", measured_fraction=1.0, defects=int(r == 0))
        for c, r in WORKED.places
    )
    scratches = tuple(
        WaferDefect(number=c + 1, kind="Scratch", x_um=500.0 + 1000 * c, y_um=500.0, die=f"{c},0") for c in range(10)
    )
    fails = {(c, 0) for c in range(6)} | {(c, 4) for c in range(4)}
    tested = tuple(
        MapDie(col=c, row=r, code="0B" if (c, r) in fails else "01", quality="fail" if (c, r) in fails else "pass")
        for c, r in WORKED.places
    )
    test = WaferMap(format="e142", lot="L1", wafer=name, notch="down", cols=10, rows=5, dies=tested, reference=(0, 0))
    return (
        WaferDefects(
            name=name, lot="L1", wafer=name, notch="down", grid=WORKED, dies=dies, defects=scratches, inspected_mm2=50.0
        ),
        test,
    )


def test_yield_and_kill_ratio_are_those_of_the_worked_example():
    wafers, tests = zip(worked("w1"), worked("w2"), strict=True)
    found = lot_statistics(wafers, tests=tests)
    assert found.good is not None
    assert (found.good.n, found.good.total, found.good_by) == (80, 100, BY_TEST)
    assert (found.good.low, found.good.high) == pytest.approx((0.7082, 0.8733), abs=1e-4)  # Clopper and Pearson, R
    (kill,) = found.kill_ratios
    assert (kill.kind, kill.failing_with.n, kill.failing_with.total) == ("Scratch", 12, 20)
    assert (kill.failing_without.n, kill.failing_without.total) == (8, 80)
    assert kill.ratio == pytest.approx(5 / 9)
    assert kill.loss == pytest.approx(1 / 9)
    assert kill.low is not None
    assert kill.high is not None
    assert 0 < kill.low < 5 / 9 < kill.high < 1
    assert [line.good.n for line in found.wafers if line.good] == [40, 40]


def test_limits_of_a_ratio_cover_the_truth_as_often_as_they_say():
    rng = np.random.default_rng(1007)
    covered = 0
    for _ in range(1000):
        n1, n0 = int(rng.binomial(25, 0.4)), int(rng.binomial(200, 0.9))
        low, high = ratio_limits(n1, 25, n0, 200)
        covered += low <= 0.4 / 0.9 <= high
    assert 930 <= covered <= 970


def test_limits_of_a_ratio_stand_where_no_die_survives_or_all_do():
    assert ratio_limits(0, 10, 90, 100)[0] == 0.0
    assert 0.2 < ratio_limits(0, 10, 90, 100)[1] < 0.4
    assert ratio_limits(10, 10, 100, 100)[0] < 1.0 < ratio_limits(10, 10, 100, 100)[1]
    assert ratio_limits(5, 10, 0, 10)[1] == math.inf


def test_confidence_limits_are_those_of_the_binomial_distribution():
    share = proportion(3, 20)
    assert stats.binom.sf(2, 20, share.low) == pytest.approx(0.025)
    assert stats.binom.cdf(3, 20, share.high) == pytest.approx(0.025)
    assert (proportion(0, 5).low, proportion(5, 5).high, proportion(0, 0).value) == (0.0, 1.0, None)


def test_without_test_results_dies_fail_by_their_defects_and_no_kill_ratio_confirms_itself():
    found = inspection(defect(1, "0,0", 100, 100), defect(2, "1,0", 100, 100), states={"2,0": "missing", "2,1": "cut"})
    lot = lot_statistics([wafer(found)], max_per_die=0)
    assert lot.good is not None
    assert (lot.good.n, lot.good.total) == (2, 5)  # two with a defect, one missing, one cut, which does not count
    assert lot.kill_ratios == ()
    assert any("--tests" in note for note in lot.notes)
    assert lot_statistics([wafer(found)]).good is None


def test_pareto_charts_count_by_class_size_and_die_without_nuisances():
    found = inspection(
        defect(1, "0,0", 100, 100),
        defect(2, "0,0", 300, 100, judged_kind="scratch", major=Length(value_um=60.0)),
        defect(3, "1,0", 300, 100, judgement="nuisance"),
        defect(4, "1,0", 400, 100, size_resolved=False),
    )
    lot = lot_statistics([wafer(found)])
    by_class = {bar.name: bar.count for bar in lot.bars("class")}
    assert by_class == {"Particle": 2, "Scratch": 1}
    assert {bar.name: bar.count for bar in lot.bars("size")} == {
        "10 to 20 um": 1,
        "50 to 100 um": 1,
        "size not resolved": 1,
    }
    assert [(bar.name, bar.count) for bar in lot.bars("die")] == [("0,0", 2), ("1,0", 1)]
    assert lot.bars("die")[-1].cumulated == 1.0


def test_a_wafer_out_of_control_is_named_and_its_limits_follow_from_its_area():
    wafers = [*(counted(f"w{k}", 20, 100.0) for k in range(1, 8)), counted("w8", 40, 100.0), counted("w9", 5, 25.0)]
    lot = lot_statistics(wafers)
    assert [(line.name, line.outside) for line in lot.outside] == [("w8", "above")]
    assert lot.per_mm2 == pytest.approx(185 / 825)
    mean = 185 / 825 * 100
    high = lot.wafers[0].high_per_mm2
    assert high is not None
    assert stats.poisson.sf(high * 100, mean) <= 0.00135 < stats.poisson.sf(high * 100 - 1, mean)
    small = lot.wafers[-1].high_per_mm2
    assert small is not None
    assert small > high
    assert lot.dispersion_by_chance is not None
    assert lot.dispersion_by_chance < 0.05
    assert "above the control limits" in " ".join(row.remark for row in lot.rows)


@pytest.mark.slow
def test_wafers_of_one_density_are_hardly_ever_out_of_control():
    rng = np.random.default_rng(1011)
    outside, n = 0, 0
    for _ in range(40):
        lot = lot_statistics([counted(f"w{k}", int(rng.poisson(30)), 100.0) for k in range(25)])
        outside, n = outside + len(lot.outside), n + 25
    assert outside <= stats.binom.ppf(0.999, n, 0.0027)


def test_the_stack_has_each_defect_at_its_place_on_the_die():
    moved = replace(GRID, x0_um=GRID.x0_um + 77.0, y0_um=GRID.y0_um - 13.0)
    first, second = wafer(inspection(defect(1, "0,0", 100, 120))), wafer(inspection(defect(1, "1,0", 300, 200)), "w2")
    x, y = (float(um) for um in moved.to_stage(1, 0, 300, 200))
    there = replace(second, grid=moved, defects=(replace(second.defects[0], x_um=x, y_um=y),))
    stack = stacked_defects([first, there])
    places = [(one.die, one.x_um, one.y_um) for one in stack.defects]
    assert places[0] == ("0,0", -900.0, -680.0)
    assert places[1] == ("1,0", pytest.approx(300.0), pytest.approx(-600.0))
    assert {die.name: die.defects for die in stack.dies}["1,0"] == 1
    assert [one.number for one in stack.defects] == [1, 2]


def test_what_does_not_belong_together_is_refused():
    (one, test), (other, _) = worked("w1"), worked("w2")
    with pytest.raises(MeasureError, match="at least one"):
        lot_statistics([])
    with pytest.raises(MeasureError, match="another product"):
        lot_statistics([one, wafer(inspection())])
    with pytest.raises(MeasureError, match="map of wafer w1, and inspected were: w2"):
        lot_statistics([other], tests=[test])
    with pytest.raises(MeasureError, match="without a wafer id"):
        lot_statistics([one], tests=[replace(test, wafer="")])


def test_a_wafer_that_was_inspected_twice_is_told_apart_by_its_files():
    once = wafer(inspection(defect(1, "0,0", 100, 100)))
    lot = lot_statistics([once, replace(once, name="again")])
    assert [line.title for line in lot.wafers] == ["L1 w1 (w1)", "L1 w1 (again)"]
    assert any("more than once" in note for note in lot.notes)


def test_wafers_without_defects_dies_or_area_have_empty_tables():
    clean = lot_statistics([wafer(inspection()), wafer(inspection(), "w2")], max_per_die=0)
    assert (clean.pareto, clean.outside, clean.per_mm2, clean.dispersion) == ((), (), 0.0, None)
    assert clean.good is not None
    assert (clean.good.n, clean.good.total) == (12, 12)
    bare = WaferDefects(name="bare", defects=(WaferDefect(number=1, kind="Pit", x_um=3.0, y_um=4.0),))
    lot = lot_statistics([bare])
    assert (lot.per_mm2, lot.good, lot.signatures) == (None, None, ())
    assert lot.bars("die")[0].name == "off the dies"
    mixed = stacked_defects([bare, wafer(inspection(defect(1, "0,0", 100, 100)))])
    assert (len(mixed.defects), mixed.notes) == (1, ("Without dies, so not in the stack: bare.",))
