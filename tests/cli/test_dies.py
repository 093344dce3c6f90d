"""The dies from the command line: found or given, as JSON, or one sentence."""

from __future__ import annotations

import json

import pytest

from tests.support.datasets.inspections import written_klarf
from tests.support.patterned_surface import Wafer, made
from wafer_viewer.cli.app import main
from wafer_viewer.model.acquisition.plan import FieldGrid, FocusSweep
from wafer_viewer.model.inspection.defect import Inspection
from wafer_viewer.model.job import Job
from wafer_viewer.model.measurement.feature import Dies
from wafer_viewer.model.spec import encode, replace
from wafer_viewer.store.formats.npz_file import write_npz

GIVEN = ("--pitch-um", 201.3, 147.7, "--origin-um", 31.7, 22.9, "--size-um", 173, 121)


@pytest.fixture(scope="module")
def surface(tmp_path_factory):
    path = tmp_path_factory.mktemp("surface") / "dies.npz"
    write_npz(made(), path)
    return path


def dies_of(surface, capsys, *flags):
    assert main(["measure", "dies", str(surface), *map(str, flags)]) == 0, capsys.readouterr().err
    return json.loads(capsys.readouterr().out)


@pytest.mark.slow
def test_dies_are_found_or_taken_as_given(surface, capsys):
    found, given = dies_of(surface, capsys), dies_of(surface, capsys, *GIVEN, "--as-given")
    assert found["pitch_x"]["value_um"] == pytest.approx(Wafer().pitch_x_um, rel=5e-5)
    assert (found["grid"]["by"], given["grid"]["by"]) == ("found", "given")
    assert (found["pitch_x"]["status"], given["pitch_x"]["status"]) == ("uncalibrated", "not evaluated")
    assert found["counts"] == given["counts"] == {"whole": 56}
    assert [die["name"] for die in found["dies"]][:2] == ["0,0", "1,0"]
    assert [die["name"] for die in given["dies"]][:2] == ["0,0", "1,0"], "die 0,0 is the one whose corner was given"
    assert found["simulated"]
    assert found["off"] is given["off"] is None


@pytest.mark.campaign
def test_dies_are_found_by_their_pitch_and_size_alone(surface, tmp_path, capsys):
    found = dies_of(surface, capsys, "--pitch-um", 200.5, 148.5, "--size-um", 172.2, 121.8)["grid"]
    assert (found["by"], found["x0_um"]) == ("found", pytest.approx(31.7, abs=1.0))
    assert found["pitch_x_um"] == pytest.approx(Wafer().pitch_x_um, rel=5e-5)
    assert found["width_um"] == pytest.approx(172.2), "dies keep a known size"
    klarf = tmp_path / "other.klarf"
    written_klarf(Inspection(grid=replace(Wafer().grid, cols=2, rows=2)), klarf)
    assert dies_of(surface, capsys, "--job", klarf)["grid"]["pitch_y_um"] == pytest.approx(147.7, rel=5e-5)
    assert main(["measure", "dies", str(surface), "--pitch-um", "330", "260"]) == 2
    assert "look alike, so they are no whole dies" in capsys.readouterr().err


@pytest.mark.slow
def test_given_dies_are_overlaid_on_those_seen(surface, capsys):
    given = dies_of(surface, capsys, *GIVEN[:4], 36.7, 22.9, *GIVEN[6:])
    assert given["off"]["origin_x_um"] == pytest.approx(-5, abs=0.5)
    assert given["grid"]["x0_um"] == pytest.approx(31.7, abs=0.5)
    assert given["pitch_x"]["status"] == "uncalibrated"


@pytest.mark.slow
def test_the_dies_of_a_job_keep_its_names(surface, tmp_path, capsys):
    dies = Dies(width_um=173, height_um=121, rows=5, cols=4, pitch_x_um=201.3, pitch_y_um=147.7, x0_um=30, y0_um=24)
    job = Job(
        grid=FieldGrid(rows=1, cols=1, field_width_um=600, field_height_um=500),
        sweep=FocusSweep(z_step_um=1, n_frames=3),
        dies=dies,
    )
    path = tmp_path / "plan.toml"
    path.write_text(encode(job))
    found = dies_of(surface, capsys, "--job", path)
    assert len(found["dies"]) == 20
    assert found["off"]["origin_x_um"] == pytest.approx(1.7, abs=0.5)
    path.write_text(encode(replace(job, dies=None)))
    assert main(["measure", "dies", str(surface), "--job", str(path)]) == 2
    assert "plan.toml names no dies: give --pitch-um and --origin-um" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize(
    ("flags", "sentence"),
    [
        (GIVEN[3:], "The size and the corner of dies go with their pitch: give --pitch-um too."),
        ((*GIVEN[:3], "--angle-deg", 1), "The angle of dies, and --as-given, go with their corner: give --origin-um"),
        ((*GIVEN, "--job", "plan.toml"), "Dies are given by a file or by their pitch: leave --job or --pitch-um out."),
        ((*GIVEN[:3], "--size-um", 250, 121), "ProductDies.width_um is 250.0: it must be at most the pitch 201.3 um."),
        (("--job", "gone.toml"), "gone.toml cannot be read, it does not exist: check the path."),
        ((*GIVEN[:4], 100, *GIVEN[5:]), "um off those that the surface shows, over a quarter of their pitch"),
        ((*GIVEN[:7], 250, 121), "DieGrid.width_um is 250.0: it must be at most the pitch 201.3 um."),
        (("--pitch-um", 9000, 9000, *GIVEN[3:4], 2000, 2000, *GIVEN[6:]), "No die of the lattice lies on the surface"),
    ],
)
def test_invalid_input_is_refused_in_one_sentence(surface, capsys, flags, sentence):
    assert main(["measure", "dies", str(surface), *map(str, flags)]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert sentence in printed.err
    assert printed.err.count("\n") == 1
