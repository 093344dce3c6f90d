"""Verdicts and signed checks that somebody changed, with right checksums: what the user then reads."""

from __future__ import annotations

import json
import shutil

import pytest

from tests.support.datasets.judged_datasets import CALIBRATED, RESULT, judged_dataset, released_job
from tests.support.gauge_repeats import certificate, repeats
from wafer_viewer.cli.app import main
from wafer_viewer.measure.gauge.gauge_check import contradiction, gauge_check
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.gauge import GaugeCheck, GaugeRecord, GaugeTerms
from wafer_viewer.model.roles import AuditEntry
from wafer_viewer.model.spec import decode, encode, replace
from wafer_viewer.session.gauge.gauge_check import trusted_checks
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.io.checksums import sealed_line, sealed_text, strip_checksum, verified_text
from wafer_viewer.store.records.calibration_records import (
    CALIBRATIONS,
    GAUGE_LOG,
    CalibrationChange,
    record_change,
    sign,
)
from wafer_viewer.store.records.signed_log import AUDIT_LOG, KEPT_IN, known_public_key, record_action


@pytest.fixture
def dataset(tmp_path):
    return judged_dataset(tmp_path / "W1.wafer", 12.3, released_job())


def forge(dataset, change):
    path = dataset / "results" / RESULT / "verdict.json"
    verdict = json.loads(verified_text(path))
    change(verdict)
    path.write_text(sealed_text(json.dumps(verdict, indent=2)))


def value(verdict):
    verdict["items"][0]["measured"]["value"] = 15.5


def word(verdict):
    verdict["items"][0]["word"] = "fail"


def wafer_word(verdict):
    verdict["word"] = "fail"


def smaller_u(verdict):
    verdict["items"][0]["measured"]["expanded"] /= 10


def no_item(verdict):
    verdict["items"].clear()
    verdict["word"] = "no verdict"


def item_without_a_value(verdict):
    del verdict["items"][0]["measured"]


def limits(verdict):
    verdict["items"][0]["feature"]["upper_limit"] = 99.0


@pytest.mark.campaign(at_least_one=True)
@pytest.mark.parametrize(
    ("change", "says"),
    [
        (value, "'die over street' is said to be pass, and is fail by its value and limits"),
        (word, "'die over street' is said to be fail, and is pass by its value and limits"),
        (wafer_word, "the wafer is said to be fail, and is pass by its features"),
        (smaller_u, "'die over street': U is said to be 0."),
        (no_item, "'die over street' of the job was not judged"),
        (item_without_a_value, "'die over street' is said to be pass, and was not measured"),
        (limits, "'die over street' has other limits or places than in the job"),
    ],
)
@pytest.mark.parametrize("command", ["report", "measure verdict"])
def test_a_verdict_that_contradicts_itself_is_not_shown(dataset, tmp_path, capsys, change, says, command):
    page = tmp_path / "r.html"
    words = [*command.split(), str(dataset), *(("-o", str(page)) if command == "report" else ())]
    assert main(words) == 0
    forge(dataset, change)
    capsys.readouterr()
    page.unlink(missing_ok=True)
    assert main(words) == 2
    err = capsys.readouterr().err
    assert says in err
    assert "Remove it to have the wafer judged again." in err
    assert not page.exists()


@pytest.fixture(scope="module")
def check():
    found = gauge_check(repeats(400.1), certificate(grade="0"), GaugeTerms(limit_um=0.5, temperature_c=20.0))
    return replace(found, signed_by="Ann", at="2026-06-01T10:00:00")


def edited(check, change):
    plain = json.loads(encode(check, "json"))
    change(plain)
    return decode(json.dumps(plain).encode(), GaugeCheck, "check", "json")


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda c: c["height"].update(value_um=400.0), "the height is said to be 400.0000 um"),
        (lambda c: c["deviation"].update(value_um=0.0), "the error is said to be 0.0000 um"),
        (lambda c: c["deviation"].update(expanded_um=0.01), "the error is said to be"),
        (lambda c: c["repeats"][0]["height"].update(value_um=399.0), "the height is said to be"),
        (lambda c: c["budget"][0].update(u_um=0.0), "is said to be"),
        (lambda c: c.update(verdict="fail"), "the verdict is said to be fail, and is pass"),
        (lambda c: c.update(en=0.0), "En is not that of the height and the reference"),
        (lambda c: c["terms"].update(limit_um=0.01), "the verdict is said to be pass, and is"),
        (lambda c: c["certificate"].update(value_um=401.0), "the reference is said to be"),
    ],
)
def test_a_check_that_contradicts_itself_is_told(check, change, says):
    assert contradiction(check) is None
    assert says in (contradiction(edited(check, change)) or "")


