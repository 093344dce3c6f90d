"""Hints: every input of the page has one, with the limit that its spec checks; buttons say their keys."""

from __future__ import annotations

import re
from dataclasses import MISSING
from pathlib import Path

import pytest

import wafer_viewer.gui
from wafer_viewer.gui.elements.elements import Input
from wafer_viewer.gui.shell.shortcuts import BUTTONS, titles_of
from wafer_viewer.gui.widgets.controls import Command
from wafer_viewer.model.acquisition.plan import FocusSweep
from wafer_viewer.model.errors import PlanError
from wafer_viewer.model.spec import settings_of

FOLDER = Path(wafer_viewer.gui.__file__).parent
INPUT = re.compile(r'add_(?:number|vector2|slider|multi_slider|dropdown|checkbox|text)\(\s*"([^"{]+)"')
BY_SCRIPT = {"picks", "tells"}
"""Inputs that no person sees."""


def test_every_input_is_an_element_whose_hint_says_what_it_is():
    made = {label for path in sorted(FOLDER.rglob("*.py")) for label in INPUT.findall(path.read_text())}
    assert made == BY_SCRIPT
    assert Input.__dataclass_fields__["hint"].default is MISSING


def test_limits_are_those_that_the_specs_check():
    assert settings_of(FocusSweep)["z_step_um"].hint.endswith("; over 0")
    with pytest.raises(PlanError, match="over 0"):
        FocusSweep(z_step_um=0, n_frames=5)


def test_buttons_say_the_key_of_the_verb_they_stand_for():
    commands = [Command("Scan, pause, continue", "G", print), Command("Undo", "Z", print, modifier="cmd/ctrl")]
    assert titles_of(commands) == {"Start scan": "Key G", "Pause": "Key G", "Continue": "Key G", "Undo": "Key Ctrl + Z"}


def test_every_verb_that_a_button_names_is_in_the_palette():
    from tests.gui.shell.test_shortcuts import all_commands

    known = {command.name for command in all_commands()}
    of_panels = {"Next under review", "Accept", "Reject"}
    assert set(BUTTONS.values()) - known <= of_panels
