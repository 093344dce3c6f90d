"""A picture of every screen, by one command, to be looked at.

    python -m tests.browser.screens FOLDER [--size 1366x768] [--dark] [--true] [NAME ...]

Without --true the session stands still and holds the contents of a finished day; with it the virtual rig takes the
tour and the pictures show what an operator sees.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from playwright.sync_api import Page, sync_playwright

from tests.browser import fake_session as fake

FLAGS = (
    *("--headless=new", "--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking"),
    *("--disable-component-update", "--disable-sync"),
    *("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
)
"""Chromium without a screen, a graphics card or a network."""
REMEMBERED = "viser-user:wafer-viewer-view"
REST_S = 2.5
"""Pictures are taken when the scene has had time to come to rest."""
SCREENS: dict[str, tuple[Callable[[], fake.Snapshot], str]] = {
    "1-start": (fake.empty, "plan"),
    "2-plan": (fake.planned, "plan"),
    "3-acquire": (fake.scanning, "acquire"),
    "4-unfinished": (fake.unfinished, "acquire"),
    "5-surface": (fake.measured, "surface"),
    "6-measure": (fake.measured, "measure"),
    "7-uncalibrated": (lambda: fake.measured("no calibration was given"), "surface"),
    "8-fault": (fake.at_fault, "plan"),
}
EXPLAINED = {"9-why": True, "10-why-not": False}
"""Screens of a surface that is seen and clicked: whether the pixel asked about is measured."""


STITCHED: dict[str, tuple[tuple[int, int], dict[str, object]]] = {
    "11-fields": ((3, 3), {"fields": True}),
    "12-fields-plan": ((3, 3), {"fields": True, "look": "plan"}),
    "13-many-fields": ((13, 16), {"fields": True}),
    "14-many-fields-plan": ((13, 16), {"fields": True, "look": "plan"}),
    "15-overlap": ((3, 3), {"colour_by": "overlap"}),
    "16-many-overlaps": ((13, 16), {"colour_by": "overlap", "look": "plan"}),
}
"""Screens of a stitched surface: rows and columns of fields, and what the browser remembers."""


def dismiss_viser_warning(page: Page) -> None:
    """Close viser's own notice that the graphics card is missing."""
    page.evaluate(
        "[...document.querySelectorAll('.mantine-Notification-root')]"
        ".filter(n => n.textContent.includes('Software WebGL')).forEach(n => n.querySelector('button').click())"
    )


def remember(page: Page, step: str, dark: bool, **chosen: object) -> None:
    """Have the browser begin in a step, as after a reload."""
    view = json.dumps({"step": step, "dark": dark, **chosen})
    page.add_init_script(f"localStorage.setItem({REMEMBERED!r}, {view!r})")


def still(page: Page, folder: Path, name: str, dark: bool) -> None:
    """The picture of one screen of a session that stands still."""
    from wafer_viewer.gui.app import start

    make, step = SCREENS[name]
    session = fake.FakeSession(make())
    running = start(session)
    remember(page, step, dark)
    page.goto(running.address)
    page.locator(".wv-title").first.wait_for()
    if step == "measure":
        page.keyboard.press("k")
    take(page, folder / f"{name}.png")
    page.goto("about:blank")
    running.stop()


def explained(page: Page, folder: Path, name: str, dark: bool) -> None:
    """The picture of a click on the surface, and of what it says when it is asked why."""
    from tests.browser.seen_session import SeenSession, a_focus_curve, came_to
    from wafer_viewer.gui.app import start

    session = SeenSession()
    session.answers.append(came_to(a_focus_curve(-12.4, 37.0, EXPLAINED[name])))
    running = start(session)
    remember(page, "surface", dark)
    page.goto(running.address)
    page.locator("[data-floating-window]", has_text="Height").wait_for()
    take(page, folder / f"{name}-before.png")
    ask_why(page)
    take(page, folder / f"{name}.png")
    page.goto("about:blank")
    running.stop()
    session.close()


