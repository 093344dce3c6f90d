"""Gauge-block checks from the command line: as JSON with a status, signed, over days, and the z scale by them."""

from __future__ import annotations

import json

import pytest

from tests.support.datasets.gauge_scans import CALIBRATION, CORNERS, RIG, scan_of_blocks, surface
from tests.support.gauge_repeats import record
from tests.support.paths import ASSETS
from wafer_viewer.cli.app import main
from wafer_viewer.model.gauge import GaugeTerms
from wafer_viewer.model.spec import replace
from wafer_viewer.session.calibration.calibration_controller import calibration_rows
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.formats.npz_file import write_npz
from wafer_viewer.store.records.calibration_records import GAUGE_LOG, calibration_in_force, calibration_records, sign

CERTIFICATE = ASSETS / "gauge" / "step.toml"
CHECK = ("--certificate", str(CERTIFICATE), "--field", "1", *CORNERS)


@pytest.fixture
def scans(tmp_path):
    return [str(scan_of_blocks(tmp_path, seed, 0.3)) for seed in (1, 2, 3)]


@pytest.fixture
def reported(capsys: pytest.CaptureFixture[str]):
    """Runs a command that answers; gives its status and what it says."""

    def run(*argv: str):
        status = main(list(argv))
        out = capsys.readouterr()
        assert out.err == ""
        return status, json.loads(out.out)

    return run


@pytest.fixture
def refused(capsys: pytest.CaptureFixture[str]):
    """Runs a command that refuses; gives its one sentence."""

    def run(*argv: str) -> str:
        assert main(list(argv)) == 2
        out = capsys.readouterr()
        assert (out.out, out.err.count("\n")) == ("", 1)
        return out.err

    return run


@pytest.mark.slow
def test_a_check_says_error_en_and_verdict_with_its_status(scans, reported):
    status, printed = reported("measure", "gauge", *scans, *CHECK, "--limit-um", "1", "--temperature-c", "21")
    assert (status, printed["verdict"], printed["simulated"]) == (0, "pass", True)
    assert printed["deviation"]["value_um"] == pytest.approx(0.3, abs=0.05)
    assert printed["reference"]["value_um"] == pytest.approx(399.88 * (1 + 11.5e-6))
    assert abs(printed["en"]) > 1
    assert "too small" in printed["en_why"]
    assert {line["of"] for line in printed["budget"]} == {"scale", "measurement", "reference"}
    assert printed["not_evaluated"]
    assert reported("measure", "gauge", *scans, *CHECK, "--limit-um", "0.1")[0] == 1
    status, printed = reported("measure", "gauge", *scans, *CHECK)
    assert (status, printed["verdict"]) == (1, "no verdict")


def test_surface_files_are_repeats_too(tmp_path, reported):
    for seed in (1, 2):
        write_npz(surface(seed), tmp_path / f"{seed}.npz")
    files = [str(tmp_path / f"{seed}.npz") for seed in (1, 2)]
    status, printed = reported(
        "measure", "gauge", *files, "--certificate", str(CERTIFICATE), *CORNERS, "--limit-um", "1"
    )
    assert (status, len(printed["repeats"])) == (0, 2)


@pytest.mark.slow
def test_a_signed_check_is_in_log_and_results_and_makes_history(scans, tmp_path, reported, refused):
    folder, terms = str(tmp_path), ("--limit-um", "1", "--tolerance-um", "10")
    for name, of in (("Ann", scans[:1]), ("Bob", scans[1:])):
        _, printed = reported("measure", "gauge", *of, *CHECK, *terms, "--sign", name)
        assert (printed["signed_by"], printed["capability"]["n"]) == (name, 1 if name == "Ann" else 3)
    assert "is in the check that Ann signed" in refused("measure", "gauge", *scans, *CHECK, "--sign", "Cy")
    assert (tmp_path / GAUGE_LOG).read_text().count("\n") == 2
    (stored,) = Dataset.open(scans[-1]).result("default").findings().items
    assert (stored.name, stored.signed_by, stored.n) == ("Gauge check 1", "Bob", 2)
    status, printed = reported(
        "measure", "gauge", "--log", folder, "--serial", "V-1000", "V-1400", "--tolerance-um", "10"
    )
    assert status == 0
    assert [point["signed_by"] for point in printed["chart"]["points"]] == ["Ann", "Bob"]
    assert (printed["rig"], printed["capability"]["n"], printed["capability"]["capable"]) == (RIG, 3, None)