def test_such_a_check_is_not_taken_from_the_log(check, tmp_path):
    sign(tmp_path, GaugeRecord(check=check))
    assert len(trusted_checks(tmp_path)) == 1
    sign(tmp_path, GaugeRecord(check=edited(check, lambda c: c.update(verdict="fail"))))
    with pytest.raises(DatasetError, match=r"by Ann was altered: the verdict is said to be fail, and is pass"):
        trusted_checks(tmp_path)


def test_check_reads_the_records_of_the_dataset_and_of_its_folder(dataset, check, tmp_path, capsys):
    sign(tmp_path, GaugeRecord(check=check))
    assert main(["check", str(dataset)]) == 1  # it has no frames
    out = capsys.readouterr().out
    key = known_public_key(tmp_path)
    assert f"{tmp_path / GAUGE_LOG}: 1 record, 1 signed with the key {key}" in out
    assert "altered" not in out
    forge(dataset, value)
    log = tmp_path / GAUGE_LOG
    log.write_bytes(sealed_line(strip_checksum(log.read_bytes().strip()).replace(b"Ann", b"Bob")) + b"\n")
    assert main(["check", str(dataset)]) == 1
    out = capsys.readouterr().out
    assert "verdict.json was altered: 'die over street' is said to be pass, and is fail" in out
    assert f"{log} was altered: the signature of line 1 does not fit its contents" in out
    log.unlink()
    assert main(["check", str(dataset)]) == 1
    assert f"{log} was altered: it has 0 lines, and had 1" in capsys.readouterr().out


LOGGED = {
    GAUGE_LOG: lambda folder, check: sign(folder, GaugeRecord(check=check)),
    CALIBRATIONS: lambda folder, check: record_change(folder, change_of_scale()),
    AUDIT_LOG: lambda folder, check: record_action(folder, scan_started()),
}


def scan_started():
    return AuditEntry(
        at="2026-06-01T10:00:00", by="Ann", through="page", action="Scan started", subject="W1.wafer", detail=""
    )


def change_of_scale():
    return CalibrationChange(rig="R", at="2026-06-01", by="Ann", why="", before=CALIBRATED, after=CALIBRATED)


@pytest.mark.parametrize("name", LOGGED)
def test_log_stripped_of_signatures_and_head_is_found(dataset, check, tmp_path, capsys, name):
    for _ in range(2):
        LOGGED[name](tmp_path, check)
    log = tmp_path / name
    lines = [json.loads(strip_checksum(line)) for line in log.read_bytes().splitlines()]
    bare = [{key: value for key, value in line.items() if key != "link"} for line in lines]
    log.write_bytes(b"".join(sealed_line(json.dumps(line).replace("Ann", "Bob").encode()) + b"\n" for line in bare))
    (tmp_path / KEPT_IN / f"{name}.head").unlink()
    assert main(["check", str(dataset)]) == 1
    assert f"{log} was altered: line 1 is not signed" in capsys.readouterr().out


@pytest.mark.parametrize("name", LOGGED)
def test_log_removed_with_its_head_is_missed_by_a_dataset_signed_after_it(dataset, check, tmp_path, capsys, name):
    LOGGED[name](tmp_path, check)
    result = Dataset.open(dataset).result(RESULT)
    result.save_findings(result.findings())
    for path in (tmp_path / name, tmp_path / KEPT_IN / f"{name}.head", tmp_path / KEPT_IN / f"{name}.lock"):
        path.unlink()
    main(["check", str(dataset)])
    says = (
        f"{tmp_path / name} was removed or replaced together with its head: it has 0 records, and had 1 when W1.wafer"
    )
    assert says in capsys.readouterr().out
    result.save_findings(result.findings())
    assert main(["check", str(dataset)]) == 1
    assert says in capsys.readouterr().out, "a later signature does not forget it"


def test_logs_of_another_folder_are_not_missed_by_a_copied_dataset(dataset, check, tmp_path, capsys):
    sign(tmp_path, GaugeRecord(check=check))
    result = Dataset.open(dataset).result(RESULT)
    result.save_findings(result.findings())
    copy = shutil.copytree(dataset, tmp_path / "elsewhere" / "W1.wafer")
    copied = Dataset.open(copy).result(RESULT)
    copied.save_findings(copied.findings())
    main(["check", str(copy)])
    assert GAUGE_LOG not in capsys.readouterr().out
