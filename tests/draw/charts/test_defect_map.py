"""The map of dies and the Pareto chart: nothing unknown looks clean, and no state is told by colour alone."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET

import pytest

from tests.support.datasets.inspections import GRID, defect, inspection
from wafer_viewer.draw.charts.defect_charts import pareto, pareto_svg
from wafer_viewer.draw.charts.die_map import (
    DIE_LOOKS,
    defect_map_svg,
    die_frame,
    die_shapes,
    fills_by_count,
    kind_of,
    kinds_of,
    kinds_text,
    look_svg,
)
from wafer_viewer.draw.charts.wafer_map import MOST_SINGLE
from wafer_viewer.model.inspection.die_grid import DieStatus
from wafer_viewer.model.spec import replace

STATES = {"0,0": "cut", "1,0": "partly scanned", "2,0": "not scanned", "0,1": "missing"}
FOUND = inspection(
    defect(1, "1,1", 100.0, 50.0), defect(2, "1,1", 300.0, 50.0), defect(3, "0,0", 100.0, 90.0), states=STATES
)


def shapes_of(text: str) -> dict[str, str]:
    """What is drawn of each die, by its name."""
    root = ET.fromstring("<svg>" + str(text) + "</svg>")
    return {g.get("data-die", ""): ET.tostring(g, "unicode") for g in root.iter("g") if g.get("data-die")}


def test_every_state_is_drawn_with_lines_of_its_own():
    drawn = shapes_of(die_shapes(die_frame(FOUND), FOUND, {}))
    lines = {name: (text.count("<path"), text.count("dasharray"), text.count("L")) for name, text in drawn.items()}
    unlike = ["0,0", "1,0", "2,0", "0,1", "2,1"]
    assert len({lines[name] for name in unlike}) == len(unlike)
    assert len({look_svg(kind) for kind in DIE_LOOKS}) == len(DIE_LOOKS)


def test_a_die_with_defects_that_is_cut_too_says_both():
    drawn = shapes_of(die_shapes(die_frame(FOUND), FOUND, {}))
    assert "Die 0,0: 1 defect · cut<" in drawn["0,0"]
    assert "Die 1,1: 2 defects<" in drawn["1,1"]
    assert "Die 2,1: clean<" in drawn["2,1"]
    assert "Die 2,0: not scanned<" in drawn["2,0"]


def test_dies_are_counted_by_what_became_of_them():
    assert kinds_of(FOUND.dies) == {
        "with defects": 1,
        "clean": 1,
        "cut": 1,
        "partly scanned": 1,
        "not scanned": 1,
        "missing": 1,
    }
    assert "1 cut (a corner off)" in kinds_text(FOUND.dies)
    nobody_looked = DieStatus(name="0,0", col=0, row=0, state="whole", measured_fraction=1.0)
    assert kind_of(nobody_looked) == "not inspected"


def test_the_more_defects_the_stronger_a_die_is_filled_and_it_bears_their_number():
    fills = fills_by_count({"0,0": 1, "1,1": 4, "2,1": 0})
    assert fills["0,0"].opacity < fills["1,1"].opacity
    assert "2,1" not in fills
    assert ">4</text>" in die_shapes(die_frame(FOUND), FOUND, fills)


def test_dies_lie_where_they_are_with_the_highest_row_on_top():
    frame = die_frame(FOUND, width_px=300)
    starts = {name: place(text) for name, text in shapes_of(die_shapes(frame, FOUND, {})).items()}
    assert starts["1,0"][0] - starts["0,0"][0] == pytest.approx(GRID.pitch_x_um * frame.scale, abs=0.2)
    assert starts["0,0"][1] - starts["0,1"][1] == pytest.approx(GRID.pitch_y_um * frame.scale, abs=0.2)


def test_a_lattice_that_is_turned_is_drawn_turned():
    turned = replace(FOUND, grid=replace(GRID, angle_rad=0.1))
    frame = die_frame(turned)
    starts = {name: place(text) for name, text in shapes_of(die_shapes(frame, turned, {})).items()}
    assert starts["1,0"][1] < starts["0,0"][1]  # anticlockwise: to the right is upwards


def test_the_chosen_die_has_a_heavy_edge():
    frame = die_frame(FOUND)
    assert "wv-die-on" in die_shapes(frame, FOUND, {}, chosen="1,1")
    assert "wv-die-on" not in die_shapes(frame, FOUND, {}, chosen="7,7")


def test_the_sample_is_in_the_map_only_where_the_dies_fill_much_of_it():
    near = ((-1500.0, -1500.0), (2500.0, -1500.0), (2500.0, 1500.0), (-1500.0, 1500.0))
    far = tuple((30 * x, 30 * y) for x, y in near)
    assert die_frame(FOUND, near).scale < die_frame(FOUND).scale
    assert die_frame(FOUND, far).scale == pytest.approx(die_frame(FOUND).scale)


def test_thousands_of_dies_are_a_few_shapes():
    grid = replace(GRID, cols=60, rows=50)
    dies = tuple(
        DieStatus(name=grid.name(*at), col=at[0], row=at[1], state="whole", measured_fraction=1.0, defects=at[0] % 2)
        for at in grid.places
    )
    assert len(dies) > MOST_SINGLE
    many = replace(FOUND, grid=grid, dies=dies)
    text = die_shapes(die_frame(many), many, {})
    assert text.count("<path") == 2
    assert text.count("z") == len(dies)


def test_without_dies_there_is_no_map():
    bare = replace(FOUND, grid=None, dies=())
    assert die_frame(bare) is None
    assert defect_map_svg(bare) == die_shapes(die_frame(FOUND), bare, {}) == ""


def test_a_bar_for_each_class_the_most_frequent_first_with_what_they_sum_up_to():
    bars = pareto(["pit", "particle", "particle", "scratch"])
    assert (bars[0].kind, bars[0].count, bars[0].share) == ("particle", 2, 0.5)
    assert [bar.cumulated for bar in bars] == [0.5, 0.75, 1.0]
    assert pareto([]) == ()
    text = pareto_svg(["pit", "particle", "particle", "scratch"])
    assert re.findall(r"(\d+) %", text) == ["50", "75", "100"]
    ET.fromstring(text)


def place(text: str) -> tuple[float, float]:
    """Where the edge of a die begins."""
    x, y = re.search(r'd="M([-\d.]+) ([-\d.]+)l', text).groups()
    return float(x), float(y)
