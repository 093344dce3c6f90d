"""The dies from the command line: found or given, as JSON, or one sentence."""

from __future__ import annotations

import json

import pytest

from tests.measure.patterned import Wafer, made
from wafer_viewer.__main__ import main
from wafer_viewer.store.npz import write_npz

GIVEN = ("--pitch-um", 201.3, 147.7, "--origin-um", 31.7, 22.9, "--size-um", 173, 121)


@pytest.fixture(scope="module")
def surface(tmp_path_factory):
    path = tmp_path_factory.mktemp("surface") / "dies.npz"
    write_npz(made(), path)
    return path


def dies_of(surface, capsys, *flags):
    assert main(["measure", "dies", str(surface), *map(str, flags)]) == 0, capsys.readouterr().err
    return json.loads(capsys.readouterr().out)


def test_dies_are_found_or_taken_as_given(surface, capsys):
    found, given = dies_of(surface, capsys), dies_of(surface, capsys, *GIVEN)
    assert found["pitch_x"]["value_um"] == pytest.approx(Wafer().pitch_x_um, rel=5e-5)
    assert (found["grid"]["by"], given["grid"]["by"]) == ("found", "given")
    assert (found["pitch_x"]["status"], given["pitch_x"]["status"]) == ("uncalibrated", "not evaluated")
    assert found["counts"] == given["counts"] == {"cut": 8, "whole": 56}
    assert [die["name"] for die in found["dies"]] == [die["name"] for die in given["dies"]]
    assert found["simulated"]


@pytest.mark.parametrize(
    ("flags", "sentence"),
    [
        (GIVEN[:3], "A lattice of dies that is given needs --origin-um, --size-um as well"),
        (("--angle-deg", 1), "A lattice of dies that is given needs --pitch-um, --origin-um, --size-um as well"),
        ((*GIVEN[:7], 250, 121), "DieGrid.width_um is 250.0: it must be at most the pitch 201.3 um."),
        (("--pitch-um", 9000, 9000, *GIVEN[3:4], 2000, 2000, *GIVEN[6:]), "No die of the lattice lies on the surface"),
    ],
)
def test_what_cannot_be_is_one_sentence(surface, capsys, flags, sentence):
    assert main(["measure", "dies", str(surface), *map(str, flags)]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert sentence in said.err
    assert said.err.count("\n") == 1
