"""Damaged files of a result: the command that the check names mends them."""

from __future__ import annotations

import re
import shlex
import shutil

import pytest

from tests.support.campaigns import drawn_after
from tests.support.datasets.complete_dataset import complete_dataset
from wafer_viewer.cli.app import main
from wafer_viewer.store.dataset.dataset import Dataset

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return complete_dataset(tmp_path_factory.mktemp("mends") / "whole.wafer")


@pytest.mark.parametrize(
    "name",
    drawn_after(
        3,
        [
            "poses.npz",
            "recipe.json",
            "settled.json",
            "surfaces/r0000c0000.npz",
            "mosaic.zarr/zarr.json",
            "mosaic.zarr/z_um/0/c/0/0",
            "mosaic.zarr/facts/c/0/0/0",
            "verdict.json",
        ],
    ),
)
def test_the_command_that_the_check_names_mends_a_damaged_file(whole, name, tmp_path, monkeypatch, capsys):
    path = shutil.copytree(whole, tmp_path / "a.wafer")
    monkeypatch.chdir(tmp_path)
    file = path / "results" / "default" / name
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 1
    file.write_bytes(content)
    assert main(["check", "a.wafer"]) == 1
    fault, *_ = [line for line in capsys.readouterr().out.splitlines() if "is damaged" in line and f"{name} " in line]
    if "remove it" in fault:
        file.unlink()
    main(shlex.split(re.search(r"\(wafer-viewer (.*?)\)", fault)[1]))
    capsys.readouterr()
    assert Dataset.open(path).check().ok
    assert main(["check", "a.wafer"]) == 0
