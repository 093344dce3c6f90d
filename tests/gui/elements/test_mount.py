"""Elements on viser's own widgets: identity, order, what is sent, and whom a press reaches."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import pytest
import viser
from markupsafe import Markup

from tests.support.patience import until
from wafer_viewer.gui.elements.elements import (
    Button,
    Buttons,
    Checkbox,
    Dropdown,
    Element,
    Fold,
    Html,
    Number,
    NumberOrEmpty,
    NumberPair,
    Slider,
    Stack,
    Text,
    Toggle,
)
from wafer_viewer.gui.elements.mount import Mount
from wafer_viewer.gui.widgets.callbacks import Debouncer
from wafer_viewer.model.errors import WaferViewerError


@dataclass
class Page:
    """A page that notes what it is told; what was read before an input is older than it."""

    told: list[Any] = field(default_factory=list)
    typed: list[Debouncer] = field(default_factory=list)
    is_watched: bool = False

    def locks(self, element: Any) -> bool:
        return self.is_watched and getattr(element, "commands", True)

    def settle(self, title: str) -> None:
        self.told = [note for note in self.told if note[0] != title]

    def on_entered(self, edits: Debouncer) -> None:
        self.typed.append(edits)

    def entered(self) -> None:
        for edits in self.typed:
            edits.hurry()

    @property
    def as_of_s(self) -> float:
        return time.monotonic()

    def tell(self, fault: Any) -> None:
        self.told.append((fault.title, fault.text))

    def say(self, title: str, text: str, tone: Any = "good") -> None:
        self.told.append((title, text))


@pytest.fixture(scope="module")
def gui():
    server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    yield server.gui
    server.stop()


@pytest.fixture
def page() -> Page:
    return Page()


@pytest.fixture
def mount(gui: Any, page: Page) -> Mount:
    return Mount(gui, page, "The setting was not changed")


def widgets(mount: Mount) -> list[Any]:
    """The visible inputs of a panel, in their order on the page."""
    handles = mount._folder._children.values()
    shown = [handle for handle in handles if handle.visible and hasattr(handle, "label")]
    return sorted(shown, key=lambda handle: handle.order)


def labels(mount: Mount) -> list[str]:
    return [handle.label for handle in widgets(mount)]


def set_by_a_person(handle: Any, value: Any) -> None:
    """As viser does it: the value first, then the callbacks."""
    handle._impl.value = value
    for callback in handle._impl.update_cb:
        callback(SimpleNamespace(client=object(), target=handle))


def press(handle: Any) -> None:
    for callback in handle._impl.update_cb:
        callback(SimpleNamespace(client=object(), target=handle))


def nothing(_: Any = None) -> None:
    pass


def test_an_element_keeps_its_widget_while_its_place_or_key_stays(mount: Mount):
    mount.show([Text("Title", "a", nothing, ""), Button("Write", nothing)])
    title, write = widgets(mount)
    mount.show([Text("Title", "b", nothing, ""), Button("Writing", nothing, disabled=True)])
    assert widgets(mount) == [title, write]
    assert (title.value, write.label, write.disabled) == ("b", "Writing", True)


def test_one_that_is_missing_is_hidden_and_comes_back_to_its_place(mount: Mount):
    first, last = Button("First", nothing), Button("Last", nothing)
    mount.show([first, None, last])
    mount.show([first, Checkbox("Between", value=True, put=nothing, hint=""), last])
    assert labels(mount) == ["First", "Between", "Last"]
    between = widgets(mount)[1]
    mount.show([first, None, last])
    assert labels(mount) == ["First", "Last"]
    mount.show([first, Checkbox("Between", value=False, put=nothing, hint=""), last])
    assert widgets(mount)[1] is between
    assert between.value is False


def test_stacks_with_keys_have_widgets_of_their_own_at_the_same_place(mount: Mount):
    def of(tool: str) -> list[Element]:
        return [Stack([NumberOrEmpty("Width, µm", None, nothing, "", over=0)], key=tool), Button("Keep", nothing)]

    mount.show(of("step"))
    (width, keep) = widgets(mount)
    mount.show(of("groove"))
    assert labels(mount) == ["Width, µm", "Keep"]
    assert widgets(mount)[0] is not width
    mount.show(of("step"))
    assert widgets(mount) == [width, keep]


def test_fold_holds_its_elements_is_folded_at_first_and_hides_with_them(mount: Mount):
    def of(*inside: Element | None) -> list[Element]:
        return [Button("Above", nothing), Fold("For operators", inside), Button("Below", nothing)]

    mount.show(of(Button("Release", nothing), None))
    (folder,) = mount._folds.values()
    (release,) = folder._children.values()
    assert (folder.expand_by_default, release.label, labels(mount)) == (
        False,
        "Release",
        ["Above", "For operators", "Below"],
    )
    mount.show(of(Button("Released", nothing), Button("Copy", nothing)))
    assert [one.label for one in folder._children.values()] == ["Released", "Copy"]
    mount.show([Button("Above", nothing), None, Button("Below", nothing)])
    assert (folder.visible, release.visible, labels(mount)) == (False, False, ["Above", "Below"])


def test_none_hides_the_panel(mount: Mount):
    mount.show([Button("Keep", nothing)])
    mount.show(None)
    assert not mount._folder.visible
    mount.show([Button("Keep", nothing)])
    assert mount._folder.visible


def test_a_press_reaches_the_callback_of_the_newest_state(mount: Mount):
    pressed: list[str] = []
    mount.show([Buttons([Button("Undo", lambda: pressed.append("old")), Button("Redo", nothing)])])
    mount.show([Buttons([Button("Undo", lambda: pressed.append("new")), Button("Redo", nothing)])])
    press(widgets(mount)[0])
    assert pressed == ["new"]


def test_a_failure_has_the_title_of_the_element_of_its_stack_or_of_the_step(mount: Mount, page: Page):
    def fail(_: Any = None) -> None:
        raise WaferViewerError("It is read only.")

    mount.show(
        [
            Button("A", fail, failed="Not kept"),
            Stack([Buttons([Button("B", fail)])], failed="The line was not changed"),
            Checkbox("C", value=False, put=fail, hint=""),
        ]
    )
    own, of_stack, of_step = widgets(mount)
    press(own)
    press(of_stack)
    set_by_a_person(of_step, True)
    assert [title for title, _ in page.told] == ["Not kept", "The line was not changed", "The setting was not changed"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("element", "typed", "got"),
    [
        (Text, "edge 3", "edge 3"),
        (Checkbox, True, True),
        (Number, 4.0, 4.0),
        (NumberPair, (1.0, 2.5), (1.0, 2.5)),
        (Slider, 0.5, 0.5),
        (NumberOrEmpty, "2,5", 2.5),
        (NumberOrEmpty, "", None),
    ],
)
def test_what_a_person_sets_comes_as_the_value_of_the_element(mount: Mount, element: Any, typed: Any, got: Any):
    first = {Text: "", Checkbox: False, Number: 0.0, NumberPair: (0.0, 0.0), Slider: 0.1, NumberOrEmpty: 1.0}[element]
    put: list[Any] = []
    mount.show([element("Width", first, put.append, "")])
    set_by_a_person(widgets(mount)[0], typed)
    until(lambda: put)
    assert put == [got]


@pytest.mark.slow
def test_a_number_that_is_none_is_refused_with_its_name_and_limit(mount: Mount, page: Page):
    put: list[Any] = []
    mount.show([NumberOrEmpty("λc, µm", None, put.append, "", over=0.0)])
    set_by_a_person(widgets(mount)[0], "-3")
    until(lambda: bool(page.told))
    assert page.told[0][1].startswith("λc, µm is -3: it must be over 0")
    assert put == []


def test_half_a_number_is_not_judged(mount: Mount, page: Page):
    put: list[Any] = []
    mount.show([NumberOrEmpty("Limit, ± µm", None, put.append, "", over=0.0)])
    (limit,) = widgets(mount)
    for text in ("0", "0.", "0.5"):
        set_by_a_person(limit, text)
    mount.show([NumberOrEmpty("Limit, ± µm", None, put.append, "", over=0.0)])
    assert limit.value == "0.5"
    page.entered()  # as Enter and Tab do
    assert (put, page.told) == ([0.5], [])
    page.entered()
    assert put == [0.5]


def test_a_button_acts_on_what_is_typed(mount: Mount):
    put: list[Any] = []
    mount.show([NumberOrEmpty("Limit, ± µm", None, put.append, ""), Button("Measure", lambda: put.append("measured"))])
    limit, measure = widgets(mount)
    set_by_a_person(limit, "2")
    press(measure)
    assert put == [2.0, "measured"]


def test_a_box_holds_one_fault_until_a_value_is_accepted(mount: Mount, page: Page):
    put: list[Any] = []
    mount.show([NumberOrEmpty("Limit, ± µm", None, put.append, "", over=0.0, failed="Not changed")])
    for text in ("-3", "0", "2"):
        set_by_a_person(widgets(mount)[0], text)
        page.entered()
        assert len(page.told) == (text != "2")
    assert put == [2.0]


def test_a_choice_may_get_other_options(mount: Mount):
    mount.show([Dropdown("Compare with", "nothing", nothing, "", options=("nothing",))])
    mount.show([Dropdown("Compare with", "before", nothing, "", options=("nothing", "before"))])
    (choice,) = widgets(mount)
    assert (choice.options, choice.value) == (("nothing", "before"), "before")


def test_a_toggle_gives_the_key_of_its_title(mount: Mount):
    put: list[str] = []
    options = (("show", "Show"), ("hide", "Hide"))
    mount.show([Toggle("Before it", "show", put.append, "", options=options)])
    set_by_a_person(widgets(mount)[0], "Hide")
    assert put == ["hide"]


def test_only_what_differs_is_sent(mount: Mount, monkeypatch: pytest.MonkeyPatch):
    state = [Html(Markup("<b>31.8</b>")), Text("Name", "", nothing, ""), Button("Keep", nothing, style="leading")]
    mount.show(state)
    sent: list[Any] = []
    messages = mount._gui._websock_interface
    monkeypatch.setattr(messages, "queue_message", sent.append)
    mount.show([Html(Markup("<b>31.8</b>")), Text("Name", "", nothing, ""), Button("Keep", nothing, style="leading")])
    assert sent == []
    mount.show([Html(Markup("<b>31.9</b>")), *state[1:]])
    assert len(sent) == 1


def test_what_needs_control_is_locked_while_another_holds_it(mount: Mount, page: Page):
    def of(off: bool = False) -> list[Element]:
        lot, note = Text("Lot", "", nothing, "", commands=True), Text("Note", "", nothing, "")
        return [lot, note, Button("Start", nothing, disabled=off, commands=True), Button("Stop", nothing)]

    def locked() -> list[str]:
        return [handle.label for handle in widgets(mount) if handle.disabled]

    page.is_watched = True
    mount.show(of())
    assert locked() == ["Lot", "Start"]
    page.is_watched = False
    mount.show(of())
    assert locked() == []
    mount.show(of(off=True))
    assert locked() == ["Start"], "as its part of the page wants it"
