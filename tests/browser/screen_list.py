"""Every panel and state of the page that has a picture: which session, which step, what is done before it is taken.

A new panel adds a line to `SCREENS`. Sessions here stand still; the tour on the true one is in `screens`.
"""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from playwright.sync_api import Page

from tests.browser.recording import done
from tests.browser.sessions import calibrated_states as calibrated
from tests.browser.sessions import fake_session as fake
from tests.browser.sessions import operator_session as operator
from tests.browser.sessions.compared_session import ComparedSession
from tests.browser.sessions.fake_exchange import looking_session, write_stack
from tests.browser.sessions.fake_session import FakeSession
from tests.browser.sessions.followed_session import followed
from tests.browser.sessions.gauge_blocks import certificate
from tests.browser.sessions.gauge_session import TERMS, GaugeSession, a_study, checked, correctable
from tests.browser.sessions.handed_session import with_golden, with_other_tool
from tests.browser.sessions.inspected_session import inspected_session, repeating_session
from tests.browser.sessions.inspected_states import failed, held_elsewhere, inspected_as, whole_wafer
from tests.browser.sessions.live_session import live_session
from tests.browser.sessions.measuring_session import MeasuringSession
from tests.browser.sessions.reviewed_session import reviewed_session
from tests.browser.sessions.seen_session import SeenSession, a_focus_curve
from tests.browser.sessions.shaped_session import ShapedSession
from tests.browser.sessions.stitched_session import StitchedSession
from tests.browser.steps import type_into
from wafer_viewer.model.job import Judgement, Notebook, SavedView
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import replace
from wafer_viewer.session.state.inspection_state import GaugeState
from wafer_viewer.session.state.snapshot import NotebookState

Act = Callable[[Page], None]
COUNT = "[data-pick=defect-map-by][data-k=count]"


@dataclass(frozen=True)
class Screen:
    """A picture of the page. seen: wait for the surface; then: what is done before it is taken, in order."""

    session: Callable[[], Any]
    step: str = "plan"
    chosen: dict[str, object] = field(default_factory=dict)
    seen: bool = False
    then: tuple[Act, ...] = ()


def still(make: Callable[[], Any], step: str, *then: Act) -> Screen:
    """A screen of a session that shows nothing but a snapshot."""
    return Screen(lambda: FakeSession(make()), step, then=then)


def press(*keys: str) -> Act:
    """Press keys, one after the other, at a person's pace."""

    def act(page: Page) -> None:
        for key in keys:
            page.keyboard.press(key)
            page.wait_for_timeout(700)

    return act


def pause(page: Page) -> None:
    """Let what is made elsewhere arrive."""
    page.wait_for_timeout(2500)


def click(selector: str) -> Act:
    """Click the first element of a kind."""
    return lambda page: page.locator(selector).first.click()


def mark_a_few(page: Page) -> None:
    """Select some tiles of the gallery."""
    for n in (3, 4, 8):
        page.locator("[data-pick=tile]").nth(n).click(modifiers=["Control"])


def unfold(page: Page) -> None:
    """Open what an engineer adds for operators."""
    page.get_by_text("For operators").click()
    page.wait_for_timeout(700)


def press_button(name: str) -> Act:
    """Press a button by what it says."""
    return lambda page: page.get_by_role("button", name=name).click()


def bring_into_sight(head: str) -> Act:
    """Scroll the right panel to a section."""
    return lambda page: (
        page.locator("[data-dock-region=right] .wv-h", has_text=head)
        .first.evaluate("head => head.scrollIntoView({block: 'center'})")
    )  # fmt: skip


