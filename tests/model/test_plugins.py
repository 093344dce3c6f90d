"""Plug-ins are found by their entry points; one that cannot be used is named and left out."""

from __future__ import annotations

import pytest

from tests.support.plugin_packages import write_package
from wafer_viewer.model.plugins import PluginWarning, plugins


@pytest.fixture
def installed(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(tmp_path))
    return lambda name, source, line: write_package(tmp_path, name, source, {"measuring_tools": line})


def test_what_a_package_names_is_returned(installed):
    installed("brings_seven", "SEVEN = 7\n", "seven = brings_seven:SEVEN")
    assert plugins("measuring_tools", int) == [7]


def test_one_that_fails_is_named_with_its_package_and_left_out(installed):
    installed("brings_trouble", "raise RuntimeError('no licence')\n", "trouble = brings_trouble:TOOL")
    with pytest.warns(PluginWarning, match=r"brings_trouble cannot be loaded \(no licence\): update or remove"):
        assert plugins("measuring_tools", int) == []


def test_one_of_another_kind_is_named(installed):
    installed("brings_text", "TOOL = 'seven'\n", "text = brings_text:TOOL")
    with pytest.warns(PluginWarning, match="is no int"):
        assert plugins("measuring_tools", int) == []
