"""Comparing from the command line and from Python, as people do."""

from __future__ import annotations

import json

import numpy as np
import pytest

import wafer_viewer as wv
from tests.support.command_line import viewer
from tests.support.compared_surfaces import a_texture, taken, tilted, with_bump
from tests.support.datasets.compared_datasets import BUMP_UM, SHIFT_UM, two_datasets
from wafer_viewer.store.formats.npz_file import write_npz

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    made = tmp_path_factory.mktemp("compared")
    two_datasets(made)
    for name, surface in {"a": taken(), "b": tilted(taken(*SHIFT_UM, seed=1), 1.0), "other": a_texture(3)}.items():
        write_npz(surface, made / f"{name}.npz")
    return made


def test_files_are_compared_and_the_difference_is_a_file(folder):
    done = viewer("compare", "a.npz", "b.npz", "-o", "off.npz", cwd=folder)
    assert (done.returncode, done.stderr) == (0, "")
    found = json.loads(done.stdout)
    assert found["registration"]["x_um"] == pytest.approx(SHIFT_UM[0], abs=found["registration"]["u_xy_um"])
    off = wv.read_npz(folder / "off.npz")
    assert float(np.nanmean(off.z_raw_um)) == pytest.approx(found["change"]["mean_um"], abs=1e-4)
    assert viewer("compare", "a.npz", "b.npz", "--align", "none", cwd=folder).returncode == 0


def test_a_difference_is_kept_with_the_first_dataset_under_a_name(folder):
    done = viewer("compare", "before.wafer", "after.wafer", "-o", "later", cwd=folder)
    assert done.returncode == 0, done.stderr
    change = json.loads(done.stdout)["change"]
    assert change["gained_um3"] - change["lost_um3"] == pytest.approx(40 * 60 * BUMP_UM, rel=0.05)
    data = wv.Dataset.open(folder / "before.wafer")
    assert data.differences() == ("difference-later",)
    assert data.result("difference-later").mosaic().shape == data.result().mosaic().shape


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("a.npz", "other.npz", "-o", "x.npz"), "do not look alike"),
        (("a.npz", "gone.npz"), "does not exist"),
        (("a.npz", "b.npz", "-o", "name"), "is not a file: give it an ending"),
        (("a.npz", "b.npz", "-o", "off.abc"), "has no ending that is known"),
        (("a.npz", "b.npz", "--align", "somehow"), "somehow"),
        (("before.wafer", "after.wafer", "--second-result", "levy"), "has no stitched surface"),
    ],
)
def test_what_cannot_be_is_one_sentence_with_status_2_and_leaves_nothing(folder, words, says):
    before = sorted(p.name for p in folder.rglob("*"))
    done = viewer("compare", *words, cwd=folder)
    assert (done.returncode, done.stdout) == (2, "")
    assert says in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert sorted(p.name for p in folder.rglob("*")) == before


def test_python_compares_maps_in_memory():
    made = wv.compare(taken(), with_bump(taken(seed=1), slice(200, 240), slice(300, 360), 2.0), align="stage")
    assert made.change().gained_um3 == pytest.approx(40 * 60 * 2.0, rel=0.05)
    assert isinstance(made.window(), wv.HeightMap)
