"""Measuring from the command line: numbers as JSON, or one sentence."""

from __future__ import annotations

import json

import numpy as np
import pytest

from tests.support.command_line import viewer
from tests.support.surfaces import calibration, coordinates, noise_of, surface_of
from wafer_viewer.cli.app import commands, main
from wafer_viewer.store.formats.npz_file import write_npz

TILT, RADIUS_UM, FOOT_UM = 0.02, 60.0, 25.0
TOP_UM = RADIUS_UM - np.sqrt(RADIUS_UM**2 - FOOT_UM**2)
VOLUME_UM3 = np.pi * TOP_UM**2 * (3 * RADIUS_UM - TOP_UM) / 3


@pytest.fixture(scope="module")
def surface(tmp_path_factory):
    """A bump of 25 um about (0, 0) um on a plane that rises by 0.02 along x, and a step of 3 um beyond y = 60 um."""
    x_um, y_um = np.meshgrid(*coordinates(320, 300))
    away2 = x_um**2 + y_um**2
    cap = np.sqrt(np.maximum(RADIUS_UM**2 - away2, 0)) - np.sqrt(RADIUS_UM**2 - FOOT_UM**2)
    z = np.where(away2 < FOOT_UM**2, cap, 0) + TILT * x_um + np.where(y_um > 60, 3.0, 0.0)
    path = tmp_path_factory.mktemp("surface") / "bump.npz"
    held = calibration(u_z_scale=1e-5)
    write_npz(surface_of(z + noise_of(1, z.shape, 0.02), calibration=held, z_step_um=1.0, simulated=True), path)
    return path


@pytest.fixture
def measured(surface, capsys):
    def run(tool, *flags):
        assert main(["measure", tool, str(surface), *map(str, flags)]) == 0, capsys.readouterr().err
        return json.loads(capsys.readouterr().out)

    return run


@pytest.fixture
def refused(surface, capsys):
    def run(tool, *flags):
        assert main(["measure", tool, str(surface), *map(str, flags)]) == 2
        printed = capsys.readouterr()
        assert printed.out == ""
        assert printed.err.startswith("wafer-viewer: ")
        assert printed.err.count("\n") == 1
        return printed.err

    return run


def holds(length, truth, per_cent=None):
    """Whether a length is right within its U (or within per cent, where it has none)."""
    u = length["expanded_um"] if per_cent is None else per_cent / 100 * abs(truth)
    return abs(length["value_um"] - truth) <= u


def test_a_point_and_the_way_to_another(measured):
    point = measured("point", "--at", -60, 20)
    assert holds(point["height"], TILT * -60)
    assert point["height"]["status"] == "evaluated"
    assert point["simulated"]
    mode = measured("distance", "--start", -60, 40, "--end", 60, 40)
    assert holds(mode["dz"], TILT * 120)
    assert mode["slope"]["unit"] == "deg"
    assert mode["slope"]["value"] == pytest.approx(np.degrees(np.arctan(TILT)), abs=mode["slope"]["expanded"])


def test_a_step_and_an_angle(measured):
    over = ["--upper", -60, 64, 60, 78, "--lower", -60, 40, 60, 56]
    assert holds(measured("step", *over)["height"], 3.0)
    faces = ["--first", -70, 30, -30, 58, "--second", 30, 30, 70, 58]
    assert measured("angle", *faces)["angle"]["value"] < 0.2


def test_a_bump_has_a_radius_and_a_volume(measured):
    bump = measured("radius", "--circle", 1, -1, 32)
    assert bump["kind"] == "bump"
    assert holds(bump["radius"], RADIUS_UM, per_cent=1)
    assert holds(bump["top"], TOP_UM, per_cent=1)
    over = measured("volume", "--region", -32, -32, 32, 32)
    assert over["volume_above"]["value"] == pytest.approx(VOLUME_UM3, rel=0.01)
    assert over["reference"] == "border"


def test_flatness_and_texture_of_a_face(measured):
    face = ["--region", -70, -70, -30, -30]
    assert measured("flatness", *face)["flt_q"]["value_um"] == pytest.approx(0.02, rel=0.1)
    assert measured("texture", *face)["sq"]["value_um"] == pytest.approx(0.02, rel=0.1)


def test_flatness_and_texture_tell_their_uncertainty(measured):
    """All of it is noise, which the values hold and U covers."""
    face = ["--region", -70, -70, -30, -30]
    flat = measured("flatness", *face)
    for name in ("flt_t", "flt_q", "flt_t_minimum_zone"):
        assert flat[name]["status"] == "evaluated"
        assert flat[name]["value_um"] < flat[name]["expanded_um"] < 3 * flat[name]["value_um"]
    without, known = measured("texture", *face), measured("texture", *face, "--noise-um", 0.02)
    assert without["sq"]["status"] == "not evaluated"
    assert known["options"]["noise_um"] == 0.02
    assert known["sq"]["value_um"] == without["sq"]["value_um"] < known["sq"]["expanded_um"]
    assert "noise of the heights" in [line["name"] for line in known["sq"]["budget"]]


