"""People and releases at the prompt: add, list, remove; who is refused gets one sentence with the rule."""

from __future__ import annotations

import pytest

from tests.support.datasets.judged_datasets import released_job
from wafer_viewer.cli.app import main
from wafer_viewer.model.spec import encode, replace
from wafer_viewer.session.core.people import NEW_PASSWORD_VARIABLE, PASSWORD_VARIABLE
from wafer_viewer.store.records.signed_log import recorded_actions

pytestmark = pytest.mark.usefixtures("quick_passwords")
ANN, OLGA = "ann's long password", "olga's long password"


@pytest.fixture
def prompt(tmp_path, capsys, monkeypatch):
    """Run a command with passwords; returns the status and what it printed."""

    def run(*words: object, password: str | None = None, new: str | None = None):
        for name, value in ((PASSWORD_VARIABLE, password), (NEW_PASSWORD_VARIABLE, new)):
            monkeypatch.setenv(name, value) if value else monkeypatch.delenv(name, raising=False)
        status = main([str(word) for word in words])
        printed = capsys.readouterr()
        return status, (printed.out + printed.err).strip()

    return run


@pytest.fixture
def station(prompt, tmp_path):
    here = ("--data", tmp_path)
    assert prompt("people", "add", "Ann", "--role", "engineer", *here, new=ANN) == (
        0,
        "Ann may sign in as engineer.",
    )
    words = ("people", "add", "Olga", "--role", "operator", *here)
    assert prompt(*words, "--by", "Ann", "--reason", "new here", password=ANN, new=OLGA)[0] == 0
    return tmp_path


def test_people_are_listed_by_an_engineer_and_it_is_recorded(prompt, station):
    here = ("--data", station)
    assert prompt("people", "list", *here) == (0, "Ann: engineer\nOlga: operator")
    status, told = prompt("people", "add", "Bob", "--role", "engineer", *here, new="bob's long password")
    assert (status, told) == (
        2,
        f"wafer-viewer: People are listed in {station}: name an engineer with --by NAME.",
    )
    status, told = prompt("people", "remove", "Ann", *here, "--by", "Olga", "--reason", "x", password=OLGA)
    assert status == 2
    assert told.endswith("Only an engineer changes the list of people: Ann. Olga is signed in as operator.")
    assert prompt("people", "remove", "Olga", *here, "--by", "Ann", password=ANN)[1].endswith(
        "say why with --reason TEXT."
    )
    assert prompt("people", "remove", "Olga", *here, "--by", "Ann", "--reason", "left", password=ANN)[0] == 0
    entries = [(entry.action, entry.subject, entry.detail) for entry in recorded_actions(station)]
    assert entries == [
        ("Person added", "Ann", "role: engineer"),
        ("Person added", "Olga", "role: operator, why: new here"),
        ("Person removed", "Olga", "why: left"),
    ]
    assert [entry.by for entry in recorded_actions(station)][1:] == ["Ann", "Ann"]


def test_nobody_is_listed_at_first(prompt, tmp_path):
    status, told = prompt("people", "list", "--data", tmp_path)
    assert (status, told) == (1, "Nobody is listed: everyone at the station is an engineer.")
    status, told = prompt("people", "add", "Olga", "--role", "operator", "--data", tmp_path, new=OLGA)
    assert status == 2
    assert "Somebody must be an engineer" in told
    status, told = prompt("people", "add", "Olga", "--role", "operator", "--data", tmp_path)
    assert NEW_PASSWORD_VARIABLE in told


def test_a_job_is_released_by_an_engineer_with_a_reason(prompt, station, tmp_path):
    plan = tmp_path / "coupon.toml"
    plan.write_text(encode(replace(released_job(), revision="B")))
    words = ("release", plan, "--data", station)
    for flags, password, told in (
        ((), None, "name an engineer with --by NAME."),
        (("--by", "Ann"), OLGA, "The name or the password is wrong."),
        (("--by", "Ann"), None, f"give it in {PASSWORD_VARIABLE}."),
        (("--by", "Ann"), ANN, "This needs a reason: say why with --reason TEXT."),
        (
            ("--by", "Olga", "--reason", "mine"),
            OLGA,
            "Only an engineer releases jobs: Ann. Olga is signed in as operator.",
        ),
    ):
        status, answer = prompt(*words, *flags, password=password)
        assert status == 2
        assert answer.endswith(told)
        assert not (station / "jobs").exists()
    assert prompt(*words, "--by", "Ann", "--reason", "order 12", password=ANN)[0] == 0
    entry = recorded_actions(station)[-1]
    assert (entry.by, entry.subject, entry.detail) == ("Ann", "coupon-B.toml", "why: order 12")
    assert entry.sha256


def test_an_operator_scans_released_jobs_only(prompt, station, tmp_path):
    plan = tmp_path / "plan.toml"
    plan.write_text(encode(released_job()))
    words = ("scan", plan, "-o", station / "w1.wafer", "--wafer", "W1")
    assert prompt(*words)[1].endswith("name somebody who is listed with --operator NAME.")
    status, told = prompt(*words, "--operator", "Olga", password=OLGA)
    assert status == 2
    assert "was not released in" in told
    assert told.endswith("Operators run released jobs only: have an engineer release it. Olga is listed as operator.")
    assert not (station / "w1.wafer").exists()
