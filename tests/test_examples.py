"""The examples that people copy run as they stand, and find what their samples have."""

from __future__ import annotations

import json
import runpy
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pytest

from tests.support.command_line import viewer
from tests.support.paths import ROOT
from tests.write_notebooks import NAMES as NOTEBOOK_OF
from tests.write_notebooks import NOTEBOOKS, cells_of
from wafer_viewer.measure.texture.areal_texture import Texture
from wafer_viewer.model.surface.height_map import Origin
from wafer_viewer.rigs.virtual.scenes.wafer import DEPTH_UM

EXAMPLES = ROOT / "assets/examples"
NAMES = sorted(path.stem for path in EXAMPLES.glob("*.py"))


@pytest.fixture(scope="module")
def scan(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder with the scan that several examples open."""
    folder = tmp_path_factory.mktemp("examples")
    (folder / "rig.toml").write_text('kind = "virtual"\nseed = 1\n')
    scan = ("scan", ROOT / "assets/plans/wafer.toml", "--rig", "rig.toml", "-o", "scan.wafer")
    for words in (scan, ("stitch", "scan.wafer")):
        done = viewer(*words, cwd=folder)
        assert done.returncode == 0, done.stderr
    return folder


@pytest.fixture
def run(scan: Path, monkeypatch: pytest.MonkeyPatch):
    """Run an example in the folder of the scan, and return its names."""
    mpl.use("agg")
    import matplotlib.pyplot as plt

    monkeypatch.chdir(scan)

    def run_example(name: str) -> dict[str, Any]:
        (path,) = EXAMPLES.glob(f"{name}*.py")
        found = runpy.run_path(str(path), run_name="__main__")
        assert plt.get_fignums(), "an example without a picture has none in the gallery"
        plt.close("all")
        return found

    return run_example


def test_there_are_ten_examples_each_with_a_test():
    numbers = [name[:2] for name in NAMES]
    assert numbers == [f"{number:02d}" for number in range(1, 11)]
    tested = [name[len("test_example_") :][:2] for name in globals() if name.startswith("test_example_")]
    assert sorted(tested) == numbers


@pytest.mark.parametrize("name", NOTEBOOK_OF)
def test_a_notebook_has_the_cells_of_its_example_and_its_pictures(name: str):
    script = (EXAMPLES / NOTEBOOK_OF[name]).read_text(encoding="utf-8")
    cells = json.loads((NOTEBOOKS / f"{name}.ipynb").read_text(encoding="utf-8"))["cells"]
    kept = [(cell["cell_type"], "".join(cell["source"])) for cell in cells]
    assert kept == [(cell.kind, cell.source) for cell in cells_of(script)], "run tests/write_notebooks.py"
    outputs = [output for cell in cells for output in cell.get("outputs", ())]
    assert any("image/png" in output.get("data", {}) for output in outputs)
    assert not any(output["output_type"] == "error" for output in outputs)


@pytest.mark.campaign
def test_example_01_scans_and_measures_a_field(run):
    found = run("01")
    assert len(found["data"].fields) == 2
    assert found["height"].measured.mean() > 0.5


@pytest.mark.slow
def test_example_02_finds_the_dome(run):
    found = run("02")
    error_um = found["height"].z_um - found["dome_um"]
    assert np.nanmedian(np.abs(error_um)) < 0.5
    assert (found["folder"] / "dome.x3p").is_file()


@pytest.mark.slow
def test_example_03_compares_four_measures(run):
    quality = run("03")["quality"]
    assert len(quality) == 4
    assert all(found.completeness_fraction > 0.8 and found.false_fraction < 0.01 for found in quality.values())


@pytest.mark.slow
def test_example_04_covers_the_true_step(run):
    """By 3 u: the noise is new in every scan, and one in twenty lies beyond 2 u."""
    step = run("04")["step"]
    assert abs(float(step) - DEPTH_UM) <= 3 * step.u


@pytest.mark.slow
def test_example_05_removes_the_errors_of_the_stage(run):
    found = run("05")
    by_stage, stitched = (np.nanmedian(found[name].window().overlap_um) for name in ("by_stage", "stitched"))
    assert stitched < 0.05 < 0.1 < by_stage


@pytest.mark.slow
def test_example_06_filters_make_the_texture_smaller(run):
    found = run("06")
    plain, filtered = found["plain"], found["filtered"]
    assert isinstance(filtered, Texture)
    assert 0 < filtered.sa.value_um < plain.sa.value_um
    assert plain.sa.expanded_um > 0
    assert filtered.sa.expanded_um > 0


@pytest.mark.slow
def test_example_07_finds_the_three_defects_and_no_other(run):
    found = run("07")
    assert (found["dies"].cols, found["dies"].rows) == (5, 4)
    kinds = {(defect.kind, defect.die) for defect in found["found"].defects}
    assert kinds == {("particle", "2,2"), ("residue", "0,0"), ("scratch", "3,0")}


@pytest.mark.slow
def test_example_08_drives_the_stage(run, capsys):
    seen = np.array(run("08")["seen"])
    speeds = np.diff(seen[:, 1]) / np.diff(seen[:, 0])
    assert np.median(speeds) == pytest.approx(-10_000, rel=1e-3)
    assert "its range is -50000 to 50000 um" in capsys.readouterr().out


@pytest.mark.slow
def test_example_09_measures_the_median(run):
    found = run("09")
    heights = found["surface"].window(found["face"]).z_raw_um
    height = found["median_height"](found["surface"], found["face"], over_um=20.0).height
    assert height.value_um == pytest.approx(np.nanmedian(heights) - 20.0, abs=0.05)


@pytest.mark.slow
def test_example_10_fills_all_by_the_paper_and_little_by_default(run):
    heights = run("10")["heights"]
    filled = {name: np.mean(height.origin == Origin.FILLED) for name, height in heights.items()}
    assert filled["paper"] + heights["paper"].measured.mean() == pytest.approx(1.0)
    assert filled["default"] < 0.03
