"""Conformance of a rig at the prompt: passes, planted faults, signed reports, forged ones, and Ctrl-C."""

from __future__ import annotations

import hashlib
import json
import signal
import tomllib

import pytest
import tomli_w

from tests.support.command_line import viewer
from tests.support.paths import ROOT
from wafer_viewer.acquire.conformance.runner import CHECKS
from wafer_viewer.cli.app import main
from wafer_viewer.store.io.checksums import sealed_text

RIGS = ROOT / "assets/rigs"
N = len(CHECKS)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("conformance")


def rig_file(folder, name, **settings):
    path = folder / f"{name}.toml"
    path.write_text(tomli_w.dumps({"kind": "virtual", "name": name, "scene": "plane", **settings}))
    return path


def simulated(folder, name):
    """An example of assets/rigs with all its ports simulated and a sample that is drawn fast."""
    data = tomllib.loads((RIGS / f"{name}.toml").read_text())
    for device in (*data["devices"]["controllers"].values(), data["devices"]["pulse_box"]):
        device["port"] = "simulated"
    data["devices"]["camera"] = {"driver": "virtual", "options": {"scene": "plane"}}
    path = folder / f"{name}.toml"
    path.write_text(tomli_w.dumps(data))
    return path


@pytest.fixture(scope="module")
def report(folder):
    """What the command printed for a rig without faults, and its report."""
    path = folder / "report.html"
    rig = rig_file(folder, "bench")
    words = ("conformance", "--rig", rig, "--move", "-o", path, "--by", "Lab <7>", "--data", folder)
    done = viewer(*words)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout, path


@pytest.mark.slow
def test_a_rig_without_faults_conforms_and_its_report_is_signed(report, folder, capsys):
    printed, path = report
    lines = printed.splitlines()
    assert [line.split()[1].rstrip(":") for line in lines if line.startswith("passed")] == [c.name for c in CHECKS]
    first_move = next(i for i, line in enumerate(lines) if line.startswith("MOVES"))
    assert all("stage" not in c.roles or not c.moves for c in CHECKS[: first_move - 1])
    assert "bench, 20" in printed
    assert f"SIMULATED, {N} passed, 0 failed, 0 not run" in printed
    held = json.loads(path.with_suffix(".json").read_text())["report"]
    assert (held["rig_file"], held["by"], held["simulated"]) == ("bench.toml", "Lab <7>", True)
    assert {one["role"] for one in held["devices"]} == {"stage", "pulse box", "camera"}
    assert 'scene = "plane"' in held["config"]
    slips = next(one for one in held["results"] if one["name"] == "slips")
    assert {"name": "x slips", "value": 0.0, "unit": "1"} in slips["figures"]
    assert {"name": "x distance", "value": 696.0, "unit": "mm"} in slips["figures"]
    page = path.read_text()
    assert "Lab &lt;7&gt;" in page
    assert "SIMULATED" in page
    assert all(check.name in page for check in CHECKS)
    assert main(["conformance", "--verify", str(path), "--data", str(folder)]) == 0
    assert "not altered since it was signed" in capsys.readouterr().out


@pytest.fixture
def copy(report, tmp_path):
    """A copy of the report's two files."""
    _, path = report
    for ending in (".html", ".json"):
        (tmp_path / f"copy{ending}").write_bytes(path.with_suffix(ending).read_bytes())
    return tmp_path / "copy.html"


def verified(path, folder, capsys, *more):
    status = main(["conformance", "--verify", str(path), "--data", str(folder), *more])
    return status, "".join(capsys.readouterr())


def forged(record, change):
    """Change a record and give it a checksum that fits again, as somebody who means it would."""
    content = json.loads(record.read_text())
    content.pop("crc32c")
    change(content)
    record.write_text(sealed_text(json.dumps(content, indent=2)))
    return content


