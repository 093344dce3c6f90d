"""Steps as functions: what they show for a state, without a browser."""

from __future__ import annotations

from concurrent.futures import Future
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest
from markupsafe import Markup

from tests.browser.sessions import fake_session as fake
from tests.support.patience import until
from wafer_viewer.gui.elements.elements import Button, Checkbox, Element, Html, Input, Stack
from wafer_viewer.gui.elements.step import Here
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.steps.measure import MeasureState, measure_step
from wafer_viewer.gui.steps.report import CONTENTS, ReportChoices, chosen_parts, report_step, write
from wafer_viewer.gui.widgets.ask import Ask
from wafer_viewer.model.measurement.tools import TOOLS
from wafer_viewer.model.report import PART_TITLES, PARTS, Holds

HELD = {part: Holds("2 items") for part in PARTS} | {"defects": Holds("no search yet", nothing=True)}


class Papers:
    pictures_kept = 0

    def __init__(self) -> None:
        self.orders, self.paths, self.writing = list[Any](), list[Any](), Future[Any]()

    def contents(self) -> Future[Any]:
        done = Future[Any]()
        done.set_result(HELD)
        return done

    def write_report(self, order: Any, path: Any) -> Future[Any]:
        self.orders.append(order)
        self.paths.append(path)
        return self.writing


class Page:
    """A page as steps know it."""

    def __init__(self, view: View) -> None:
        self.view = view
        self.session: Any = SimpleNamespace(snapshot=fake.measured(), papers=Papers(), measure=None)
        self.session.sections = SimpleNamespace(others=tuple)
        self.answers = Ask(self)

    def redraw(self) -> None:
        pass

    def on_close(self, last: Any) -> None:
        pass

    def tell(self, fault: Any) -> None:
        raise AssertionError(fault)

    say = tell

    def notes(self, snapshot: Any) -> Markup:
        return Markup()

    def ask(self, name: str, verb: Any, then: Any = None) -> None:
        pass

    def change(self, **choices: Any) -> None:
        self.view = replace(self.view, **choices)


def flat(elements: Any) -> list[Element]:
    out = list[Element]()
    for element in elements or ():
        inner = element.elements if isinstance(element, Stack) else getattr(element, "buttons", None)
        out += flat(inner) if inner is not None else [element] if element is not None else []
    return out


def labels(elements: Any) -> list[str]:
    return [element.label for element in flat(elements) if isinstance(element, Input | Button)]


@pytest.fixture
def report() -> Here[ReportChoices]:
    here = Here[ReportChoices](Page(View(step="report")), ReportChoices())  # pyright: ignore[reportArgumentType]
    report_step(here)
    until(lambda: here.ask.known(CONTENTS).value)
    return here


def boxes(here: Here[ReportChoices]) -> dict[str, Checkbox]:
    return {box.label: box for box in flat(report_step(here)) if isinstance(box, Checkbox)}


def test_a_report_has_a_box_for_each_section_and_none_to_tick_for_an_empty_one(report: Here[ReportChoices]):
    shown = boxes(report)
    assert list(shown) == list(PART_TITLES.values())
    assert [name for name, box in shown.items() if box.disabled] == ["Defects"]
    assert not shown["Defects"].value


def test_sections_that_are_deselected_stay_out_of_the_order(report: Here[ReportChoices]):
    boxes(report)["Plan"].put(False)
    boxes(report)["Recipe"].put(False)
    boxes(report)["Plan"].put(True)
    write(report)
    (order,) = report.page.session.papers.orders
    assert set(PARTS) - set(order.parts) == {"defects", "recipe"}


def test_number_customer_and_kind_of_file_are_those_chosen(report: Here[ReportChoices]):
    shown = {element.label: element for element in flat(report_step(report)) if isinstance(element, Input)}
    shown["Number"].put("2026-114")
    shown["Customer"].put("A Fab")
    shown["File"].put(".pdf")
    write(report)
    (order,), (path,) = report.page.session.papers.orders, report.page.session.papers.paths
    assert (order.number, order.customer) == ("2026-114", "A Fab")
    assert path.name == f"{report.snapshot.dataset.path.stem}-report-1.pdf"


@pytest.mark.parametrize("ending", [".xml", ".dfq"])
def test_a_file_for_other_programs_has_no_sections_and_needs_none(report: Here[ReportChoices], ending: str):
    report.keep(ending=ending, left_out=frozenset(PARTS))
    assert boxes(report) == {}
    write(report)
    (path,) = report.page.session.papers.paths
    assert path.name == f"{report.snapshot.dataset.path.stem}-report-1{ending}"


@pytest.mark.parametrize("chosen", ["", "en", "de"])
def test_the_language_is_the_laboratorys_until_another_is_chosen(report: Here[ReportChoices], chosen: str):
    shown = {element.label: element for element in flat(report_step(report)) if isinstance(element, Input)}
    assert shown["Language"].value == ""
    assert chosen in [key for key, _ in shown["Language"].options]
    shown["Language"].put(chosen)
    write(report)
    assert [order.language for order in report.page.session.papers.orders] == [chosen or None]


def test_while_a_report_is_written_no_other_is_begun(report: Here[ReportChoices]):
    write(report)
    write(report)
    assert len(report.page.session.papers.orders) == 1
    buttons = [element for element in flat(report_step(report)) if isinstance(element, Button)]
    assert all(button.disabled for button in buttons)


def test_without_a_section_it_says_why_nothing_can_be_written(report: Here[ReportChoices]):
    report.keep(left_out=frozenset(PARTS))
    assert chosen_parts(report) == ()
    assert any("no section is selected" in str(e.content) for e in flat(report_step(report)) if isinstance(e, Html))


def test_a_step_that_is_not_looked_at_has_no_elements():
    away: Any = Page(View(step="surface"))
    assert report_step(Here(away, ReportChoices())) is None
    assert measure_step(Here(away, MeasureState(curves=SimpleNamespace(), first_levelling=Any))) is None  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize("tool", [tool.name for tool in TOOLS.values() if tool.controls])
def test_each_option_of_a_tool_has_an_input_that_changes_it(tool: str):
    page: Any = Page(View(step="measure", tool=tool))
    curves: Any = SimpleNamespace(answer=SimpleNamespace(value=None, problem=""), sections=(), gap=None)
    here = Here(page, MeasureState(curves, first_levelling=Any))  # pyright: ignore[reportArgumentType]
    before = page.view
    for control in TOOLS[tool].controls:
        here.view = page.view = before
        shown = {e.label: e for e in flat(measure_step(here)) if isinstance(e, Input)}
        options = getattr(shown[control.label], "options", None)
        wanted = options[-1] if options else 3.5
        shown[control.label].put(wanted)
        here.view = page.view
        shown = {e.label: e for e in flat(measure_step(here)) if isinstance(e, Input)}
        assert shown[control.label].value == wanted
