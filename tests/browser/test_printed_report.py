"""Report as it is printed: words of tables stay whole, and no table is wider than the paper."""

from __future__ import annotations

from pathlib import Path

import pytest
from playwright.sync_api import Browser

from tests.support.datasets.judged_datasets import judged_dataset, released_job
from wafer_viewer.cli.app import main

pytestmark = pytest.mark.browser

PAPER = {"width": 680, "height": 960}
"""A4 less its margins, in CSS pixels."""
REASON = "Complaint about the height of the bumps in the north-west corner; the frames are needed until it is answered."
LETTER = f"Filed under {'ABCDEFGHIJKLMNOPQRSTUVWXYZ' * 4}"
BROKEN_WORDS = """() => {
    const broken = []
    for (const cell of document.querySelectorAll('td, th')) {
        const walker = document.createTreeWalker(cell, NodeFilter.SHOW_TEXT)
        for (let node = walker.nextNode(); node; node = walker.nextNode())
            for (const word of node.data.matchAll(/\\S+/g)) {
                const range = document.createRange()
                range.setStart(node, word.index)
                range.setEnd(node, word.index + word[0].length)
                if (range.getClientRects().length > 1) broken.push(word[0])
            }
    }
    return broken
}"""


def test_a_pdf_is_printed_and_the_same_dataset_makes_the_same_bytes(browser: Browser, tmp_path: Path) -> None:
    judged_dataset(tmp_path / "one.wafer", 12.0, released_job(), wafer="W1")
    first, second, letter = (tmp_path / name for name in ("a.pdf", "b.pdf", "c.pdf"))
    for path, words in ((first, ()), (second, ()), (letter, ("--paper", "letter"))):
        assert main(["report", str(tmp_path / "one.wafer"), "-o", str(path), *words]) == 0
    assert first.read_bytes() == second.read_bytes()
    assert b"/MediaBox [0 0 594.95996 841.91998]" in first.read_bytes()
    assert b"/MediaBox [0 0 612 792]" in letter.read_bytes()


def test_words_of_tables_are_printed_whole(browser: Browser, tmp_path: Path) -> None:
    judged_dataset(tmp_path / "one.wafer", 12.0, released_job(), wafer="W1")
    dataset, report = str(tmp_path / "one.wafer"), tmp_path / "report.html"
    assert main(["hold", dataset, "--reason", REASON]) == 0
    assert main(["unhold", dataset, "--reason", LETTER]) == 0
    assert main(["report", dataset, "-o", str(report)]) == 0
    page = browser.new_page(viewport=PAPER)
    try:
        page.emulate_media(media="print")
        page.goto(report.as_uri())
        broken = page.evaluate(BROKEN_WORDS)
        assert "ABCDEFGHIJKLMNOPQRSTUVWXYZ" in "".join(broken), "the long word has to be broken"
        assert [word for word in broken if len(word) <= 24] == []
        assert page.evaluate("document.documentElement.scrollWidth") <= PAPER["width"]
    finally:
        page.close()