def stitched(page: Page, folder: Path, name: str, dark: bool) -> None:
    """The picture of a stitched surface, with how its fields were placed."""
    from tests.browser.stitched_session import StitchedSession
    from wafer_viewer.gui.app import start

    (rows, cols), chosen = STITCHED[name]
    session = StitchedSession(rows, cols)
    running = start(session)
    remember(page, "surface", dark, **chosen)
    page.goto(running.address)
    page.locator("[data-floating-window] .wv-glass", has_text="not measured").wait_for()
    bring_into_sight(page, "Stitching")
    take(page, folder / f"{name}.png", 2 * REST_S)
    page.goto("about:blank")
    running.stop()
    session.close()


def bring_into_sight(page: Page, head: str) -> None:
    """Scroll the right panel to a section."""
    page.locator("[data-dock-region=right] .wv-h", has_text=head).first.evaluate(
        "head => head.scrollIntoView({block: 'center'})"
    )


def ask_why(page: Page) -> None:
    """Click the middle of the scene and ask."""
    box = page.locator("canvas").first.bounding_box()
    if box is not None:
        page.mouse.click(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    page.locator("[data-pick=why]").click()
    page.locator(".wv-patch img").wait_for()


def tour(page: Page, folder: Path, dark: bool) -> None:
    """The pictures of a tour on the virtual rig."""
    from wafer_viewer.gui.app import start
    from wafer_viewer.session.session import Session

    with tempfile.TemporaryDirectory() as data:
        session = Session(Path(data))
        running = start(session)
        try:
            remember(page, "plan", dark)
            page.goto(running.address)
            session.wait_until(lambda now: now.rig.state == "ready", 60)
            take(page, folder / "1-start.png")
            page.locator("[data-pick=tour]").click()
            session.wait_until(lambda now: now.scan is not None and now.scan.frames_done > 250, 120)
            take(page, folder / "2-acquire.png")
            session.wait_until(lambda now: now.surface_is_whole, 240)
            take(page, folder / "3-done.png")
            for key, step in (("4-plan", "Plan"), ("5-surface", "Surface")):
                page.locator("button", has_text=step).first.click()
                take(page, folder / f"{key}.png", 4 * REST_S)
            page.keyboard.press("o")
            bring_into_sight(page, "Stitching")
            take(page, folder / "5-surface-fields.png", 4 * REST_S)
            page.get_by_role("button", name="Measure this surface").click()
            take(page, folder / "6-profile.png", 4 * REST_S)
            page.locator("[data-pick=tool][data-k=step]").click()
            take(page, folder / "7-step.png", 4 * REST_S)
            ask_why(page)
            take(page, folder / "8-why.png", 4 * REST_S)
        finally:
            page.goto("about:blank")
            running.stop()
            session.close()


def take(page: Page, path: Path, rest_s: float = REST_S) -> None:
    """Wait for the page to come to rest and take its picture."""
    time.sleep(rest_s)
    dismiss_viser_warning(page)
    time.sleep(0.5)
    page.screenshot(path=path, timeout=120_000)
    print(path)


def main() -> int:
    """Take the pictures asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("names", nargs="*", default=[*SCREENS, *EXPLAINED, *STITCHED])
    parser.add_argument("--size", default="1600x1000")
    parser.add_argument("--dark", action="store_true")
    parser.add_argument("--true", action="store_true")
    asked = parser.parse_args()
    asked.folder.mkdir(parents=True, exist_ok=True)
    width, height = (int(side) for side in asked.size.split("x"))
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=FLAGS)
        for name in ["tour"] if asked.true else asked.names:
            page = browser.new_context(viewport={"width": width, "height": height}).new_page()
            page.set_default_timeout(45_000)
            if asked.true:
                tour(page, asked.folder, asked.dark)
            elif name in STITCHED:
                stitched(page, asked.folder, name, asked.dark)
            elif name in EXPLAINED:
                explained(page, asked.folder, name, asked.dark)
            else:
                still(page, asked.folder, name, asked.dark)
            page.context.close()
        browser.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
