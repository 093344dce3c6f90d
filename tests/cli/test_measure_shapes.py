"""Shapes from the command line: numbers as JSON, or one sentence."""

from __future__ import annotations

import json

import pytest

from tests.browser.sessions.shaped_session import DIE_X_UM, DIE_Y_UM, PITCH_Y_UM, bumped_dies
from wafer_viewer.cli.app import main
from wafer_viewer.store.formats.npz_file import write_npz

KERF = ("--region", -40, -86, 39, -35)


@pytest.fixture(scope="module")
def surface(tmp_path_factory):
    path = tmp_path_factory.mktemp("surface") / "dies.npz"
    write_npz(bumped_dies(), path)
    return path


@pytest.fixture
def measured(surface, capsys):
    def run(tool, *flags):
        assert main(["measure", tool, str(surface), *map(str, flags)]) == 0, capsys.readouterr().err
        return json.loads(capsys.readouterr().out)

    return run


def test_each_shape_is_measured_with_its_uncertainty(measured):
    kerf = measured("kerf", *KERF)
    assert kerf["width"]["value_um"] == pytest.approx(PITCH_Y_UM - DIE_Y_UM, abs=0.1)
    die = measured("die", "--region", -69, -57, 68, 57)
    assert die["width"]["value_um"] == pytest.approx(DIE_X_UM, abs=0.1)
    assert measured("circle", "--circle", 0, 0, 9)["inside"] == "bright"
    assert measured("chipping", "--region", -40, -54, 39, -35, "--limit-um", 3)["n_chips"] == 1
    bumps = measured("coplanarity", "--region", -52, -40, 51, 40, "--reference", "seating")
    assert (bumps["n_bumps"], len(bumps["bumps"]), bumps["options"]["reference"]) == (15, 15, "seating")
    assert all(found["simulated"] for found in (kerf, die, bumps))
    assert {kerf["width"]["status"], die["height"]["status"], bumps["coplanarity"]["status"]} == {"evaluated"}


@pytest.mark.parametrize(
    ("tool", "flags", "sentence"),
    [
        ("kerf", ("--region", 900, 900, 950, 950), "lies outside of the surface"),
        ("kerf", (*KERF, "--kerf", "dark"), "No edge stands out on both sides of a kerf"),
        ("coplanarity", ("--region", -30, -20, 10, 10), "Coplanarity needs 4 whole, measured bumps"),
    ],
)
def test_what_is_none_is_one_sentence(surface, capsys, tool, flags, sentence):
    assert main(["measure", tool, str(surface), *map(str, flags)]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert sentence in printed.err
    assert printed.err.count("\n") == 1
