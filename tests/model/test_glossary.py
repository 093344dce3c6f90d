"""One word for one concept: the glossary, and the texts of the program held to it."""

from __future__ import annotations

from pathlib import Path

import pytest

from wafer_viewer.__main__ import main
from wafer_viewer.model.glossary import GLOSSARY, find_terms, glossary_markdown

ROOT = Path(__file__).parent.parent.parent
PACKAGE = ROOT / "wafer_viewer"


def test_the_documentation_lists_the_glossary_of_the_program():
    assert (ROOT / "assets/docs/reference/glossary.md").read_text() == glossary_markdown()


def test_a_term_is_listed_once_and_never_as_a_word_to_avoid():
    words = [term.word for term in GLOSSARY]
    assert len(set(words)) == len(words)
    assert not {avoided for term in GLOSSARY for avoided in term.not_called} & set(words)


def test_a_term_is_found_by_a_word_that_is_not_used_for_it():
    assert [term.word for term in find_terms("unsmoothed")] == ["measured heights"]


def test_the_command_prints_a_term_and_names_an_unknown_one(capsys: pytest.CaptureFixture[str]):
    assert main(["glossary", "guard"]) == 0
    assert "value ± U must lie within the limits" in capsys.readouterr().out
    assert main(["glossary", "flummox"]) == 1
    assert "flummox" in capsys.readouterr().err
