"""What of the long campaigns an ordinary run takes."""

from __future__ import annotations

from dataclasses import dataclass, field
from types import SimpleNamespace

import pytest

from tests.support import campaigns
from tests.support.campaigns import drawn


@dataclass(eq=False)
class Item:
    """A collected test, as far as the draw looks at it."""

    nodeid: str
    campaign: pytest.MarkDecorator | None = None
    words: tuple[str, ...] = field(default=("tests",))

    @property
    def config(self):
        return SimpleNamespace(invocation_params=SimpleNamespace(args=self.words))

    def iter_markers(self, name):
        return iter([self.campaign.mark] if self.campaign else [])

    def get_closest_marker(self, name):
        return next(self.iter_markers(name), None)


def taken(monkeypatch, items, n_draws=200):
    """How often each test is taken by as many draws."""
    monkeypatch.setattr(campaigns, "COMPLETE", False)
    counts = dict.fromkeys((item.nodeid for item in items), 0)
    for commit in range(n_draws):
        monkeypatch.setattr(campaigns, "draw", lambda commit=commit: f"{commit:x}")
        for item in drawn(items):
            counts[item.nodeid] += 1
    return counts


def test_a_tenth_of_the_campaigns_is_drawn_and_all_come_round(monkeypatch):
    items = [Item(f"tests/test_a.py::test_long[{n}]", pytest.mark.campaign) for n in range(40)]
    counts = taken(monkeypatch, [*items, Item("tests/test_a.py::test_short")])
    assert counts.pop("tests/test_a.py::test_short") == 200
    assert min(counts.values()) > 0
    assert sum(counts.values()) == pytest.approx(40 * 200 / 10, rel=0.3)


def test_of_cases_that_stand_for_each_other_one_is_always_taken(monkeypatch):
    items = [Item(f"tests/test_a.py::test_one_kind[{n}]", pytest.mark.campaign(at_least_one=True)) for n in range(4)]
    counts = taken(monkeypatch, items)
    assert sum(counts.values()) >= 200
    assert min(counts.values()) > 20


def test_a_file_whose_tests_share_what_takes_long_is_drawn_as_a_whole(monkeypatch):
    together = pytest.mark.campaign(together=True)
    counts = taken(monkeypatch, [Item(f"tests/test_tour.py::test_{n}", together) for n in range(5)])
    assert len(set(counts.values())) == 1
    assert 0 < counts["tests/test_tour.py::test_0"] < 60


def test_a_test_that_is_named_runs(monkeypatch):
    named = Item("tests/test_a.py::test_long", pytest.mark.campaign, ("tests/test_a.py::test_long",))
    assert taken(monkeypatch, [named], 3) == {named.nodeid: 3}
