"""Steps and grooves from the command line: numbers as JSON, or one sentence."""

from __future__ import annotations

import json

import pytest

from tests.support.surfaces import STEP_UM, gauge_blocks
from wafer_viewer.cli.app import main
from wafer_viewer.store.formats.npz_file import write_npz

UPPER, LOWER = (-150, -50, -40, 50), (40, -50, 150, 50)


@pytest.fixture(scope="module")
def blocks(tmp_path_factory):
    path = tmp_path_factory.mktemp("blocks") / "blocks.npz"
    write_npz(gauge_blocks(1, noise_um=0.3, simulated=True), path)
    return path


def reported(capsys, *words):
    assert main(["measure", *map(str, words)]) == 0, capsys.readouterr().err
    return json.loads(capsys.readouterr().out)


def covers(length, truth_um):
    return abs(length["value_um"] - truth_um) <= length["expanded_um"]


def test_a_step_of_several_rectangles_by_a_definition(blocks, capsys):
    found = reported(
        capsys, "step", blocks, "--upper", *(-150, -50, -100, 50), *(-90, -50, -40, 50), "--lower", *LOWER,
        *("--definition", "lower_face", "--repeatability-um", 0.02, "--temperature-c", 21),
    )  # fmt: skip
    assert covers(found["height"], STEP_UM + 3e-4 * 95)
    assert len(found["also_upper"]) == 1
    assert found["options"]["definition"] == "lower_face"
    assert {line["name"] for line in found["height"]["budget"]} >= {"repeatability", "temperature"}
    assert found["not_evaluated"] == ["z linearity", "drift during the scan", "Abbe offset"]


@pytest.mark.slow
@pytest.mark.parametrize("words", [(), ("--faces", "auto")])
def test_faces_are_found_where_none_are_given(blocks, capsys, words):
    found = reported(capsys, "step", blocks, *words)
    assert abs(found["height"]["value_um"] - STEP_UM) < 1
    assert found["notes"][0] == "The faces were found automatically."


def test_a_single_step_along_a_line(blocks, capsys):
    found = reported(
        capsys, "groove", blocks, "--line", *(-150, 0, 150, 0), "--width-um", 60, "--shape", "step", "--drift-um", 0.01
    )
    assert abs(found["height"]["value_um"] + STEP_UM) < 1
    assert found["kind"] == "step"
    assert found["filter"] == "mean over 60 um across the line"
    assert "drift during the scan" not in found["not_evaluated"]


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("step", "--upper", *UPPER), "--upper is given and --lower is not: give both, or neither"),
        (("step", "--upper", *UPPER, "--lower", *LOWER, "--faces", "auto"), "leave one of them out"),
        (("step", "--upper", *UPPER, "--lower", -150, 0, 150, 40), "The two regions share "),
        (("step", "--upper", *UPPER, "--lower", 900, 900, 950, 950), "lies outside of the surface"),
        (("step", "--upper", *UPPER, "--lower", 100, -50, 400, 50), "Only 20 % of the lower region is measured"),
        (("step", "--upper", *UPPER, "--lower", *LOWER, "--repeatability-um", -1), "repeatability_um is -1.0: it must"),
        (("groove", "--line", 500, 0, 900, 0), "lies outside of the surface"),
        (("groove", "--line", -150, 0, -20, 0, "--shape", "step"), "No step stands out of the noise along the line"),
    ],
)
def test_what_cannot_be_measured_is_one_sentence(blocks, capsys, words, sentence):
    tool, *flags = words
    assert main(["measure", tool, str(blocks), *map(str, flags)]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.count("\n") == 1
    assert sentence in printed.err
