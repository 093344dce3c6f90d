"""The states of the page that the audit looks over: a new screen is a line here."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

from playwright.sync_api import expect

from tests.browser.audit import Act, Group, State, Visit
from tests.browser.screen_list import EXPIRED, choose_stack, moving, noted
from tests.browser.sessions import calibrated_states as calibrated
from tests.browser.sessions import fake_session as fake
from tests.browser.sessions import operator_session as operator
from tests.browser.sessions.compared_session import ComparedSession
from tests.browser.sessions.fake_exchange import looking_session
from tests.browser.sessions.fake_session import FakeSession
from tests.browser.sessions.followed_session import followed
from tests.browser.sessions.gauge_blocks import certificate
from tests.browser.sessions.gauge_session import TERMS, GaugeSession, checked, correctable, worked_out
from tests.browser.sessions.inspected_session import inspected_session, repeating_session
from tests.browser.sessions.inspected_states import whole_wafer
from tests.browser.sessions.live_session import live_session
from tests.browser.sessions.measuring_session import MeasuringSession
from tests.browser.sessions.seen_session import SeenSession
from wafer_viewer.model.spec import replace
from wafer_viewer.session.planning.guided_tour import TOUR_LOT
from wafer_viewer.session.state.inspection_state import GaugeState, InspectionState
from wafer_viewer.session.state.instrument_state import CalibrationState
from wafer_viewer.session.state.snapshot import Snapshot

DIALOG = ".mantine-Modal-content:has(.wv-away)"
BACK = ".wv-action:has-text('Back to this check')"
OPEN = ".mantine-Modal-content, .mantine-Spotlight-content"


def escape(visit: Visit) -> None:
    """Leave a dialog, a palette or a tool."""
    visit.page.keyboard.press("Escape")
    visit.page.locator(OPEN).first.wait_for(state="detached")


def go_to(step: str) -> Act:
    """Go to a step through the header."""

    return then(escape, press_step(step))


def shows(make: Callable[[], Snapshot], step: str) -> Act:
    """Another snapshot, and a step of it."""

    def act(visit: Visit) -> None:
        escape(visit)
        visit.session.change(**_given(make()))
        press_step(step)(visit)

    return act


def _given(now: Snapshot) -> dict[str, Any]:
    return {f.name: getattr(now, f.name) for f in dataclasses.fields(now) if f.name not in ("version", "control")}


def to(make: Callable[[], Snapshot], step: str) -> Act:
    """Another snapshot, and a step of it, with the tour under way."""

    def act(visit: Visit) -> None:
        visit.session.change(**_given(make()))
        press_step(step)(visit)

    return act


def press_step(step: str) -> Act:
    """Press a step in the header; Escape would end the tour."""

    def act(visit: Visit) -> None:
        button = visit.page.get_by_role("button", name=step, exact=True).first
        expect(button).not_to_have_attribute("aria-disabled", "true")
        button.click()
        visit.page.locator("button[aria-current=step]", has_text=step).first.wait_for()

    return act


def skip(visit: Visit) -> None:
    """Skip the step of the tour."""
    visit.page.locator("[data-pick=tour-skip]").click()


def keys(*pressed: str) -> Act:
    """Press keys, from outside of any dialog."""

    def act(visit: Visit) -> None:
        escape(visit)
        for key in pressed:
            visit.page.keyboard.press(key)

    return act


def command(name: str) -> Act:
    """Choose a command from the palette."""

    def act(visit: Visit) -> None:
        escape(visit)
        visit.page.keyboard.press("Control+k")
        visit.page.locator("input.mantine-Spotlight-search").fill(name)
        visit.page.locator(".mantine-Spotlight-action", has_text=name).first.click()

    return act


def click_here(selector: str) -> Act:
    """Click the first element of a kind, and leave the tool as it is."""
    return lambda visit: visit.page.locator(selector).first.click()


def click(selector: str) -> Act:
    """Click the first element of a kind, from outside of any dialog or tool."""
    return then(escape, click_here(selector))


def button(name: str) -> str:
    """Selector of the button in sight with a name."""
    return f"[data-dock-region] button:has-text('{name}'):not([data-disabled])"


def press(name: str) -> Act:
    """Press the button in sight with a name, from outside of any dialog or tool."""
    return click(button(name))


def then(*acts: Act) -> Act:
    """One after the other."""

    def act(visit: Visit) -> None:
        for each in acts:
            each(visit)

    return act


def change(**fields: Callable[[], Any]) -> Act:
    """Another state of parts of the snapshot."""
    return lambda visit: visit.session.change(**{name: make() for name, make in fields.items()})


def lose(visit: Visit) -> None:
    """Have the program go."""
    escape(visit)
    visit.kept.stop()


def watch(visit: Visit) -> None:
    """Somebody else takes the controls."""
    escape(visit)
    holder = visit.session.snapshot.control.holder
    visit.session.control.arrive("another", "K. Adler")
    visit.session.control.hand_over(holder, "another")


TOOLS = {
    "k": "Step height", "Shift+K": "Groove", "x": "Point", "m": "Distance", "Shift+F": "Flatness", "b": "Angle",
    "r": "Radius", "v": "Volume", "Shift+T": "Texture",
}  # fmt: skip


def _gauge(make: Callable[[], GaugeState]) -> Act:
    return then(escape, change(gauge=lambda: worked_out(make())))


def _waits() -> Snapshot:
    return calibrated.instrument_session(calibrated.pending(drift=1.6)).snapshot


def _first() -> GaugeState:
    return GaugeState(certificate=certificate(), terms=TERMS)


def _of_tour(now: Snapshot, **also: Any) -> Snapshot:
    """The snapshot, planned and taken as the tour."""

    def of_tour(job: Any) -> Any:
        return replace(job, sample=replace(job.sample, lot=TOUR_LOT))

    data = now.dataset and dataclasses.replace(now.dataset, job=of_tour(now.dataset.job))
    draft = dataclasses.replace(now.draft, job=of_tour(now.draft.job or fake.a_job()), confirmed=True)
    return dataclasses.replace(now, dataset=data, draft=draft, **also)


def _tour_begins(visit: Visit) -> None:
    """Take the tour from the card of an empty page."""
    visit.page.locator("[data-pick=tour]").first.click()
    visit.session.change(draft=_of_tour(fake.planned()).draft)


def _tour_found() -> Snapshot:
    """A surface with its defects, of the tour."""
    now = _of_tour(_INSPECTED.snapshot)
    return dataclasses.replace(now, rig=fake.RIG, compute_ready=True)


_INSPECTED = inspected_session()


GROUPS = {
    "still": Group(
        lambda: looking_session(fake.empty()),
        "plan",
        (
            State("start", until=".wv-hello"),
            State("open", keys("Control+o"), DIALOG),
            State("import", keys("Shift+I"), DIALOG),
            State("import files", then(keys("Shift+I"), lambda visit: choose_stack(visit.page)), ".wv-imp-foot"),
            State("load plan", command("Load plan…"), DIALOG),
            State("keys", keys("F1"), ".wv-sheet"),
            State("glossary", command("Glossary"), ".wv-glossary"),
            State("audit log", command("Audit log"), ".wv-audit"),
            State("palette", keys("Control+k"), ".mantine-Spotlight-content"),
            State("plan", shows(fake.planned, "Plan"), ":text('Predicted time')"),
            State("following", shows(followed, "Plan"), ":text('from the side')"),
            State("moving", shows(moving, "Plan"), ".wv-pill.simulated:has-text('moving')"),
            State("scanning", shows(fake.scanning, "Acquire"), ":text('Frame 173 did not arrive')"),
            State("stop asked", keys("Shift+Escape"), DIALOG),
            State("unfinished", shows(fake.unfinished, "Acquire"), "button:has-text('Continue the scan')"),
            State("fault", shows(fake.at_fault, "Plan"), ".wv-note.fault"),
            State("uncalibrated", shows(lambda: fake.measured("no calibration was given"), "Surface")),
            State("export", keys("Shift+E"), DIALOG),
            State("measure", shows(fake.measured, "Measure")),
            State("no faces", go_to("Gauge check"), ":text('The faces were not found')"),
        ),
    ),
    "job": Group(
        lambda: FakeSession(operator.waiting()),
        "plan",
        (
            State("wafer"),
            State("aligned", shows(operator.aligned, "Plan")),
            State("not aligned", shows(lambda: operator.aligned(14.6), "Plan")),
            State("taking", shows(operator.taking, "Acquire")),
            State("passed", shows(lambda: operator.judged(operator.PASS), "Acquire"), ".wv-verdict"),
            State("failed", shows(lambda: operator.judged(operator.FAIL), "Acquire"), ".wv-verdict"),
            State("inconclusive", shows(lambda: operator.judged(operator.OPEN), "Acquire"), ".wv-verdict.attention"),
            State("judged", shows(lambda: operator.judged(operator.on_dies()), "Surface"), ".wv-verdict"),
            State("trial", shows(operator.tried, "Plan")),
            State("feature", then(click(":text('For operators')"), press("Feature…")), DIALOG),
            State("watching", then(shows(fake.scanning, "Acquire"), watch), ".wv-hand.theirs"),
            State("no contact", lose, ".wv-bar-over.lost.on"),
        ),
    ),
    "live": Group(live_session, "plan", (State("bench"), State("live", keys("c"), ".wv-live-focus"))),
    "surface": Group(
        noted,
        "surface",
        (
            State("surface", until=".wv-title:has-text('Surface')"),
            State("fields", keys("o")),
            State("one z", then(press("Plan"), click("label:has-text('One z')")), ":text('z, µm')"),
            State("review", go_to("Review")),
            State("result", keys("PageDown"), ".wv-title"),
            State("report", go_to("Report"), "button:has-text('Write report')"),
        ),
    ),
    "points": Group(
        SeenSession,
        "surface",
        (
            State("points", press("Points"), ".wv-points:has-text('points')"),
            State("clipped", press("To view"), ".wv-points:has-text('points')"),
        ),
    ),
    "tools": Group(
        MeasuringSession,
        "measure",
        (
            State("profile", keys("l"), ".wv-profiles"),
            State("profiles", keys("Shift+H", "Shift+L"), ".wv-profiles"),  # a row, and a line across it
            *(State(name, keys(key), f".wv-title:has-text('{name}')") for key, name in TOOLS.items()),
            State("kept", then(keys("k"), click_here(button("Keep result"))), "tr[data-pick=finding]"),
        ),
    ),
    "gauge": Group(
        lambda: GaugeSession(with_surface=True),
        "gauge",
        (
            State("before"),
            State("certificate dialog", press("Load the certificate…"), DIALOG),
            State("certificate", _gauge(_first), "button:has-text('Measure the step')"),
            State("running", _gauge(lambda: dataclasses.replace(_first(), busy=True)), ":text('a repeat is being')"),
            State("refused", _gauge(lambda: GaugeState(certificate=certificate("2026-03-14"), refusal=EXPIRED))),
            State("gauge passed", _gauge(checked), ".wv-gauge-chart, .wv-verdict"),
            State("sign", press("Sign and save"), DIALOG),
            State("gauge failed", _gauge(lambda: checked(off_um=1.4)), ".wv-verdict.fault"),
            State("earlier", click("tr[data-pick=gauge-record]"), ".wv-title:has-text('Earlier check')"),
            State(
                "correct",
                then(click("[data-pick=gauge-record]"), _gauge(correctable), press("Correct the z scale…")),
                DIALOG,
            ),
        ),
    ),
    "instrument": Group(
        lambda: calibrated.instrument_session(CalibrationState()),
        "gauge",
        (
            State("nothing measured", click("[data-pick=gauge-look][data-k=instrument]"), ".wv-kinds"),
            State("run", press("Run here…"), DIALOG),
            State("calibrating", shows(calibrated.running, "Gauge check"), ".wv-calibrating"),
            State("result", shows(_waits, "Gauge check"), button("Keep…")),
            State("keep", press("Keep…"), DIALOG),
            State("another waits", click("[data-pick=calibration-kind][data-k=pixel]"), ":text('A result is waiting')"),
            State(
                "by checks",
                then(
                    click("[data-pick=calibration-kind][data-k=linearity]"), change(calibration=calibrated.calibrated)
                ),
                button("Evaluate the checks"),
            ),
        ),
    ),
    "defects": Group(
        repeating_session,
        "review",
        (
            State("list", keys("PageDown"), ".wv-over-picture img"),
            State("form", click("[data-pick=defect-form]")),
            State("gallery", keys("z"), ".wv-tile img"),
            State("stack", keys("Backspace"), ".wv-stack-list tr"),
            State("one place", lambda visit: visit.page.keyboard.press("Backspace"), ".wv-alone"),
            State("note", command("Note"), DIALOG),
            State("left out", click("[data-pick=defect-excluded][data-k=here]"), DIALOG),
            State("klarf", click("[data-pick=defect-errand]"), DIALOG),
            State("golden die", click("[data-pick=defect-errand][data-k=golden]"), DIALOG),
            State("recipes", press("Recipes…"), DIALOG),
            State("inspecting", then(escape, change(inspection=lambda: InspectionState(work="1")))),
            State("inspection failed", change(inspection=lambda: InspectionState(problem="The dies were not found."))),
            State("wafer", change(inspection=lambda: whole_wafer().snapshot.inspection)),
        ),
    ),
    "tour": Group(
        lambda: FakeSession(fake.empty()),
        "plan",
        (
            State("tour: plan", _tour_begins, ".wv-tour:has-text('Scan a wafer')"),
            State("tour: scan", to(lambda: _of_tour(fake.scanning()), "Acquire"), ".wv-tour:has-text('Watch')"),
            State(
                "tour: taken",
                to(lambda: _of_tour(fake.measured(), findings=()), "Acquire"),
                ".wv-tour:has-text('stitched')",
            ),
            State("tour: surface", press_step("Surface"), ".wv-tour:has-text('Measure this')"),
            State("tour: measure", press_step("Measure"), ".wv-tour:has-text('Measure a step')"),
            State("tour: to review", skip, ".wv-tour:has-text('Find the defects')"),
            State("tour: inspect", press_step("Review"), ".wv-tour:has-text('Inspect')"),
            State("tour: judge", change(inspection=lambda: _tour_found().inspection), ".wv-tour:has-text('Judge')"),
            State("tour: to report", skip, ".wv-tour:has-text('Write the report')"),
            State("tour: report", press_step("Report"), ".wv-tour:has-text('Write report')"),
            State("tour: end", skip, ".wv-tour-end"),
        ),
    ),
    "compared": Group(
        ComparedSession,
        "surface",
        (
            State("compare", click("[data-pick=compare-new]")),
            State("difference", click("[data-pick=compare-look]")),
        ),
    ),
}
