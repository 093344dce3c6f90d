"""The parts of the page that belong to profiles, without a browser: what is measured when, and what verbs do."""

from __future__ import annotations

import threading
from types import SimpleNamespace

import pytest

from tests.support.made_up_sections import hill, section_of
from wafer_viewer.gui.measure.live_measurement import LiveProfiles
from wafer_viewer.gui.measure.profile_dock import CursorMove, parse_cursor_event, parse_drag
from wafer_viewer.gui.presenters.measurement import head
from wafer_viewer.gui.state.view_state import PlotView, View, changed, with_cursor
from wafer_viewer.gui.steps.profiles import LineCommands
from wafer_viewer.gui.tools.profile_lines import nearest_share
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.measurement.sections import (
    Gap,
    OtherSurface,
    Section,
    column_line,
    perpendicular_line,
    row_line,
)
from wafer_viewer.model.region import Region

LATTICE = SimpleNamespace(pixel_um=0.5, x0_um=-100.0, y0_um=50.0, shape=(200, 400))
LINES = (Region.line(-50, 0, 50, 0, 2.0), Region.line(0, -20, 0, 20))
OTHER = OtherSurface("/data/after.wafer", "default")
SNAPSHOT = SimpleNamespace(
    surface=SimpleNamespace(result="default", stamp=1), dataset=SimpleNamespace(path="x", stamps={})
)


class Sections:
    """Remembers what it was asked; another surface has no heights there."""

    def __init__(self) -> None:
        self.asked = []

    def section(self, asked):
        self.asked.append(asked)
        if asked.of is not None:
            raise MeasureError("after has no heights along line A.")
        return Section(asked, section_of(hill(100)).profile, section_of(hill(100)).curve, "coupon")


class Page:
    """A view, a session with one surface, and a camera that looks at a place."""

    def __init__(self, view: View, look_at_mm=(0.01, 0.02, 0.0)) -> None:
        self.view = view
        self.client = SimpleNamespace(camera=SimpleNamespace(look_at=look_at_mm))
        self.session = SimpleNamespace(snapshot=SNAPSHOT, sections=Sections(), surface_source=lambda show: LATTICE)
        self.drawn = threading.Semaphore(0)
        self.closing = []

    def change(self, **choices):
        self.view = changed(self.view, **choices)

    def redraw(self):
        self.drawn.release()

    def on_close(self, last):
        self.closing.append(last)


@pytest.fixture
def page():
    made = Page(View(step="measure", tool="profile", lines=LINES))
    yield made
    for last in made.closing:
        last()


def measured(page, curves, snapshot=SNAPSHOT):
    """What is asked of the session when the page is drawn now."""
    before = len(page.session.sections.asked)
    curves.show(snapshot, page.view)
    assert page.drawn.acquire(timeout=10)
    return page.session.sections.asked[before:]


def test_only_the_line_that_moved_is_measured_again(page):
    curves = LiveProfiles(page)
    assert [a.place for a in measured(page, curves)] == [0, 1]
    page.change(lines=(LINES[0], Region.line(0, -20, 5, 20)), line=1)
    assert [a.place for a in measured(page, curves)] == [1]
    assert [s.asked.place for s in curves.sections] == [0, 1]
    again = SimpleNamespace(**{**vars(SNAPSHOT), "surface": SimpleNamespace(result="default", stamp=2)})
    assert len(measured(page, curves, again)) == 2


def test_a_moved_handle_has_its_curve_before_the_line_is_drawn(page):
    curves, text = LiveProfiles(page), []
    curves.on_change(lambda: text.append(len(curves.sections)))
    curves.follow()
    assert text == [2]


def test_the_active_line_alone_is_compared(page):
    curves = LiveProfiles(page)
    measured(page, curves)
    page.change(plot=PlotView(cleaned=True))
    assert [(a.place, a.cleaned) for a in measured(page, curves)] == [(0, True)]
    assert curves.active is not None
    assert not curves.active.asked.is_second
    page.change(line=1)
    assert [(a.place, a.cleaned) for a in measured(page, curves)] == [(1, True)]


def test_where_another_surface_has_no_heights_the_page_says_so(page):
    page.change(plot=PlotView(of=OTHER))
    curves = LiveProfiles(page)
    measured(page, curves)
    assert curves.problems == ("after has no heights along line A.",)
    assert curves.answer.value is not None
    html = head(curves.sections, curves.problems, 2, 0, None, zoomed=False)
    assert "after has no heights along line A." in html


