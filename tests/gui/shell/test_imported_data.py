"""Data taken elsewhere: the sample on the rig's stage is another, and nothing of the page lays one over the other."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from tests.browser.sessions import fake_session as fake
from tests.gui.steps.test_steps import flat
from wafer_viewer.gui.scenes.scene_view import acquire_contents
from wafer_viewer.gui.shell.header import _state as header_state
from wafer_viewer.gui.shell.left_panel import FIELD_PICKS, MapState, field_map
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.session.state.snapshot import Snapshot

DIES = (((-1000.0, -1000.0), (0.0, -1000.0), (0.0, 0.0), (-1000.0, 0.0)),)


def snapshot(*, imported: bool) -> Snapshot:
    measured = fake.measured()
    overview = replace(fake.an_overview(), dies_um=DIES)
    data = replace(measured.dataset, imported=imported, simulated=not imported)
    return replace(measured, dataset=data, overview=overview)


def map_of(shown: Snapshot, step: Any) -> str:
    page = SimpleNamespace(statistics=None)
    here: Any = SimpleNamespace(snapshot=shown, view=View(step=step), page=page, own=MapState())
    return "".join(element.content for element in flat(field_map(here)))


def outline_of(svg: str) -> int:
    return svg.count("<polygon") + svg.count("<path")


def test_the_map_of_imported_data_shows_neither_the_sample_on_the_stage_nor_its_dies():
    own, foreign = (map_of(snapshot(imported=imported), "surface") for imported in (False, True))
    nothing_else = map_of(replace(snapshot(imported=True), overview=None), "surface")
    assert foreign == nothing_else
    assert outline_of(own) > outline_of(foreign)


def test_the_map_of_the_plan_shows_the_sample_on_the_stage_whatever_is_open():
    assert map_of(snapshot(imported=True), "plan") == map_of(snapshot(imported=False), "plan")


def test_real_data_lie_on_no_virtual_wafer_either():
    shown = snapshot(imported=False)
    real = replace(shown, dataset=replace(shown.dataset, simulated=False))
    assert real.rig.simulated
    assert real.dataset_overview is None


def test_a_surface_file_is_drawn_by_its_own_extent():
    shown = snapshot(imported=True)
    of_file = replace(shown, dataset=replace(shown.dataset, fields=(), states={}, stamps={}))
    assert "<svg" in map_of(of_file, "surface")
    assert "<svg" not in map_of(replace(of_file, surface=None), "surface")


@pytest.mark.parametrize("fields", [True, False])
def test_the_first_picture_of_the_scene_holds_no_sample(fields: bool):
    shown = snapshot(imported=True)
    data = replace(shown.dataset, stamps={}, **({} if fields else {"fields": (), "states": {}}))
    waiting = replace(shown, dataset=data, surface=None)
    book: Any = SimpleNamespace(available_facts=lambda _: {})
    contents = acquire_contents(book, waiting, View(step="surface"), None)
    assert not [item for item in contents.items if item.name.startswith(("sample/", "stage"))]
    own = replace(waiting, dataset=replace(fake.measured().dataset, stamps={}))
    assert [item for item in acquire_contents(book, own, View(step="surface"), None).items if "sample/" in item.name]


def test_the_header_says_imported_over_imported_data_and_the_rig_where_it_can_move():
    shown = snapshot(imported=True)
    assert "Imported" in header_state(shown, View(step="surface"))
    assert "SIMULATED" not in header_state(shown, View(step="surface"))
    for step in ("plan", "acquire"):
        assert "SIMULATED" in header_state(shown, View(step=step))
    for state in ("moving", "scanning", "fault"):
        busy = replace(shown, rig=replace(shown.rig, state=state))
        assert "SIMULATED" in header_state(busy, View(step="surface"))
    simulated = replace(shown, dataset=replace(shown.dataset, simulated=True))
    assert "SIMULATED" in header_state(simulated, View(step="surface"))
    assert "SIMULATED" in header_state(snapshot(imported=False), View(step="surface"))


def test_the_header_shows_no_position_of_a_rig_that_did_not_take_the_data():
    assert "X&nbsp;" in header_state(snapshot(imported=False), View(step="surface"))
    assert "X&nbsp;" not in header_state(snapshot(imported=True), View(step="surface"))
    assert "X&nbsp;" in header_state(snapshot(imported=True), View(step="plan"))


class _Page:
    """As much of a page as a click on the map asks for."""

    def __init__(self, shown: Snapshot, step: Any) -> None:
        self.view, self.moves = View(step=step), []
        self.session = SimpleNamespace(snapshot=shown, move_to=lambda **place: self.moves.append(place))
        self.gui = SimpleNamespace(add_modal=lambda title: self.moves.append(title))

    def ask(self, failed: str, future: Any) -> None: ...

    def change(self, **choices: Any) -> None:
        self.view = replace(self.view, **choices)


def clicked(shown: Snapshot, step: str, what: str, key: str, own: MapState = MapState()) -> list[Any]:
    page: Any = _Page(shown, step)
    FIELD_PICKS[what](SimpleNamespace(page=page, own=own), key)  # type: ignore[arg-type]
    return [*page.moves, page.view.show] if step == "surface" else page.moves


def test_a_click_on_a_field_of_the_surface_shows_that_field_and_elsewhere_flies_there():
    flown: list[Any] = []
    assert clicked(fake.measured(), "surface", "field", "3") == [3]
    scene = MapState(lambda: ((0.0, 0.0), (200.0, 100.0)), flown.append)
    assert clicked(fake.measured(), "surface", "place", "5000,-2000", scene) == [0]
    assert flown == [(4900.0, -2050.0, 5100.0, -1950.0)]


def test_the_map_is_drawn_anew_only_if_its_content_has_changed():
    shown, page = fake.measured(), SimpleNamespace(statistics=None)
    here: Any = SimpleNamespace(snapshot=shown, view=View(step="surface"), page=page, own=MapState())
    field_map(here)
    drawn = here.own.drawing
    here.snapshot = replace(shown, rig=replace(shown.rig, x_um=77.0))
    field_map(here)
    assert here.own.drawing is drawn
    here.view = View(step="surface", show=2)
    field_map(here)
    assert here.own.drawing is not drawn


def test_a_click_on_the_map_moves_the_stage_to_fields_of_this_rig_alone():
    for step, imported, moves in (("acquire", False, 1), ("acquire", True, 0), ("plan", True, 1)):
        shown = replace(snapshot(imported=imported), scan=None)
        number = (shown.draft.plan if step == "plan" else shown.dataset).fields[0].number
        assert len(clicked(shown, step, "field", str(number))) == moves, (step, imported)
    assert clicked(replace(snapshot(imported=True), scan=None), "acquire", "place", "90000,90000") == []