def test_texture_and_roughness_through_filters(measured):
    face = ["--region", -70, -70, -30, -30]
    found = measured("texture", *face, "--form-order", 3, "--s-filter-um", 2, "--l-filter-um", 20)
    assert found["filter"] == "Gaussian (ISO 16610-61), S 2 um, L 20 um"
    assert found["options"] == {
        "form_order": 3,
        "s_filter_um": 2.0,
        "l_filter_um": 20.0,
        "noise_um": None,
        "slopes": "neighbours",
        "spikes": "keep",
        "borders": "keep",
        "c_um": None,
        "mr_percent": None,
    }
    assert found["sq"]["value_um"] < 0.015, "noise of single pixels is taken off"
    line = measured("roughness", "--line", -70, -50, -30, -50, "--lambda-c-um", 10, "--lambda-s-um", 2)
    assert (line["sections"], line["section_um"]) == (4, 10.0)
    assert "4 of 5 sampling lengths" in " ".join(line["notes"])
    assert 0 < line["ra"]["value_um"] < 0.02
    face = [*face, "--c-um", -0.01, "--mr-percent", 10, "--borders", "cut", "--l-filter-um", 10]
    found = measured("texture", *face)
    assert 0.5 < found["smr_fraction"] <= 1
    assert found["smc"]["value_um"] > 0


@pytest.mark.parametrize(
    ("level", "by"),
    [
        (["plane"], "plane"),
        (["form"], "form"),
        (["form", "1"], "form"),
        (["region", "-70", "-70", "-30", "50"], "region"),
        (["points", "-60", "-60", "60", "-60", "50", "50"], "three points"),
    ],
)
def test_heights_are_read_from_another_zero(measured, level, by):
    found = measured("point", "--at", -60, 20, "--level", *level)
    assert found["levelling"]["by"] == by
    assert abs(found["height"]["value_um"]) < 1.0, "1.2 um under the stage's zero"
    over = measured("volume", "--region", -70, -70, 70, 50, "--level", *level)
    assert over["reference"] == "zero"
    over = measured("volume", "--region", -32, -32, 32, 32, "--reference", "border", "--level", *level)
    assert over["reference"] == "border"


@pytest.mark.parametrize(
    ("tool", "flags", "sentence"),
    [
        ("point", ["--at", 900, 0], "lies outside of the surface"),
        ("point", ["--at", 0, 0, "--level", "banana"], "--level cannot be 'banana': use plane, form,"),
        ("point", ["--at", 0, 0, "--level", "points", 1, 2], "--level cannot be 'points 1 2'"),
        ("point", ["--at", 0, 0, "--level", "form", "two"], "--level takes numbers after its first word, not 'two'"),
        ("point", ["--at", 0, 0, "--level", "form", 9], "between 1 and 4"),
        ("texture", ["--region", 0, 0, 3, 3], "needs at least 200"),
        ("texture", ["--region", -70, -70, -30, -30, "--l-filter-um", 50], "L-filter of 50 um is longer than the face"),
        ("texture", ["--region", -70, -70, -30, -30, "--s-filter-um", 0], "s_filter_um is 0.0: it must be over 0"),
        ("texture", ["--region", -70, -70, -30, -30, "--form-order", 9], "form_order is 9: it must be between 0 and 8"),
        ("roughness", ["--line", 900, 0, 950, 0], "lies outside of the surface"),
        ("roughness", ["--line", 0, 0, 20, 0, "--lambda-c-um", 80], "lambda-c of 80 um is longer than the line"),
        ("roughness", ["--line", -70, 0, 70, 0, "--lambda-c-um", 8, "--lambda-s-um", 9], "must be under lambda_c_um"),
        ("flatness", ["--region", 0, 0, 300, 300], "of the face is measured and flatness needs 50 %"),
        ("radius", ["--circle", -50, 40, 15], "Nothing stands out of the surroundings"),
        ("distance", ["--start", 1, 1, "--end", 1, 1], "Both points are at"),
    ],
)
def test_what_cannot_be_measured_is_one_sentence(refused, tool, flags, sentence):
    assert sentence in refused(tool, *flags)


def test_each_is_a_command_with_help():
    tools = [name for name in commands() if name.startswith("measure ")]
    assert len(tools) >= 9
    done = viewer("measure", "radius", "--help")
    assert "--circle X Y RADIUS" in done.stdout
    assert "form [ORDER]" in " ".join(done.stdout.split())