def test_nothing_is_measured_while_no_profile_is_looked_at(page):
    curves = LiveProfiles(page)
    for away in ({"tool": "step"}, {"tool": "profile", "step": "surface"}):
        page.change(**away)
        curves.show(SNAPSHOT, page.view)
    page.change(step="measure")
    measured(page, curves)
    assert len(page.session.sections.asked) == 2


def test_a_cut_goes_through_what_is_looked_at_and_keeps_the_width(page):
    verbs = LineCommands(page)
    verbs.cut("row")
    assert page.view.lines == (row_line(LATTICE, 60, 2.0), LINES[1])
    page.change(line=1)
    verbs.cut("column")
    assert page.view.lines[1] == column_line(LATTICE, 220)


def test_a_cut_beside_the_surface_goes_through_the_middle_of_the_line():
    page = Page(View(step="measure", tool="profile", lines=LINES), look_at_mm=(9.0, 9.0, 0.0))
    LineCommands(page).cut("row")
    assert page.view.lines[0] == row_line(LATTICE, 100, 2.0)


def test_a_line_gets_corners_and_becomes_straight_again(page):
    verbs = LineCommands(page)
    verbs.add_corner()
    assert page.view.lines == (Region.polyline((-50, 0), (0, 0), (50, 0), width_um=2.0), LINES[1])
    page.change(lines=(Region.polyline((-50, 0), (0, 40), (50, 0), width_um=2.0), LINES[1]))
    verbs.add_corner()
    assert [(p.x_um, p.y_um) for p in page.view.lines[0].points] == [(-50, 0), (-25, 20), (0, 40), (50, 0)]
    verbs.remove_corner()
    assert [(p.x_um, p.y_um) for p in page.view.lines[0].points] == [(-50, 0), (0, 40), (50, 0)]
    verbs.remove_corner()
    verbs.remove_corner()
    assert page.view.lines == LINES


def test_a_path_with_corners_is_no_slab_and_may_be_crossed(page):
    bent = Region.polyline((-50, 0), (0, 40), (50, 0))
    page.change(lines=(bent, LINES[1]), look="points", before="hide")
    assert page.view.clipped.slab is None
    asked = measured(page, LiveProfiles(page))
    assert [request.slab for request in asked] == [False, True]
    page.change(lines=(bent,))
    LineCommands(page).add()
    assert page.view.lines == (bent, perpendicular_line(Region.line(-50, 0, 50, 0), LATTICE))


def test_the_nearest_place_of_a_path_is_a_share_of_its_arc_length():
    path = Region.polyline((0, 0), (30, 0), (30, 10))
    assert nearest_share(path, (15, 3)) == pytest.approx((15 / 40, 3.0))
    assert nearest_share(path, (33, 5)) == pytest.approx((35 / 40, 3.0))
    assert nearest_share(path, (30, 99)) == pytest.approx((1.0, 89.0))


def test_lines_are_added_up_to_four_and_the_last_one_stays(page):
    verbs = LineCommands(page)
    for _ in range(5):
        verbs.add()
    assert len(set(page.view.lines)) == 4
    assert page.view.line == 3
    verbs.next()
    assert page.view.line == 0
    for _ in range(5):
        verbs.remove()
    assert len(page.view.lines) == 1
    assert page.view.active_line is not None


def test_what_is_typed_and_told_stays_on_the_line_and_on_the_plot():
    plot = with_cursor(with_cursor(PlotView(), 0, -0.2), 1, 1.7)
    assert plot.cursors == (0.0, 1.0)
    assert with_cursor(plot, 1, 0.4).cursors == (0.0, 0.4)
    assert parse_drag("-0.1:1.4") == (0.0, 1.0)
    assert parse_cursor_event("1:23.5::") == CursorMove(1, 23.5, by_key=False, released=False)
    assert parse_cursor_event("0:4:key:end") == CursorMove(0, 4.0, by_key=True, released=True)


def test_the_head_names_every_line_and_reads_the_cursors():
    sections = [section_of(hill()), section_of(hill(), 1), section_of(hill(), 1, cleaned=True)]
    html = head(sections, (), 3, 1, Gap((0.0, 412.6), 412.6, 33.91), zoomed=True)
    assert [html.count(f'aria-label="Line {letter}"') for letter in "ABCD"] == [1, 1, 1, 0]
    assert html.count('aria-pressed="true"') == 1
    for text in ("412.6", "+33.91", "4.70", "filled heights", "Whole line"):
        assert text in html
