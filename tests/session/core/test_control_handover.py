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
def glass():
    return Hourglass()


@pytest.fixture
def control(command_queue, glass):
    made = Control(command_queue, glass.later)
    made.arrive("a", "Anna").result()
    made.arrive("b").result()
    return made


@pytest.fixture
def hands(command_queue):
    def now():
        command_queue.do(lambda: None).result()
        return command_queue.snapshot.hands

    return now


def test_the_first_comer_holds_the_controls_and_the_others_are_told_who_does(control, hands):
    assert hands().holds("a")
    assert [b.name for b in hands().browsers] == ["Anna", "Browser 2"]
    assert hands().why_not("a") is None
    assert hands().why_not("b") == "Anna holds the controls."


def test_who_asks_gets_the_controls_when_the_holder_hands_them_over(control, hands):
    control.ask("b").result()
    assert (hands().asking, hands().answer_s) == ("b", ANSWER_S)
    control.hand_over("a", "b").result()
    assert hands().holds("b")
    assert hands().asking is None


def test_who_asks_is_turned_down_by_a_holder_who_keeps_them(control, hands, glass):
    control.ask("b").result()
    control.keep("a").result()
    assert (hands().holder, hands().asking, hands().kept_from) == ("a", None, "b")
    glass.pass_by(ANSWER_S)
    assert hands().holds("a")


def test_the_controls_pass_when_the_holder_does_not_answer(control, hands, glass):
    control.ask("b").result()
    glass.pass_by(ANSWER_S - 1)
    assert hands().holds("a")
    glass.pass_by(ANSWER_S)
    assert hands().holds("b")


def test_two_who_ask_are_heard_one_after_the_other(control, hands):
    control.arrive("c", "Cleo").result()
    control.ask("b").result()
    with pytest.raises(WaferViewerError, match="Browser 2 asks for the controls already"):
        control.ask("c").result()
    assert hands().asking == "b"


def test_a_reload_keeps_the_controls_and_one_who_stays_away_frees_them(control, hands, glass):
    control.leave("a").result()
    assert hands().holds("a")
    assert not hands().browser("a").present
    control.arrive("a").result()
    glass.pass_by(GRACE_S)
    assert hands().holds("a")
    assert hands().name_of("a") == "Anna"
    control.leave("a").result()
    glass.pass_by(GRACE_S)
    assert hands().holds("b")
    assert [b.key for b in hands().browsers] == ["b"]


def test_of_two_windows_of_a_browser_one_may_be_closed(control, hands, glass):
    control.arrive("a").result()
    control.leave("a").result()
    glass.pass_by(GRACE_S)
    assert hands().holds("a")


def test_a_window_that_never_opened_cannot_be_closed(control, hands, glass):
    control.leave("a").result()
    control.leave("a").result()
    control.leave("z").result()
    control.arrive("a").result()
    glass.pass_by(GRACE_S)
    assert hands().holds("a")


def test_nobody_is_handed_the_controls_unasked_where_several_watch(control, hands, glass):
    control.arrive("c", "Cleo").result()
    control.leave("a").result()
    glass.pass_by(GRACE_S)
    assert hands().holder is None
    assert hands().why_not("c") == "Nobody holds the controls."
    control.ask("c").result()
    assert hands().holds("c")


def test_when_the_holder_goes_the_one_who_asked_has_them(control, hands, glass):
    control.arrive("c", "Cleo").result()
    control.ask("c").result()
    control.leave("a").result()
    glass.pass_by(GRACE_S)
    assert hands().holds("c")


def test_one_who_asked_and_went_gets_nothing(control, hands, glass):
    control.ask("b").result()
    control.leave("b").result()
    glass.pass_only(GRACE_S)
    assert (hands().holder, hands().asking) == ("a", None)
    glass.pass_by(ANSWER_S)
    assert hands().holds("a")


def test_only_the_holder_passes_them_on(control, hands):
    with pytest.raises(WaferViewerError, match="Ask for them first"):
        control.hand_over("b", "b").result()
    with pytest.raises(WaferViewerError, match="has disconnected"):
        control.hand_over("a", "z").result()
    assert hands().holds("a")


def test_a_name_can_be_changed_and_not_emptied(control, hands):
    control.rename("b", "  Ben  \n Weiss ").result()
    control.rename("b", "   ").result()
    assert hands().name_of("b") == "Ben Weiss"


FREE = {
    *("subscribe", "wait_until", "mosaic", "height_map", "surface_source", "poses", "frame", "frame_near", "paint"),
    *("profile", "read_out", "focus_curve", "measure", "datum", "thumbnail", "refresh_datasets"),
    *("export_surface", "export_findings", "exchange.is_surface", "exchange.export_surface", "stop", "stop_scan"),
    *("control.arrive", "control.leave", "control.rename", "control.ask", "control.hand_over", "control.keep"),
    *("papers.keep_picture", "papers.write_report", "papers.contents"),
    *("browsing.list_folder", "browsing.look", "browsing.allowed"),
    *("browsing.path_of", "browsing.existing", "browsing.remember"),
    *("comparing.choices", "sections.section", "sections.others", "sections.file", "defects.files.write"),
    *("gauge.find_faces", "gauge.check", "studies.gauge_rr"),
    *("defects.views.beside", "defects.views.die", "defects.views.repeats"),
}


def free_verbs(true: type, path: str = "") -> set[str]:
    own = {f"{path}{name}" for name in verbs_of(true) if not getattr(getattr(true, name), "needs_control", True)}
    return own.union(*(free_verbs(group, f"{path}{name}.") for name, group in groups_of(true).items()))


def test_an_observer_may_look_measure_export_and_stop_and_nothing_else():
    assert free_verbs(Session) == FREE
