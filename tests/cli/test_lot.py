"""Statistics of several wafers from the command line: datasets and KLARF files, tables, JSON, page and bad input."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from tests.support.command_line import refused, viewer
from tests.support.datasets.inspections import defect, inspection, written_klarf
from tests.support.datasets.judged_datasets import judged_dataset, released_job
from wafer_viewer.model.acquisition.sample import Sample
from wafer_viewer.model.spec import replace
from wafer_viewer.store.records.inspection_records import write_inspection
from wafer_viewer.store.tables.wafer_map import write_wafer_map


def found(n: int, die: str = "0,0", kind: str = "particle"):
    return inspection(*(defect(k, die, 100 + 50 * k, 300, kind=kind) for k in range(1, n + 1)))


def sample(wafer: str) -> Sample:
    return Sample(lot="L7", wafer_id=wafer, notch="down", width_um=300_000.0)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Four wafers as KLARF, of which the last has many defects, and the defects.json of one more."""
    for wafer, n in (("w1", 2), ("w2", 1), ("w3", 2), ("w4", 14)):
        written_klarf(found(n), tmp_path / f"{wafer}.klarf", sample(wafer))
    write_inspection(tmp_path / "results" / "w5", found(2, "1,0", "scratch"))
    return tmp_path


def files(folder: Path) -> list[str]:
    return [*(str(folder / f"w{k}.klarf") for k in range(1, 5)), str(folder / "results/w5/defects.json")]


def test_own_files_and_klarf_make_one_lot_with_the_wafer_out_of_control_named(folder: Path):
    done = viewer("lot", *files(folder), "--max-per-die", "2")
    assert done.returncode == 1
    lot = json.loads(done.stdout)
    assert [(wafer["title"], wafer["outside"]) for wafer in lot["wafers"] if wafer["outside"]] == [("L7 w4", "above")]
    assert {bar["name"]: bar["count"] for bar in lot["pareto"] if bar["by"] == "class"} == {
        "Particle": 19,
        "Scratch": 2,
    }
    assert (lot["good"]["n"], lot["good"]["total"]) == (29, 30)
    assert "--tests" in done.stderr
    within = viewer("lot", *files(folder)[:3])
    assert (within.returncode, json.loads(within.stdout)["good"]) == (0, None)


def test_datasets_bring_their_wafer_and_the_judgements_of_people(folder: Path):
    judged = inspection(defect(1, "0,0", 100, 300), defect(2, "0,0", 500, 300, judgement="nuisance"))
    path = judged_dataset(folder / "w8.wafer", 5.0, released_job(), wafer="W8")
    assert "was not inspected" in refused("lot", path)
    write_inspection(path / "results" / "default", judged)
    lot = json.loads(viewer("lot", path, folder / "w1.klarf", "--max-per-die", "1").stdout)
    assert [(wafer["title"], wafer["defects"]) for wafer in lot["wafers"]] == [("L7 W8", 1), ("L7 w1", 2)]
    stored = json.loads(viewer("lot", path / "results" / "default" / "defects.json").stdout)
    assert stored["wafers"][0]["title"] == "L7 W8"
    assert "NOWHERE" in refused("lot", folder / "NOWHERE.wafer")


def test_test_results_give_yield_and_kill_ratio(folder: Path):
    failed = inspection(defect(1, "0,0", 100, 100), defect(2, "2,1", 100, 100))
    failed = replace(failed, recipe=replace(failed.recipe, limits=replace(failed.recipe.limits, max_per_die=0)))
    test = write_wafer_map(failed, folder / "w1.xml", sample("w1"), format="e142")
    lot = json.loads(viewer("lot", folder / "w1.klarf", "--tests", test).stdout)
    (kill,) = lot["kill_ratios"]
    assert (kill["kind"], kill["failing_with"]["n"], kill["failing_with"]["total"]) == ("Particle", 1, 1)
    assert (kill["failing_without"]["n"], kill["failing_without"]["total"], kill["ratio"]) == (1, 5, 1.0)
    assert (lot["good"]["n"], lot["good"]["total"]) == (4, 6)
    assert "map of wafer w1" in refused("lot", folder / "w2.klarf", "--tests", test)