@pytest.mark.slow
def test_the_z_scale_is_shown_then_set_by_a_person(scans, tmp_path, reported, refused):
    folder = str(tmp_path)
    assert "no signed check" in refused("calibrate", "z", folder)
    reported("measure", "gauge", *scans, *CHECK, "--sign", "Ann")
    _, offered = reported("calibrate", "z", folder)
    assert offered["recorded"] is False
    assert calibration_in_force(tmp_path, RIG, CALIBRATION) == CALIBRATION
    _, done = reported("calibrate", "z", folder, "--by", "Ann", "--why", "yearly")
    assert done["recorded"] is True
    corrected = calibration_in_force(tmp_path, RIG, CALIBRATION)
    assert corrected.z_scale == pytest.approx(done["factor"])
    (record,) = calibration_records(tmp_path, RIG, "z")
    assert (record.after, record.signed_by, record.why) == (corrected, "Ann", "yearly")
    (scale,) = record.result.characteristics
    assert (scale.value, scale.expanded) == (corrected.z_scale, 2 * corrected.u_z_scale * corrected.z_scale)
    assert "z" not in {row.kind for row in calibration_rows(tmp_path, RIG) if row.record is None}
    assert "corrected by this check already" in refused("calibrate", "z", folder, "--by", "Ann")
    again = scan_of_blocks(tmp_path, 9, calibration=corrected)
    assert "so a comparison with it checks nothing" in refused("measure", "gauge", str(again), *CHECK)


@pytest.mark.parametrize(
    ("change", "argv", "printed"),
    [
        ({"calibration": None}, CHECK, "no check without a calibration"),
        ({"calibration": replace(CALIBRATION, due="2026-01-02")}, CHECK, "was due on 2026-01-02"),
        ({"taken": "2100-01-01"}, CHECK, "expired on 2099-12-31"),
        ({"error_um": -30.0}, CHECK, "other blocks"),
        ({}, CHECK[2:], "give --certificate"),
        ({}, CHECK[:-5], "One face makes no step"),
        ({}, (*CHECK, "--limit-um", "0"), "limit_um is 0.0"),
        ({}, (*CHECK, "--sign", " "), "signed with a name"),
    ],
)
def test_an_invalid_check_is_refused_in_one_sentence(tmp_path, refused, change, argv, printed):
    scan = scan_of_blocks(tmp_path, 1, **change)
    assert printed in refused("measure", "gauge", str(scan), *argv)
    assert not (tmp_path / GAUGE_LOG).exists()


def test_the_same_scan_twice_is_no_repeat(tmp_path, refused):
    scan = str(scan_of_blocks(tmp_path, 1))
    assert "a repeat is a new scan" in refused("measure", "gauge", scan, scan, *CHECK)


def test_scans_of_two_rigs_are_no_repeats(tmp_path, refused):
    write_npz(surface(1), tmp_path / "other.npz")
    scan = str(scan_of_blocks(tmp_path, 2))
    assert "several rigs" in refused("measure", "gauge", scan, str(tmp_path / "other.npz"), *CHECK)


def test_a_history_is_of_one_pair_of_blocks_on_one_rig(tmp_path, reported, refused):
    for rig in ("Rig 1", "Rig 2"):
        sign(tmp_path, replace(record("2026-06-01", 400.0), rig=rig))
    assert "A1 A2 on Rig 1; A1 A2 on Rig 2" in refused("measure", "gauge", "--log", str(tmp_path))
    assert reported("measure", "gauge", "--log", str(tmp_path), "--rig", "Rig 2")[1]["rig"] == "Rig 2"
    assert "no signed checks" in refused("measure", "gauge", "--log", str(tmp_path), "--serial", "A1")


def test_a_drift_out_of_the_limit_is_reported_with_status_1(tmp_path, reported):
    for day, error_um in enumerate([0.0, 0.021, 0.04, 0.059, 0.08], 1):
        sign(tmp_path, record(f"2026-06-{day:02d}", 400.0 + error_um))
    status, printed = reported("measure", "gauge", "--log", str(tmp_path))
    assert status == 1
    assert "before the next check is due" in printed["chart"]["warnings"][0]


@pytest.mark.parametrize(("limit_um", "status"), [(0.5, 1), (None, 0)])
def test_history_whose_last_check_failed_has_status_1(tmp_path, reported, limit_um, status):
    sign(tmp_path, record("2026-06-01", 400.0, terms=GaugeTerms(limit_um=limit_um)))
    sign(tmp_path, record("2026-06-02", 401.5, terms=GaugeTerms(limit_um=limit_um)))
    found, printed = reported("measure", "gauge", "--log", str(tmp_path))
    assert printed["chart"]["points"][-1]["verdict"] == ("fail" if limit_um else "no verdict")
    assert (found, printed["chart"]["warnings"]) == (status, [])


def test_a_history_of_nothing_is_refused(tmp_path, refused):
    assert "nothing to check" in refused("measure", "gauge")
    assert "no signed checks" in refused("measure", "gauge", "--log", str(tmp_path))
