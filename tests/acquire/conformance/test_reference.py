"""The reference of the checks is the table of the checks."""

from __future__ import annotations

import re

from tests.support.paths import ROOT
from wafer_viewer.acquire.conformance.runner import CHECKS

PAGE = ROOT / "assets/docs/reference/conformance-checks.md"
ROW = re.compile(r"^\| `(\w+)` \| (yes|–) \| (.+) \|$", re.MULTILINE)


def test_the_reference_lists_every_check_with_its_demand():
    subjects = ("pulse box", "stage", "camera", "together")
    wanted = [
        (check.name, "yes" if check.moves else "–", check.demand)
        for subject in subjects
        for check in CHECKS
        if check.subject == subject
    ]
    assert len(wanted) == len(CHECKS)
    assert ROW.findall(PAGE.read_text()) == wanted


def test_a_check_has_a_name_of_its_own_and_comes_after_what_it_needs():
    names = [check.name for check in CHECKS]
    assert len(set(names)) == len(names)
    moving = [check.moves for check in CHECKS]
    assert moving == sorted(moving)
    assert names[moving.index(True)] == "stage_homed"
    assert names[0] == "box_refuses_without_reference"