def test_a_cluster_is_named_with_its_wafer(folder: Path):
    rng = np.random.default_rng(1111)
    places = zip(
        rng.integers(0, 3, 40), rng.integers(0, 2, 40), rng.uniform(0, 950, 40), rng.uniform(0, 760, 40), strict=True
    )
    spread = [defect(k, f"{col},{row}", u, v) for k, (col, row, u, v) in enumerate(places, 1)]
    close = [defect(k, "1,1", *rng.normal(400, 12, 2).tolist()) for k in range(41, 53)]
    written_klarf(inspection(*spread, *close), folder / "w6.klarf", sample("w6"))
    done = viewer("lot", folder / "w6.klarf", "-o", folder / "lot6")
    (found,) = json.loads(done.stdout)["signatures"]
    assert (found["wafer"], found["kind"], {*range(41, 53)} <= {*found["numbers"]}) == ("L7 w6", "cluster", True)
    rows = list(csv.DictReader((folder / "lot6" / "lot.csv").read_text().splitlines()))
    assert [row["quantity"] for row in rows if row["table"] == "signatures"] == ["cluster"]
    assert "Signatures" in (folder / "lot6" / "lot.html").read_text()


def test_page_table_and_json_have_the_same_numbers(folder: Path):
    out = folder / "out"
    viewer("lot", *files(folder), "-o", out, "--csv", folder / "own.csv")
    assert (out / "lot.csv").read_text() == (folder / "own.csv").read_text()
    rows = list(csv.DictReader((out / "lot.csv").read_text().splitlines()))
    density = {row["item"]: row for row in rows if row["table"] == "density"}
    stored = json.loads((out / "lot.json").read_text())
    assert float(density["L7 w4"]["value"]) == pytest.approx(stored["wafers"][3]["per_mm2"])
    page = (out / "lot.html").read_text()
    assert "out of control: L7 w4 (above)" in page
    assert "SIMULATED" in page
    assert page.count("<svg") == 3  # control chart, Pareto chart, stack
    assert "Defects of 1 wafer" in _page(folder, "w1.klarf")


def _page(folder: Path, *names: str) -> str:
    viewer("lot", *(folder / name for name in names), "-o", folder / "one.html")
    return (folder / "one.html").read_text()


def test_what_cannot_be_read_is_refused_in_one_sentence(folder: Path):
    assert "at least one" in refused("lot")
    assert "none.klarf" in refused("lot", folder / "none.klarf")
    assert "is no dataset" in refused("lot", folder)
    assert "is no name of a report" in refused("lot", folder / "w1.klarf", "-o", folder / "x.txt")


def test_adders_are_listed_and_limited(folder: Path):
    found = json.loads(viewer("adders", folder / "w1.klarf", folder / "w4.klarf").stdout)
    assert (len(found["common"]), found["added"], found["removed"]) == (2, list(range(3, 15)), [])
    out = folder / "pair"
    done = viewer("adders", folder / "w4.klarf", folder / "w1.klarf", "-o", out, "--max-added", "0")
    assert done.returncode == 0
    assert "different wafers" in done.stderr
    rows = list(csv.DictReader((out / "adders.csv").read_text().splitlines()))
    assert [row["item"] for row in rows if row["table"] == "removed"] == [str(k) for k in range(3, 15)]
    assert "Adders from w4.klarf to w1.klarf" in (out / "adders.html").read_text()
    assert "0 added, 12 removed, 2 common" in (out / "adders.html").read_text()
    assert viewer("adders", folder / "w1.klarf", folder / "w4.klarf", "--max-added", "11").returncode == 1
    assert "within_um is -1" in refused("adders", folder / "w1.klarf", folder / "w4.klarf", "--within-um", "-1")
