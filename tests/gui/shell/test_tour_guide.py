"""How far the tour is, told by what the session and the view hold, and what its notes point at."""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path
from typing import Any

import pytest

from tests.browser.sessions import fake_session as fake
from tests.support.datasets.inspections import defect, inspection
from wafer_viewer.draw.number_format import size
from wafer_viewer.gui.shell.tour_guide import N_STEPS, end_card, note_of, present_step, report_of
from wafer_viewer.gui.state.view_state import Tour, View
from wafer_viewer.model.spec import replace
from wafer_viewer.session.planning.guided_tour import TOUR_LOT, is_tour
from wafer_viewer.session.state.inspection_state import InspectionState
from wafer_viewer.session.state.snapshot import Snapshot

TOUR = Tour(since_s=1000.0)


def of_tour(now: Snapshot, **changes: Any) -> Snapshot:
    """The same with the plan of the tour, in its dataset too where there is one."""
    job = replace(fake.a_job(), sample=replace(fake.a_job().sample, lot=TOUR_LOT))
    data = now.dataset and dataclasses.replace(now.dataset, job=job)
    return dataclasses.replace(now, draft=fake.draft_of(job), dataset=data, **changes)


def found(judgement: str = "open") -> InspectionState:
    return InspectionState(inspection=inspection(replace(defect(1, "0,0", 0.0, 0.0), judgement=judgement)))


def scanned(**changes: Any) -> Snapshot:
    return of_tour(fake.measured(), **{"findings": (), **changes})


KEPT = fake.measured().findings


@pytest.mark.parametrize(
    ("now", "step", "number", "button"),
    [
        (of_tour(fake.planned()), "plan", 0, "Start scan"),
        (of_tour(fake.planned()), "gauge", 0, "Plan"),
        (of_tour(fake.scanning()), "acquire", 1, ""),
        (of_tour(fake.unfinished()), "acquire", 1, "Continue the scan"),
        (scanned(), "acquire", 1, "Look at the surface"),
        (scanned(), "surface", 2, "Measure this surface"),
        (scanned(), "measure", 3, ""),
        (scanned(findings=KEPT), "measure", 4, "Review"),
        (scanned(findings=KEPT), "review", 4, "Inspect"),
        (scanned(inspection=InspectionState(work="w1")), "review", 2, "Surface"),
        (scanned(findings=KEPT, inspection=InspectionState(work="w1")), "review", 4, ""),
        (scanned(inspection=found()), "review", 5, "Real defect"),
        (scanned(inspection=found("real")), "review", 6, "Report"),
        (scanned(inspection=InspectionState(inspection=inspection())), "report", 6, "Write report"),
    ],
)
def test_each_step_points_at_a_button_of_the_page_on_show(now: Snapshot, step: Any, number: int, button: str):
    view = View(step=step, tour=TOUR)
    assert present_step(now, view, None) == number
    assert note_of(number, now, view).button == button


def test_a_tool_is_pointed_at_until_it_is_in_use():
    assert note_of(3, scanned(), View(step="measure", tool="profile")).at == "[data-pick=tool][data-k=step]"
    assert note_of(3, scanned(), View(step="measure", tool="step")).button == "Keep result"


def test_a_skipped_step_is_passed_over_and_a_report_ends_the_tour(tmp_path: Path):
    view = View(step="measure", tour=replace_tour(skipped=5))
    assert present_step(scanned(), view, None) == 5
    assert present_step(scanned(), View(tour=replace_tour(skipped=6)), None) == 6
    assert present_step(scanned(), view, tmp_path / "a-report-1.html") == N_STEPS


def replace_tour(**changes: Any) -> Tour:
    return dataclasses.replace(TOUR, **changes)


def test_only_a_report_of_the_tours_dataset_written_since_it_began_counts(tmp_path: Path):
    now = scanned()
    now = dataclasses.replace(now, dataset=dataclasses.replace(now.dataset, path=tmp_path / "a.wafer"))
    assert report_of(now, TOUR) is None
    report = tmp_path / "a-report-1.html"
    report.write_text("")
    os.utime(report, (999.0, 999.0))
    assert report_of(now, TOUR) is None
    os.utime(report, (1001.0, 1001.0))
    assert report_of(now, TOUR) == report
    assert report_of(dataclasses.replace(now, dataset=fake.measured().dataset), TOUR) is None
    assert not is_tour(fake.a_job())


def test_the_last_card_tells_what_was_scanned_measured_found_and_written(tmp_path: Path):
    report = tmp_path / "coupon-07-report-1.html"
    report.write_bytes(b"x" * 480_000)
    now = scanned(findings=KEPT, inspection=found())
    card = end_card(now, replace_tour(ended_s=1129.2), report)
    for words in (
        "9 fields",
        "540 frames in 0:15",
        "11.86 ± 0.31",
        "1 defect<",
        "1 particle",
        size(480_000),
        "2:10 in all",
    ):
        assert words in card
    assert 'href="/reports/coupon-07-report-1.html"' in card
    less = end_card(scanned(), replace_tour(ended_s=1129.2), None)
    assert less.count("skipped") == 3
    assert "Open the report" not in less
