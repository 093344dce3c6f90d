"""Several browsers at one session: one holds the controls, and nobody is locked out."""

from __future__ import annotations

import pytest

from tests.browser.recording import groups_of, verbs_of
from wafer_viewer.model.errors import WaferViewerError
from wafer_viewer.session.core.command_queue import CommandQueue
from wafer_viewer.session.core.control_handover import ANSWER_S, GRACE_S, Control
from wafer_viewer.session.session import Session
from wafer_viewer.session.state.snapshot import Snapshot


class Hourglass:
    """Time that a test turns on by hand."""

    def __init__(self):
        self.waiting = []

    def later(self, wait_s, then):
        entry = (wait_s, then)
        self.waiting.append(entry)
        return lambda: self.waiting.remove(entry) if entry in self.waiting else None

    def pass_only(self, wait_s):
        """What waits for just so long is due, what was begun with another time is not."""
        due = [entry for entry in self.waiting if entry[0] == wait_s]
        self.waiting = [entry for entry in self.waiting if entry[0] != wait_s]
        for _, then in due:
            then()

    def pass_by(self, wait_s):
        due = [entry for entry in self.waiting if entry[0] <= wait_s]
        self.waiting = [entry for entry in self.waiting if entry[0] > wait_s]
        for _, then in due:
            then()


@pytest.fixture
def command_queue():
    made = CommandQueue(Snapshot())
    yield made
    made.close()


@pytest.fixture
def clock():
    return Hourglass()


@pytest.fixture
def control(command_queue, clock):
    made = Control(command_queue, clock.later)
    made.arrive("a", "Anna").result()
    made.arrive("b").result()
    return made


@pytest.fixture
def state(command_queue):
    def now():
        command_queue.do(lambda: None).result()
        return command_queue.snapshot.control

    return now


def test_the_first_browser_has_control_and_others_see_its_name(control, state):
    assert state().holds("a")
    assert [b.name for b in state().browsers] == ["Anna", "Browser 2"]
    assert state().why_not("a") is None
    assert state().why_not("b") == "Anna holds the controls."


def test_the_holder_can_hand_control_to_the_requester(control, state):
    control.ask("b").result()
    assert (state().requester, state().answer_s) == ("b", ANSWER_S)
    control.hand_over("a", "b").result()
    assert state().holds("b")
    assert state().requester is None


def test_the_holder_can_refuse_a_request(control, state, clock):
    control.ask("b").result()
    control.keep("a").result()
    assert (state().holder, state().requester, state().refused) == ("a", None, "b")
    clock.pass_by(ANSWER_S)
    assert state().holds("a")


def test_control_passes_when_the_holder_does_not_answer(control, state, clock):
    control.ask("b").result()
    clock.pass_by(ANSWER_S - 1)
    assert state().holds("a")
    clock.pass_by(ANSWER_S)
    assert state().holds("b")


def test_a_second_request_waits_for_the_first(control, state):
    control.arrive("c", "Cleo").result()
    control.ask("b").result()
    with pytest.raises(WaferViewerError, match="Browser 2 asks for the controls already"):
        control.ask("c").result()
    assert state().requester == "b"


def test_a_reload_keeps_control_and_a_long_absence_frees_it(control, state, clock):
    control.leave("a").result()
    assert state().holds("a")
    assert not state().browser("a").present
    control.arrive("a").result()
    clock.pass_by(GRACE_S)
    assert state().holds("a")
    assert state().name_of("a") == "Anna"
    control.leave("a").result()
    clock.pass_by(GRACE_S)
    assert state().holds("b")
    assert [b.key for b in state().browsers] == ["b"]


def test_one_of_two_windows_of_a_browser_can_be_closed(control, state, clock):
    control.arrive("a").result()
    control.leave("a").result()
    clock.pass_by(GRACE_S)
    assert state().holds("a")


def test_a_window_that_never_opened_cannot_be_closed(control, state, clock):
    control.leave("a").result()
    control.leave("a").result()
    control.leave("z").result()
    control.arrive("a").result()
    clock.pass_by(GRACE_S)
    assert state().holds("a")


def test_control_stays_free_while_several_browsers_watch(control, state, clock):
    control.arrive("c", "Cleo").result()
    control.leave("a").result()
    clock.pass_by(GRACE_S)
    assert state().holder is None
    assert state().why_not("c") == "Nobody holds the controls."
    control.ask("c").result()
    assert state().holds("c")


def test_control_passes_to_the_requester_when_the_holder_disconnects(control, state, clock):
    control.arrive("c", "Cleo").result()
    control.ask("c").result()
    control.leave("a").result()
    clock.pass_by(GRACE_S)
    assert state().holds("c")


def test_a_requester_that_disconnects_gets_no_control(control, state, clock):
    control.ask("b").result()
    control.leave("b").result()
    clock.pass_only(GRACE_S)
    assert (state().holder, state().requester) == ("a", None)
    clock.pass_by(ANSWER_S)
    assert state().holds("a")


def test_only_the_holder_can_hand_over_control(control, state):
    with pytest.raises(WaferViewerError, match="Ask for control first"):
        control.hand_over("b", "b").result()
    with pytest.raises(WaferViewerError, match="has disconnected"):
        control.hand_over("a", "z").result()
    assert state().holds("a")


def test_a_name_can_be_changed_and_not_emptied(control, state):
    control.rename("b", "  Ben  \n Weiss ").result()
    control.rename("b", "   ").result()
    assert state().name_of("b") == "Ben Weiss"


FREE = {
    *("subscribe", "wait_until", "mosaic", "height_map", "surface_source", "poses", "frame", "frame_near", "paint"),
    *("profile", "read_out", "focus_curve", "measure", "datum", "thumbnail", "refresh_datasets", "recorded_actions"),
    *(
        "export_surface",
        "export_findings",
        "exchange.is_surface",
        "exchange.export_surface",
        "exchange.export_fields",
        "stop",
        "stop_scan",
    ),
    *("control.arrive", "control.leave", "control.rename", "control.ask", "control.hand_over", "control.keep"),
    *("control.sign_in", "control.sign_out"),
    *("live.keep_picture", "calibration.refresh"),
    *("papers.keep_picture", "papers.write_report", "papers.contents"),
    *("exchange.look", "exchange.stop_look"),
    *("browsing.list_folder", "browsing.look", "browsing.allowed"),
    *("browsing.path_of", "browsing.existing", "browsing.remember"),
    *("comparing.choices", "sections.section", "sections.others", "sections.file", "defects.files.write"),
    *("gauge.find_faces", "gauge.check", "studies.gauge_rr"),
    *("live.look", "live.on_frame"),
    *("defects.views.beside", "defects.views.die", "defects.views.repeats"),
}


def free_verbs(true: type, path: str = "") -> set[str]:
    own = {f"{path}{name}" for name in verbs_of(true) if not getattr(getattr(true, name), "needs_control", True)}
    return own.union(*(free_verbs(group, f"{path}{name}.") for name, group in groups_of(true).items()))


def test_an_observer_may_look_measure_export_and_stop_and_nothing_else():
    assert free_verbs(Session) == FREE
