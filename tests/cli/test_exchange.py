"""Surface files on the command line: converted, measured, imported, and refused in one sentence."""

from __future__ import annotations

import json

import numpy as np
import pytest

from tests.support.datasets.samples import CALIBRATION, make_surface
from wafer_viewer.cli.app import main
from wafer_viewer.store.formats.conversion import export, read_surface


@pytest.fixture
def part(tmp_path):
    return export(make_surface(), tmp_path / "part.x3p")


def refused(capsys, *words):
    assert main([str(word) for word in words]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    return err


def test_what_a_format_cannot_hold_is_reported_when_it_is_written(part, tmp_path, capsys):
    assert main(["convert", str(part), str(tmp_path / "a.stl"), "--every", "2"]) == 0
    out, err = capsys.readouterr()
    assert out.strip() == str(tmp_path / "a.stl")
    assert "a.stl: It is a drawing, not data" in err
    assert "One row and one column in 2 are written, 1 um apart." in err
    assert main(["convert", str(part), str(tmp_path / "a.npz")]) == 0
    assert capsys.readouterr().err == ""


def test_density_is_given_in_one_way(part, tmp_path, capsys):
    assert main(["convert", str(part), str(tmp_path / "a.csv"), "--max-points", "100"]) == 0
    assert read_surface(tmp_path / "a.csv").pixel_um == 2.0
    capsys.readouterr()
    assert "give one of them" in refused(capsys, "convert", part, tmp_path / "b.csv", "--max-points", 9, "--every", 2)
    assert "take 1 for all" in refused(capsys, "convert", part, tmp_path / "b.csv", "--every", -1)
    assert not (tmp_path / "b.csv").exists()


@pytest.mark.parametrize("ending", [".x3p", ".gwy", ".ply", ".csv"])
def test_a_surface_file_is_measured_without_uncertainty_unless_it_carries_our_calibration(tmp_path, capsys, ending):
    found = {}
    for name, provenance in (("foreign", {}), ("ours", {"calibration": CALIBRATION})):
        path = export(make_surface(**provenance), tmp_path / f"{name}{ending}")
        assert main(["measure", "point", str(path), "--at", "105", "45"]) == 0
        found[name] = json.loads(capsys.readouterr().out)["height"]
    assert found["foreign"]["expanded_um"] is None
    assert "uncalibrated" in json.dumps(found["foreign"])
    assert found["foreign"]["value_um"] == found["ours"]["value_um"]


def test_what_the_file_does_not_say_is_requested_and_applied(tmp_path, capsys):
    path = tmp_path / "a.csv"
    path.write_text("\n".join(f"{c},{-r},{r * c}" for r, c in np.ndindex(4, 5)))
    assert "a.csv states no unit of its heights: give it, as in --z-unit um." in refused(
        capsys, "convert", path, tmp_path / "a.x3p"
    )
    assert main(["convert", str(path), str(tmp_path / "a.x3p"), "--z-unit", "mm"]) == 0
    assert read_surface(tmp_path / "a.x3p").pixel_um == pytest.approx(1000)


def test_a_surface_file_is_imported_and_converted_from_its_dataset(part, tmp_path, capsys):
    assert main(["import", str(part), "-o", str(tmp_path / "part.wafer")]) == 0
    assert "a surface without frames" in capsys.readouterr().out
    assert main(["measure", "point", str(tmp_path / "part.wafer"), "--at", "105", "45"]) == 0
    assert main(["convert", str(tmp_path / "part.wafer"), str(tmp_path / "back.gsf")]) == 0
    np.testing.assert_allclose(read_surface(tmp_path / "back.gsf").z_um, make_surface().z_um, atol=2e-6)


def test_a_mesh_is_read(part, tmp_path, capsys):
    assert main(["convert", str(part), str(tmp_path / "a.glb"), "--every", "1"]) == 0
    assert main(["import", str(tmp_path / "a.glb"), "-o", str(tmp_path / "b.wafer")]) == 0
    assert "a surface without frames" in capsys.readouterr().out
    assert main(["convert", str(tmp_path / "b.wafer"), str(tmp_path / "back.gsf")]) == 0
    np.testing.assert_allclose(read_surface(tmp_path / "back.gsf").z_um, make_surface().z_um, atol=1e-4)
