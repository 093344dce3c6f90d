"""Wafers that cannot be inspected, or in part only: one sentence, or a status that says so; no list looks clean."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from tests.support.patterned_surface import Wafer, made
from wafer_viewer.cli.app import main
from wafer_viewer.measure.defects.inspection import inspect
from wafer_viewer.measure.dies.die_lattice import find_dies
from wafer_viewer.model.errors import DiesNotFound, MeasureError
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.height_map import HeightMap, Origin
from wafer_viewer.store.formats.npz_file import write_npz

GIVEN = ("--pitch-um", "201.3", "147.7", "--origin-um", "31.7", "22.9", "--size-um", "173", "121")
GAP = Region.rectangle(700, 500, 1100, 900)


def unmeasured(of: HeightMap) -> HeightMap:
    """Nearly every pixel refused by the gates, on a wafer whose picture shows its dies."""
    z, origin = np.full(of.shape, np.nan, np.float32), np.full(of.shape, Origin.NO_TEXTURE, np.uint8)
    z[:6, :6], origin[:6, :6] = 1.0, Origin.MEASURED
    return dataclasses.replace(of, z_um=z, z_raw_um=z, origin=origin)


def noise(of: HeightMap) -> HeightMap:
    z = np.random.default_rng(5).standard_normal(of.shape).astype(np.float32)
    return dataclasses.replace(of, z_um=z, z_raw_um=z, all_in_focus=np.full(of.shape, 80, np.uint8))


def one_die() -> HeightMap:
    large = {"pitch_x_um": 1900.0, "width_um": 1150.0, "pitch_y_um": 1700.0, "height_um": 900.0}
    return made(Wafer(**large, x0_um=120.0, y0_um=150.0))


WITHOUT_DIES = {
    "nothing repeats": (lambda: noise(made()), "No dies are found, because nothing repeats along x or y"),
    "one die only": (one_die, "are no whole dies|nothing repeats along|pitch along x is ambiguous"),
    "turned by 8 degrees": (lambda: made(Wafer(angle_deg=8)), r"turned by 8\.0 degrees and at most 5 can be found"),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("wafers")


@pytest.mark.campaign(at_least_one=True)
@pytest.mark.parametrize(("make", "says"), WITHOUT_DIES.values(), ids=WITHOUT_DIES.keys())
def test_without_dies_the_search_is_refused_and_the_fitted_form_has_to_be_asked_for(folder, capsys, make, says):
    surface, path = make(), folder / "without.npz"
    with pytest.raises(DiesNotFound, match=says) as printed:
        find_dies(surface)
    assert str(printed.value).count(". ") <= 1
    write_npz(surface, path)
    assert main(["measure", "defects", str(path)]) == 2
    refused = capsys.readouterr()
    assert (refused.out, refused.err.count("\n")) == ("", 1)
    assert str(printed.value) in refused.err
    assert "--against form" in refused.err
    assert main(["measure", "defects", str(path), "--against", "form"]) in (0, 1)
    asked = capsys.readouterr()
    found = json.loads(asked.out)
    assert found["inspection"]["reference"] == "form"
    assert found["inspection"]["notes"][0].startswith("Only what stands out of the fitted form is seen")
    assert next(iter(found)) == "result"
    assert found["result"] in asked.err
    assert " inspected, compared with the fitted form: " in found["result"]


@pytest.mark.campaign
def test_a_surface_without_heights_is_refused_in_one_sentence(folder, capsys):
    says = "hardly any measured pixels|shows no contrast"
    surface, path = unmeasured(made()), folder / "bad.npz"
    with pytest.raises(MeasureError, match=says) as printed:
        inspect(surface, find_dies(surface))
    assert str(printed.value).count(". ") == 0
    write_npz(surface, path)
    assert main(["measure", "defects", str(path)]) == 2
    reported = capsys.readouterr()
    assert (reported.out, reported.err.count("\n")) == ("", 1)
    assert str(printed.value) in reported.err


@pytest.mark.slow
def test_given_dies_on_a_surface_without_heights_are_refused(folder, capsys):
    write_npz(unmeasured(made()), folder / "blank.npz")
    assert main(["measure", "defects", str(folder / "blank.npz"), *GIVEN]) == 2
    reported = capsys.readouterr()
    assert reported.out == ""
    assert "hardly any measured pixels: there is nothing to inspect" in reported.err


@pytest.mark.campaign
def test_a_wafer_turned_by_3_degrees_is_inspected(folder, capsys):
    write_npz(made(Wafer(angle_deg=3, unmeasured_fraction=0)), folder / "turned.npz")
    assert main(["measure", "defects", str(folder / "turned.npz"), "--sensitivity", "0.1"]) == 0
    reported = json.loads(capsys.readouterr().out)["inspection"]
    assert reported["grid"]["angle_rad"] == pytest.approx(np.radians(3), abs=1e-4)
    assert reported["inspected_mm2"] > 1


@pytest.mark.campaign(at_least_one=True)
@pytest.mark.parametrize("against", ["dies", "form"])
def test_with_a_field_missing_no_list_is_clean(folder, capsys, against):
    write_npz(made(Wafer(unmeasured_fraction=0), gap=GAP), folder / "gap.npz")
    assert main(["measure", "defects", str(folder / "gap.npz"), "--against", against, "--sensitivity", "0"]) == 1
    reported = json.loads(capsys.readouterr().out)
    assert not reported["verdict"]["within"]
    assert any("clean" in why for why in reported["verdict"]["why"])


@pytest.mark.slow
def test_what_no_field_covers_counts_as_not_scanned_and_not_measured():
    found = inspect(made(Wafer(unmeasured_fraction=0), gap=GAP))
    assert found.not_scanned_mm2 == pytest.approx(GAP.area_um2 / 1e6, rel=0.02)
    assert found.unmeasured_mm2 == pytest.approx(GAP.area_um2 / 1e6, rel=0.02)


@pytest.mark.slow
def test_dies_of_which_half_is_refused_are_never_clean(folder, capsys):
    surface = made(Wafer(unmeasured_fraction=0))
    _, _, u, _ = Wafer().grid.to_die(*np.meshgrid(surface.x_um, surface.y_um))
    z = np.where(u > 80, np.float32(np.nan), surface.z_um)
    origin = np.where(np.isnan(z), np.uint8(Origin.NO_TEXTURE), surface.origin)
    write_npz(dataclasses.replace(surface, z_um=z, z_raw_um=z, origin=origin), folder / "halves.npz")
    assert main(["measure", "defects", str(folder / "halves.npz"), *GIVEN, "--as-given"]) == 1
    reported = json.loads(capsys.readouterr().out)
    assert len(reported["verdict"]["not_inspected"]) == sum(
        die["state"] == "partly scanned" for die in reported["inspection"]["dies"]
    )
    assert not any(die["state"] == "whole" for die in reported["inspection"]["dies"])
