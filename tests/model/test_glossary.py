"""One word for one concept: the glossary, and the texts of the program held to it."""

from __future__ import annotations

import pytest

from tests.support.parsed_modules import MODULES, parsed
from tests.support.paths import ROOT
from wafer_viewer.cli.app import main
from wafer_viewer.model.glossary import GLOSSARY, find_terms, glossary_markdown

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


@pytest.mark.slow
def test_no_text_of_the_program_uses_a_word_that_the_glossary_replaces():
    avoided = {word: term.word for term in GLOSSARY for word in term.not_called}
    assert len(avoided) > 5
    wrong = [
        f"{module.relative_to(PACKAGE)}: '{text}' (say {avoided[word]})"
        for module in MODULES
        if module.name != "glossary.py"
        for text in parsed(module).strings
        for lowered in [text.lower()]
        for word in avoided
        if word in lowered
    ]
    assert wrong == []
