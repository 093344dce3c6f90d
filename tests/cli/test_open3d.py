"""Open3D on machines that lack libraries it links to: loaded all the same, or named with the line that mends it."""

from __future__ import annotations

import json
import os
import pickle
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest
import tifffile

from tests.support.compared_surfaces import taken, tilted
from tests.support.patience import until
from tests.support.surfaces import STEP_UM, gauge_blocks
from wafer_viewer.cli.app import main
from wafer_viewer.gui.steps.gauge.gauge_step import FACES, search_faces
from wafer_viewer.gui.widgets.ask import Ask
from wafer_viewer.gui.widgets.callbacks import guarded
from wafer_viewer.measure.gauge.find_faces import find_faces
from wafer_viewer.model.errors import ComputeError
from wafer_viewer.numerics.open3d_library import load_open3d
from wafer_viewer.reconstruct.comparison.compare import compare
from wafer_viewer.session.core.environment_check import check_open3d
from wafer_viewer.store.formats.npz_file import read_npz, write_npz

SMALL = (*("--z-step-um", "2", "--pixel-um", "0.5"), *("--recipe.outliers.mode", "cloud"))


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("files")
    write_npz(gauge_blocks(1, noise_um=0.3, simulated=True), folder / "blocks.npz")
    write_npz(taken(), folder / "before.npz")
    write_npz(tilted(taken(6, -4, seed=1), 1.0), folder / "after.npz")
    texture, z_um = np.random.default_rng(1).normal(0, 40, (64, 80)), 2.0 * np.arange(12)
    contrast = np.exp(-(((z_um - 11) / 5) ** 2))[:, None, None]
    tifffile.imwrite(folder / "stack.tif", np.clip(120 + contrast * texture, 0, 255).astype(np.uint8))
    return folder


@pytest.fixture
def without(tmp_path):
    """Environment of a program that finds no usable library of a name: an empty file comes first."""

    def hidden(library: str) -> dict[str, str]:
        (tmp_path / library).touch()
        return {**os.environ, "LD_LIBRARY_PATH": str(tmp_path)}

    return hidden


def run(environment, *words):
    return subprocess.run([sys.executable, *map(str, words)], capture_output=True, text=True, env=environment)


class Page:
    """What the search for faces and a failed callback ask of the page."""

    def __init__(self, files):
        self.told, self.view, self.redraw, self.on_close = [], SimpleNamespace(show=0), int, id
        self.session = SimpleNamespace(gauge=SimpleNamespace(find_faces=lambda show: find_faces(gauge_blocks(1))))
        self.compare = lambda: compare(*(read_npz(files / f"{name}.npz") for name in ("before", "after")))
        self.tell = self.told.append


@pytest.mark.slow
def test_faces_are_found_without_the_usb_library_of_the_system(files, without):
    machine = without("libusb-1.0.so.0")
    assert "libusb-1.0.so.0" in run(machine, "-c", "import open3d").stderr
    done = run(machine, "-m", "wafer_viewer", "measure", "step", files / "blocks.npz", "--faces", "auto")
    assert (done.returncode, done.stderr) == (0, "")
    assert abs(json.loads(done.stdout)["height"]["value_um"] - STEP_UM) < 1


@pytest.mark.slow
def test_a_missing_library_is_named_with_the_package_that_brings_it(files, without):
    done = run(without("libGL.so.1"), "-m", "wafer_viewer", "measure", "step", files / "blocks.npz")
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert "libGL.so.1" in done.stderr
    assert "run 'sudo apt-get install libgl1'" in done.stderr


@pytest.mark.slow
def test_faces_and_comparison_name_the_same_mend_and_the_papers_outliers_need_none(
    files, monkeypatch, capsys, tmp_path
):
    monkeypatch.setitem(sys.modules, "open3d", None)
    with pytest.raises(ComputeError, match=r"^Open3D cannot be loaded \(.*\): run 'pip install ") as fault:
        load_open3d()
    commands = (
        ("measure", "step", files / "blocks.npz"),
        ("compare", files / "before.npz", files / "after.npz"),
    )
    for words in commands:
        assert main([str(word) for word in words]) == 2
        assert str(fault.value) in capsys.readouterr().err
    assert main([str(word) for word in ("reconstruct", files / "stack.tif", "-o", tmp_path / "z.npz", *SMALL)]) == 0
    page = Page(files)
    here = SimpleNamespace(page=page, ask=Ask(page))
    search_faces(here)
    until(lambda: here.ask.known(FACES).problem)
    guarded(page, "The surfaces were not compared")(page.compare)()
    assert [here.ask.known(FACES).problem, *(told.text for told in page.told)] == [str(fault.value)] * 2
    check = check_open3d()
    assert not check.well
    assert f"run '{check.mend}'" in str(fault.value)


def test_the_reason_comes_back_from_a_worker(monkeypatch):
    monkeypatch.setitem(sys.modules, "open3d", None)
    with pytest.raises(ComputeError) as fault:
        load_open3d()
    assert str(pickle.loads(pickle.dumps(fault.value))) == str(fault.value)
