"""Calibrations from the command line: results as JSON, records when signed, the list with due days."""

from __future__ import annotations

import json
import signal

import pytest

from tests.support.gauge_repeats import record
from tests.support.paths import ASSETS
from wafer_viewer.cli.app import main
from wafer_viewer.model.acquisition.characteristics import KINDS
from wafer_viewer.session.acquisition import headless
from wafer_viewer.store.records.calibration_records import calibration_in_force, sign

RIG = str(ASSETS / "rigs" / "uncalibrated.toml")
QUICK = ("--repeats", "2", "--exposure-us", "125", "--z-range-um", "60")


@pytest.fixture
def printed(capsys, monkeypatch):
    """Runs a command; gives its status and output, on a wide terminal."""
    monkeypatch.setenv("COLUMNS", "200")

    def run(*argv):
        status = main(list(argv))
        out = capsys.readouterr()
        return status, out.out, out.err

    return run


@pytest.mark.campaign
def test_a_hidden_delay_is_found_signed_listed_and_in_force(printed, tmp_path):
    status, out, _ = printed("calibrate", "delay", "--rig", RIG, "--data", str(tmp_path), *QUICK)
    found = json.loads(out)
    delay = found["characteristics"][0]
    assert (status, found["recorded"]) == (0, None)
    assert delay["value"] == pytest.approx(62.0, abs=2 * delay["expanded"])
    assert list(tmp_path.iterdir()) == []
    status, out, _ = printed("calibrate", "delay", "--rig", RIG, "--data", str(tmp_path), *QUICK, "--by", "Ann")
    assert json.loads(out)["recorded"].endswith("-delay.json")
    status, out, _ = printed("calibrate", "list", str(tmp_path), "--rig", RIG)
    assert status == 1, "others are missing"
    assert "trigger delay" in out
    assert "Ann" in out
    assert "needs" in out
    status, out, _ = printed("calibrate", "list", str(tmp_path), "--json")
    (listed,) = json.loads(out)
    in_force = calibration_in_force(tmp_path, listed["rig"], None)
    assert in_force is None, "only of a rig that has one of its own"
    assert listed["after"]["trigger_delay_us"] == listed["result"]["characteristics"][0]["value"]


def test_ctrl_c_stops_the_rig_and_leaves_no_record(printed, tmp_path, monkeypatch):
    monkeypatch.setattr(headless.ProcedureSteering, "report", lambda *_: signal.raise_signal(signal.SIGINT))
    status, out, _ = printed("calibrate", "delay", "--rig", RIG, "--data", str(tmp_path), *QUICK, "--by", "Ann")
    assert status == 130
    assert "Nothing is recorded" in out
    assert list(tmp_path.iterdir()) == []


def test_an_empty_signature_is_refused_before_anything_moves(printed, tmp_path):
    status, out, err = printed("calibrate", "pixel", "--rig", RIG, "--data", str(tmp_path), "--by", " ")
    assert (status, out) == (2, "")
    assert "say who signs it with --by NAME" in err


def test_linearity_comes_from_signed_checks(printed, tmp_path):
    status, _, err = printed("calibrate", "linearity", str(tmp_path))
    assert status == 2
    assert "has no signed check" in err
    sign(tmp_path, record("2026-06-01", 400.1, 400.2, 400.0))
    status, out, _ = printed("calibrate", "linearity", str(tmp_path), "--by", "Ann")
    found = json.loads(out)
    assert status == 0
    assert [one["name"] for one in found["characteristics"]] == ["amplification coefficient of z"]
    assert "takes certified steps of two heights" in found["notes"][1]
    status, out, _ = printed("calibrate", "list", str(tmp_path))
    assert "amplification" in out.lower()


@pytest.mark.slow
def test_a_flat_field_is_found_signed_listed_and_its_maps_lie_beside_the_record(printed, tmp_path):
    quick = ("--exposure-us", "100", "--z-range-um", "60", "--n-side", "2", "--frames", "2")
    status, out, _ = printed("calibrate", "flat-field", "--rig", RIG, "--data", str(tmp_path), *quick, "--by", "Ann")
    found = json.loads(out)
    assert status == 0
    assert "flat_field" not in found, "maps are not printed"
    (maps,) = (tmp_path / "calibrations" / "flat-fields").iterdir()
    assert maps.stem == found["sets"]["flat_field"][: len(maps.stem)]
    shading, dark = found["characteristics"]
    assert 14 < shading["value"] < 20
    assert dark["value"] == pytest.approx(4.0, abs=0.2)
    status, out, _ = printed("calibrate", "list", str(tmp_path), "--rig", RIG)
    assert "shading of the image" in out
    for title in ("x-y mapping deviation", "Lateral resolution", "z scale", "topographic spatial resolution"):
        assert title in out


def test_every_kind_of_calibration_has_a_command_with_its_options(capsys):
    for kind, one in KINDS.items():
        with pytest.raises(SystemExit):
            main(["calibrate", kind, "--help"])
        shown = capsys.readouterr().out
        for option in one.options:
            assert f"--{option.name.replace('_', '-')}" in shown, (kind, option.name)