@pytest.mark.slow
def test_a_forged_report_is_refused(copy, folder, capsys):
    record = copy.with_suffix(".json")
    genuine = record.read_text()
    record.write_text(genuine.replace('"bench"', '"other"'))
    assert verified(record, folder, capsys)[0] == 2, "damaged"

    record.write_text(genuine)
    forged(record, lambda content: content["report"]["results"][3].update(verdict="failed"))
    status, words = verified(copy, folder, capsys)
    assert status == 2
    assert "copy.json was altered: its signature does not fit" in words

    record.write_text(genuine)
    page = copy.read_text().replace("Lab &lt;7&gt;", "Lab 8")
    copy.write_text(page)
    status, words = verified(record, folder, capsys)
    assert status == 2
    assert "copy.html was altered" in words
    digest = hashlib.sha256(page.encode()).hexdigest()
    forged(record, lambda content: content.update(page_sha256=digest))
    status, words = verified(copy, folder, capsys)
    assert status == 2
    assert "copy.json was altered" in words


@pytest.mark.slow
def test_a_report_is_held_to_the_key_of_a_lab(copy, folder, tmp_path, capsys):
    status, words = verified(copy, tmp_path / "elsewhere", capsys)
    assert status == 0
    assert "of another data folder" in words
    assert not (tmp_path / "elsewhere").exists()
    key = json.loads(copy.with_suffix(".json").read_text())["signature"]["key"]
    assert key in words
    assert verified(copy, folder, capsys, "--key", key)[0] == 0
    status, words = verified(copy, folder, capsys, "--key", "ab" * 32)
    assert status == 2
    assert f"signed with the key {key}, not with" in words
    assert (folder / ".wafer-viewer" / "conformance-key.pem").stat().st_mode & 0o077 == 0


@pytest.mark.campaign
def test_a_rig_of_two_controllers_homes_and_conforms(folder, capsys):
    status = main(["conformance", "--rig", str(simulated(folder, "grbl_pi")), "--move"])
    printed = capsys.readouterr().out
    assert status == 0, printed
    assert f"{N} passed" in printed
    assert "MOVES     The stage is not homed: z searches its reference" in printed
    assert "controller 'table': GRBL [VER:1.1h" in printed
    assert "controller 'focus': " in printed


def test_without_move_nothing_moves_and_faults_are_named(folder, capsys):
    rig = rig_file(folder, "heartless", faults={"ignores_heartbeat": True})
    assert main(["conformance", "--rig", str(rig)]) == 1
    printed = capsys.readouterr().out
    assert "MOVES" not in printed
    failed = [line for line in printed.splitlines() if line.startswith("failed")]
    assert len(failed) == 1
    assert failed[0].startswith("failed    box_heartbeat: The box ignored the heartbeat")
    assert "not run   slips: It moves the stage: give --move." in printed


def test_ctrl_c_stops_the_stage_and_writes_a_report_of_what_ran(folder, capsys, monkeypatch):
    from wafer_viewer.cli import acquisition

    moving = []

    def interrupt(sentence):
        moving.append(sentence)
        signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(acquisition, "print_motion", interrupt)
    path, rig = folder / "stopped.json", rig_file(folder, "stopped")
    before = signal.getsignal(signal.SIGINT)
    status = main(["conformance", "--rig", str(rig), "--move", "-o", str(path), "--data", str(folder)])
    assert status == 130
    assert signal.getsignal(signal.SIGINT) is before
    assert len(moving) == 3
    assert "not run   slips: Stopped before its end." in capsys.readouterr().out
    assert verified(path, folder, capsys)[0] == 0


@pytest.mark.parametrize(
    ("words", "found"),
    [
        (["-o", "report.pdf"], "give NAME.html or NAME.json"),
        (["--move", "--z-um", "5", "-5"], "is empty: give the lower end first"),
        (["--verify", "nothing.html"], "nothing.json cannot be read"),
    ],
)
def test_what_cannot_be_is_refused_in_one_sentence(words, found, capsys):
    assert main(["conformance", *words]) == 2
    printed = capsys.readouterr()
    assert found in printed.err
    assert printed.err.count("\n") == 1
    assert printed.out == ""
