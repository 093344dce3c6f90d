"""The table of the campaigns: lines of what passed are renewed, all others stay as they are."""

from __future__ import annotations

import pytest

from tests import campaign_table

HEAD = "# Campaigns\n\n" + "\n".join(campaign_table.HEAD) + "\n"
OLD = "| Old (`tests/test_house.py`) | 2025-01-01 | 12345678 | a machine | 9 | 1.0 |\n"
GONE = "| Gone (`tests/test_gone.py`) | 2025-01-01 | 12345678 | a machine | 9 | 1.0 |\n"
BELOW = "\nText below.\n"


def case(file: str, outcome: str = "") -> str:
    return f'<testcase classname="c" name="n" file="{file}" time="45.0">{outcome}</testcase>'


@pytest.fixture
def page(tmp_path, monkeypatch):
    """Writes results and a table, renews it, and gives status and page."""
    monkeypatch.setattr(campaign_table, "TABLE", table := tmp_path / "campaigns.md")
    monkeypatch.setattr(campaign_table, "commit", lambda: "abcdef01")
    monkeypatch.setattr(campaign_table, "machine", lambda: "a processor, 2 cores")

    def renew(*cases: str):
        table.write_text(HEAD + GONE + OLD + BELOW)
        (tmp_path / "r.xml").write_text(f"<testsuites><testsuite>{''.join(cases)}</testsuite></testsuites>")
        return campaign_table.main([str(tmp_path / "r.xml")]), table.read_text()

    return renew


def test_campaign_that_passed_gets_a_line(page):
    status, text = page(case("tests/test_api.py"), case("tests/test_api.py"), case("tests/test_api.py", "<skipped/>"))
    assert status == 0
    assert text.startswith(HEAD + "| ")
    (new,) = [line for line in text.splitlines() if "`tests/test_api.py`" in line]
    assert new.endswith(" | abcdef01 | a processor, 2 cores | 2, 1 skipped | 2.2 |")
    assert OLD in text
    assert "test_gone" not in text
    assert text.endswith(BELOW)


def test_campaign_that_passed_again_replaces_its_line(page):
    _, text = page(case("tests/test_house.py"))
    assert OLD not in text
    assert text.count("test_house.py") == 1


@pytest.mark.parametrize("outcome", ["<failure/>", "<error/>", "<skipped/>"])
def test_failed_or_skipped_campaign_keeps_its_line(page, outcome):
    status, text = page(case("tests/test_house.py", outcome))
    assert status == 1
    assert text == HEAD + OLD + BELOW