def ask_why(page: Page) -> None:
    """Click the middle of the scene and ask."""
    box = page.locator("canvas").first.bounding_box()
    if box is not None:
        page.mouse.click(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    page.locator("[data-pick=why]").click()
    page.locator(".wv-patch img").wait_for()


def explained(measured: bool) -> SeenSession:
    """A session that says why a pixel has its height, or none."""
    session = SeenSession()
    session.answers.append(done(a_focus_curve(-12.4, 37.0, measured)))
    return session


def noted() -> StitchedSession:
    """A stitched surface with results, some of them judged, and views to come back to."""
    session = StitchedSession(3, 3)
    step = fake.a_step(Region.rectangle(-80, 0, -20, 40), Region.rectangle(20, 0, 80, 40))
    line, _ = fake.a_profile(Region.line(-200, -100, 150, -60, 3.0))
    named = [(step, "Die to trench"), (line, "Across the gel drop"), (step, "Die 4 to trench")]
    findings = tuple(replace(made, name=name, number=k + 1) for k, (made, name) in enumerate(named))
    pose = {"position_mm": (0.1, -0.9, 0.8), "look_at_mm": (0.0, 0.0, 0.0)}
    views = tuple(SavedView(number=k + 1, name=name, **pose) for k, name in enumerate(("The edge", "Gel drop, near")))
    judged = (
        Judgement(key="result 2", verdict="accepted"),
        Judgement(key="result 3", verdict="rejected", note="burr"),
    )
    book = NotebookState(Notebook(views=views, judgements=judged), can_undo=True)
    session.change(findings=findings, findings_undo=True, notebook=book)
    return session


def operated(make: Callable[[], Any], step: str = "plan", *then: Act) -> Screen:
    """A screen of a released job."""
    return Screen(lambda: FakeSession(make()), step, then=then)


def watching(session: Any) -> Any:
    """A session whose controls somebody else holds."""
    session.control.arrive("another", "K. Adler")
    return session


def watched(make: Callable[[], Any]) -> FakeSession:
    """A session whose controls somebody else holds."""
    return watching(FakeSession(make()))


def reopened() -> Any:
    """A plan that was opened again after a restart."""
    now = fake.planned()
    return dataclasses.replace(now, draft=dataclasses.replace(now.draft, confirmed=False))


def stitched(rows: int, cols: int, **chosen: object) -> Screen:
    """A stitched surface, with how its fields were placed."""
    at = (bring_into_sight("Stitching"),)
    return Screen(lambda: StitchedSession(rows, cols), "surface", dict(chosen), seen=True, then=at)


def measuring(*then: Act) -> Screen:
    """A surface that is really measured."""
    return Screen(MeasuringSession, "measure", seen=True, then=then)


def shaping(*then: Act) -> Screen:
    """Dies with bumps, measured on the picture and in the heights."""
    return Screen(ShapedSession, "measure", {"all_in_focus": 0.6}, seen=True, then=then)


def kept(key: str) -> tuple[Act, ...]:
    """Measure with the tool of a key and keep what comes."""
    keep = "[data-dock-region=right] button:has-text('Keep result'):not([data-disabled])"
    return press(key), lambda page: page.wait_for_timeout(2000), click(keep)


def fly_to_result(number: int) -> Act:
    """Choose a result of the list."""
    return click(f"tr[data-pick=finding][data-k='{number}']")


def choose_stack(page: Page) -> None:
    """Choose a folder of images in the import dialog."""
    folder = write_stack(Path(tempfile.gettempdir()) / "wafer-viewer-screens" / "board-0142")
    for label, text in (("Path", str(folder)), ("Pixel, µm", "0.65"), ("z step, µm", "2.5")):
        type_into(page, label, text)


def read_from(zero: str) -> Act:
    """Choose what heights are read from."""

    def act(page: Page) -> None:
        page.get_by_label("Heights from").click()
        page.get_by_role("option", name=zero, exact=True).click()

    return act


def gauge(state: Callable[[], GaugeState], *then: Act) -> Screen:
    """A check of gauge blocks."""
    return Screen(lambda: GaugeSession(state()), "gauge", then=(see_blocks, *then))


def study() -> tuple[Act, ...]:
    """Read a study of the gauge, made up, and bring what it comes to into sight."""

    def read(page: Page) -> None:
        with tempfile.NamedTemporaryFile("w", suffix=".csv", delete=False) as file:
            file.write(a_study())
        page.get_by_role("button", name="Gauge R&R study…").click()
        page.locator(".mantine-Modal-content input").first.fill(file.name)
        page.wait_for_timeout(300)
        page.get_by_role("button", name="Read the study").click()
        page.wait_for_timeout(1500)

    return read, bring_into_sight("Repeatability and reproducibility")


def see_blocks(page: Page) -> None:
    """Wait for the figure in the scene."""
    page.locator(".wv-gauge-glass").wait_for()
    page.wait_for_timeout(3000)


def moving() -> Any:
    """The stage is on its way."""
    return dataclasses.replace(fake.planned(), rig=dataclasses.replace(fake.RIG, state="moving"))


EXPIRED = "Certificate K-2231 expired on 2026-03-14 and the scan is of 2026-11-21: have the blocks certified again."
UNCALIBRATED = "no calibration was given"
SCREENS: dict[str, Screen] = {
    "start": still(fake.empty, "plan"),
    "plan": still(fake.planned, "plan"),
    "follow": still(followed, "plan"),
    "live": Screen(live_session, "plan", then=(press("c"),)),
    "acquire": still(fake.scanning, "acquire"),
    "unfinished": still(fake.unfinished, "acquire"),
    "uncalibrated": still(lambda: fake.measured(UNCALIBRATED), "surface"),
    "fault": still(fake.at_fault, "plan"),
    "stop": still(fake.scanning, "acquire", press("Shift+Escape")),
    "moving": still(moving, "plan"),
    "import": still(fake.planned, "plan", press("Shift+I")),
    "import-files": Screen(lambda: looking_session(fake.planned()), then=(press("Shift+I"), choose_stack)),
    "export": still(fake.measured, "surface", press("Shift+E")),
    "keys": still(fake.measured, "surface", press("F1")),
    "palette": still(fake.measured, "surface", press("Control+k")),
    "read-only": still(lambda: read_only(fake.measured()), "measure"),
    **{name.partition("-")[2]: operated(*screen) for name, screen in operator.SCREENS.items()},
    "surface": Screen(noted, "surface", seen=True),
    "watching": Screen(lambda: watched(fake.scanning), "acquire"),
    "reopened": still(reopened, "plan"),
    "points": Screen(noted, "surface", {"look": "points"}, seen=True),
    "seen-from-above": Screen(noted, "surface", {"look": "plan"}, seen=True),
    "slope": Screen(noted, "surface", {"colour_by": "slope"}, seen=True),
    "origin": Screen(noted, "surface", {"colour_by": "origin"}, seen=False),
    "fields": stitched(3, 3, fields=True),
    "fields-plan": stitched(3, 3, fields=True, look="plan"),
    "many-fields": stitched(13, 16, fields=True),
    "many-fields-plan": stitched(13, 16, fields=True, look="plan"),
    "overlap": stitched(3, 3, colour_by="overlap"),
    "compare": Screen(ComparedSession, "surface", seen=True, then=(click("[data-pick=compare-new]"),)),
    "difference": Screen(ComparedSession, "surface", seen=True, then=(click("[data-pick=compare-look]"),)),
    "why": Screen(lambda: explained(True), "surface", seen=True, then=(ask_why,)),
    "why-not": Screen(lambda: explained(False), "surface", seen=True, then=(ask_why,)),
    "measure": measuring(press("Escape")),
    "step": measuring(press("k")),
    "groove": measuring(press("Shift+K")),
    "profile": measuring(press("l")),
    "profiles": measuring(press("l"), press("Shift+L"), press("Shift+H")),
    "profile-corners": measuring(press("l"), press_button("Add corner"), press_button("Add corner")),
    "point": measuring(press("x")),
    "distance": measuring(press("m")),
    "flatness": measuring(press("Shift+F")),
    "angle": measuring(press("b")),
    "radius": measuring(press("r")),
    "volume": measuring(press("v")),
    "die": shaping(press("Shift+W")),
    "kerf": shaping(press("Shift+U")),
    "chipping": shaping(press("Shift+X")),
    "circle": shaping(press("Shift+Y")),
    "coplanarity": shaping(press("Shift+Q")),
    "shapes-kept": shaping(*kept("Shift+W"), *kept("Shift+U"), *kept("Shift+X"), *kept("Shift+Y"), press("Escape")),
    "texture": measuring(press("Shift+T")),
    "sites": measuring(press("Shift+Z"), lambda page: page.wait_for_timeout(3000)),
    "roughness": measuring(press("Shift+J")),
    "results": measuring(*kept("k"), *kept("m"), *kept("r"), *kept("v"), *kept("b"), fly_to_result(3)),
    "levelled": measuring(*kept("x"), press("Shift+F"), read_from("Region")),
    "gauge": gauge(checked),
    "gauge-budget": gauge(checked, bring_into_sight("Uncertainty")),
    "gauge-fail": gauge(lambda: checked(off_um=1.4)),
    "gauge-first": gauge(lambda: GaugeState(certificate=certificate(), terms=TERMS)),
    "gauge-record": gauge(checked, click("tr[data-pick=gauge-record]:nth-child(6)")),
    "gauge-sign": gauge(checked, click("[data-dock-region=right] button:has-text('Sign and save')")),
    "gauge-certificate": gauge(GaugeState, click("[data-dock-region=right] button:has-text('Load the certificate')")),
    "gauge-study": gauge(checked, *study()),
    "gauge-refused": gauge(lambda: GaugeState(certificate=certificate("2026-03-14"), refusal=EXPIRED)),
    "gauge-correct": gauge(correctable, click("[data-dock-region=right] button:has-text('Correct the z scale')")),
    "gauge-watched": Screen(lambda: watching(GaugeSession(checked())), "gauge", then=(see_blocks,)),
    "gauge-empty": Screen(lambda: GaugeSession(with_surface=False), "gauge"),
    "instrument": Screen(calibrated.instrument_session, "gauge", chosen={"instrument": True}),
    "instrument-run": Screen(
        calibrated.instrument_session,
        "gauge",
        chosen={"instrument": True, "calibration": "pixel"},
        then=(press_button("Run here…"),),
    ),
    "instrument-result": Screen(
        lambda: calibrated.instrument_session(calibrated.pending(drift=1.6)), "gauge", chosen={"instrument": True}
    ),
    "review": Screen(noted, "review", seen=True, then=(press("PageDown"),)),
    "review-open": Screen(noted, "review", seen=True, then=(click("[data-pick=review-filter][data-k=open]"),)),
    "review-features": Screen(reviewed_session, "review", seen=True, then=(press("n", "PageDown"),)),
    "review-defects": Screen(inspected_session, "review", seen=True, then=(press("PageDown", "y", "PageDown"),)),
    "review-die": Screen(inspected_session, "review", seen=True, then=(click(COUNT), press(*["Alt+PageDown"] * 2))),
    "review-wafer": Screen(whole_wafer, "review", seen=True, then=(press("PageDown"),)),
    "review-wafer-count": Screen(whole_wafer, "review", seen=True, then=(click(COUNT), press("0"))),
    "review-inspecting": Screen(lambda: inspected_as(work="1"), "review", seen=True),
    "review-stale": Screen(lambda: inspected_as(stale=True), "review", seen=True),
    "review-inspection-failed": Screen(failed, "review", seen=True),
    "review-read-only": Screen(held_elsewhere, "review", seen=True, then=(click("[data-pick=defect-form]"),)),
    "review-defect-form": Screen(
        inspected_session, "review", seen=True, then=(press("PageDown"), click("[data-pick=defect-form]"))
    ),
    "review-scratch": Screen(inspected_session, "review", seen=True, then=(pause,)),
    "review-picture": Screen(inspected_session, "review", seen=True, then=(click("[data-pick=pane][data-k=picture]"),)),
    "review-3d": Screen(inspected_session, "review", seen=True, then=(click("[data-pick=sheet][data-k=none]"), pause)),
    "review-gallery": Screen(whole_wafer, "review", seen=True, then=(press("z"), mark_a_few, pause)),
    "review-filter": Screen(inspected_session, "review", seen=True, then=(click("[data-pick=defect-filter]"),)),
    "review-stack": Screen(
        repeating_session, "review", seen=True, then=(press("Backspace"), pause, press("Backspace"), pause)
    ),
    "review-golden-list": Screen(
        inspected_session, "review", seen=True, then=(click("[data-pick=defect-form]"), with_golden)
    ),
    "review-left-out": Screen(
        inspected_session,
        "review",
        seen=True,
        then=(press("PageDown"), click("[data-pick=defect-excluded][data-k=here]"), pause),
    ),
    "review-export": Screen(inspected_session, "review", seen=True, then=(click("[data-pick=defect-errand]"),)),
    "review-golden": Screen(
        inspected_session, "review", seen=True, then=(click("[data-pick=defect-errand][data-k=golden]"),)
    ),
    "review-recipes": Screen(
        inspected_session, "review", seen=True, then=(click("[data-pick=defect-form]"), press_button("Recipes…"))
    ),
    "review-other-tool": Screen(with_other_tool, "review", seen=True),
    "review-nothing-found": Screen(lambda: inspected_session(0), "review", seen=True),
    "review-not-inspected": Screen(lambda: StitchedSession(3, 3), "review", seen=True),
    "report": Screen(noted, "report", seen=True),
    "report-for-programs": Screen(noted, "report", seen=True, then=(press_button("DFQ"), pause)),
    "trial": operated(operator.tried, "plan", unfold, bring_into_sight("On stored wafers")),
    "feature": operated(operator.tried, "plan", unfold, press_button("Feature…")),
    "report-of-nothing": Screen(lambda: StitchedSession(3, 3), "report", seen=True),
}


def read_only(snapshot: Any) -> Any:
    """A dataset that another program holds."""
    held = dataclasses.replace(snapshot.dataset, read_only="another Wafer Viewer holds it.")
    return dataclasses.replace(snapshot, dataset=held)
