"""What Gauge check says and shows: points, verdicts, refusals, the run chart, studies; where its faces lie."""

from __future__ import annotations

import dataclasses
import datetime
import re

import pytest

from tests.browser.sessions.gauge_blocks import certificate
from tests.browser.sessions.gauge_session import TERMS, a_study, checked, worked_out
from tests.browser.sessions.measuring_session import MeasuringSession
from wafer_viewer.draw.charts.die_map import site_map_svg
from wafer_viewer.draw.charts.run_chart import MOST_POINTS, run_chart_html
from wafer_viewer.gui.presenters import gauge as unsure
from wafer_viewer.gui.presenters import gauge as words
from wafer_viewer.gui.presenters.measurement import sites
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.steps.gauge.gauge_check import below, earlier, next_point, points, procedure
from wafer_viewer.gui.steps.gauge.gauge_study import study
from wafer_viewer.gui.tools.region_tools import default_faces, in_scene
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.gauge import RunChart
from wafer_viewer.model.measurement.tool_options import SiteRangeOptions
from wafer_viewer.model.measurement.tools import ToolOptions
from wafer_viewer.model.region import Region
from wafer_viewer.session.gauge.repeat_scans import Studies
from wafer_viewer.session.state.inspection_state import GaugeState, Tick
from wafer_viewer.session.state.snapshot import Snapshot

TODAY = datetime.date(2026, 11, 21)


@pytest.fixture(scope="module")
def state() -> GaugeState:
    return worked_out(checked())


@pytest.mark.slow
def test_the_verdict_stands_with_error_limit_and_en(state: GaugeState):
    assert state.check is not None
    card = words.verdict_card(state.check)
    for part in ("PASS", "SIMULATED", "+0.10", "limit ± 0.50", "<sub>n</sub>"):
        assert part in card
    table = words.result(state.check)
    for part in ("Certificate at 20.4", "399.88", "Measured, mean of 3", "Error"):
        assert part in table
    failed = worked_out(checked(off_um=1.4)).check
    assert failed is not None
    assert "FAIL" in words.verdict_card(failed)


def test_every_line_of_the_budget_is_told_with_what_is_left_out(state: GaugeState):
    assert state.check is not None
    text = unsure.budget(state.check)
    for line in state.check.budget:
        assert line.name[1:] in text
    for item in state.check.not_evaluated:
        assert item in unsure.not_evaluated(state.check)


def test_a_certificate_is_shown_missed_and_warned_of_before_it_runs_out():
    assert "21-0447 / 21-0448" in words.certificate(certificate(), TODAY)
    assert "No certificate is loaded." in words.certificate(None, TODAY)
    assert "It expires in 3 days" in words.certificate(certificate("2026-11-24"), TODAY)


def test_points_are_ticked_in_their_order():
    now = Snapshot()
    assert [point.done for point in points(now)] == [False] * 5
    ticked = dataclasses.replace(now, gauge=GaugeState(ticks=(Tick("clean", "2026-11-21T09:12:00+00:00"),)))
    following = next_point(ticked)
    assert following is not None
    assert following.name == "warm"
    assert "Clean the blocks, wring them, done" in procedure(ticked)


@pytest.mark.slow
def test_the_chart_has_every_check_with_its_look_and_names_its_lines(state: GaugeState):
    assert state.chart is not None
    drawn = run_chart_html(state.chart)
    assert drawn.count('<u class="wv-dot') == len(state.chart.points) == 29
    assert drawn.count('<u class="wv-dot fail') == 1
    for name in ("certificate", "limit"):
        assert f">{name}</b>" in drawn
    many = dataclasses.replace(state, records=tuple(checked(n_earlier=40).records))
    chart = worked_out(many).chart
    assert chart is not None
    assert run_chart_html(chart).count('<u class="wv-dot') == MOST_POINTS
    assert f"Last {MOST_POINTS} of 40 checks" in below(chart, "21-0447", "")


def test_a_chart_without_a_check_says_what_will_be_there():
    assert "drawn here" in below(None, "", "")
    with pytest.raises(MeasureError, match="has no point"):
        run_chart_html(RunChart(points=(), mean_um=0.0))


def test_earlier_checks_stand_newest_first(state: GaugeState):
    listed = earlier(state.records, state.records[-1].check.at)
    assert re.findall(r"data-k=\"([^\"]+)\"", listed)[0] == state.records[-1].check.at
    assert 'class="go sel"' in listed


def test_the_scene_has_the_faces_as_a_steps_places_in_true_shape():
    faces = Region.rectangle(0, 0, 10, 10), Region.rectangle(20, 0, 30, 10)
    shown = in_scene(View(step="gauge", faces=faces, exaggeration=5.0))
    assert (shown.tool, shown.places, shown.exaggeration) == ("step", faces, 1.0)
    assert in_scene(View(step="gauge", faces=faces, check="x")).tool == "none"
    other = View(step="measure", exaggeration=5.0)
    assert in_scene(other) is other


def test_faces_laid_by_hand_lie_side_by_side_on_the_surface():
    session = MeasuringSession()
    info = session.snapshot.surface
    session.close()
    assert info is not None
    upper, lower = default_faces(info)
    assert lower.bounds_um[2] < upper.bounds_um[0]
    assert info.x0_um < lower.bounds_um[0]
    assert upper.bounds_um[2] < info.x0_um + info.cols * info.pixel_um


def test_a_study_is_told_with_what_was_studied(tmp_path):
    path = tmp_path / "study.csv"
    path.write_text(a_study())
    (made,) = Studies().gauge_rr(path)
    text = study(made)
    for part in ("<b>10</b> parts", "<b>3</b> appraisers", "<b>3</b> trials", "Acceptable", "Distinct categories"):
        assert part in text
    assert "of it parts with appraisers, INT" in text
    assert "p of parts with appraisers" in text
    assert "INT" not in study(Studies().gauge_rr(path, "range")[0])


def test_sites_are_coloured_by_their_range_and_never_called_sfqr():
    session = MeasuringSession()
    options = ToolOptions(site_range=SiteRangeOptions(width_um=60, height_um=40))
    result = session.measure("site_range", (Region.rectangle(-120, -80, 120, 80),), 0, None, options)
    session.close()
    assert (result.cols, result.rows, len(result.outlines)) == (4, 4, 16)
    drawn = site_map_svg(result)
    assert drawn.count("<rect") == 16
    text = sites(result)
    assert "SFQR" not in text
    assert "the largest 12 of 16" in text


def test_terms_that_cannot_be_are_refused():
    with pytest.raises(MeasureError, match="temperature_c"):
        type(TERMS)(temperature_c=80.0)
