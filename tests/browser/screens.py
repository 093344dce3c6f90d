"""A picture of every screen, by one command, to be looked at.

    python -m tests.browser.screens FOLDER [--size 1366x768] [--dark] [--true] [--only NAME ...]

Without --true sessions stand still and hold the contents of a finished day (`screen_list`); with it the virtual rig
takes the tour and the pictures show what an operator sees.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
import tempfile
import time
from pathlib import Path

from playwright.sync_api import Page, sync_playwright

FLAGS = (
    *("--headless=new", "--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking"),
    *("--disable-component-update", "--disable-sync"),
    *("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
    "--disable-features=WebUIOmniboxPopup,WebUIOmniboxAimPopup,HttpsUpgrades,MediaRouter,OptimizationHints,PaintHolding",
)
"""Chromium without a screen, a graphics card or a network.

Every window would load two pages of its own for its address bar, for almost half of what the program's page takes.
The flag replaces Playwright's own: of the features that it switches off, those that a page could notice are named too.
"""
REMEMBERED = "viser-user:wafer-viewer-view"
DRAWN = ".wv-glass:has-text('not measured'):visible, .wv-sheet-foot:visible"
"""In sight once a surface is drawn: its legend, or what lies over it."""
REST_S = 2.5
"""Pictures are taken when the scene has had time to come to rest."""


def remember(page: Page, step: str, dark: bool, **chosen: object) -> None:
    """Have the browser begin in a step, as after a reload."""
    view = json.dumps({"step": step, "dark": dark, "theme_chosen": True, **chosen})
    page.add_init_script(f"localStorage.setItem({REMEMBERED!r}, {view!r})")


def picture(page: Page, folder: Path, name: str, dark: bool) -> None:
    """The picture of one screen of the list."""
    from tests.browser.screen_list import SCREENS
    from wafer_viewer.gui.app import start

    screen = SCREENS[name]
    session = screen.session()
    running = start(session)
    try:
        remember(page, screen.step, dark, **screen.chosen)
        page.goto(running.address)
        page.locator(".wv-title").first.wait_for()
        if screen.seen:
            page.locator(DRAWN).first.wait_for()
        for act in screen.then:
            act(page)
        take(page, folder / f"{name}.png", 2 * REST_S if screen.seen else REST_S)
    finally:
        page.goto("about:blank")
        running.stop()
        if screen.seen:
            session.close()


def tour(page: Page, folder: Path, dark: bool) -> None:
    """The pictures of a tour on the virtual rig."""
    from tests.browser.screen_list import ask_why, bring_into_sight
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
            page.get_by_role("button", name="Start scan").last.click()
            session.wait_until(lambda now: now.scan is not None and now.scan.frames_done > 250, 120)
            take(page, folder / "2-acquire.png")
            session.wait_until(lambda now: now.surface_is_whole, 240)
            take(page, folder / "3-done.png")
            for key, step in (("4-plan", "Plan"), ("5-surface", "Surface")):
                page.get_by_role("button", name=step, exact=True).first.click()
                take(page, folder / f"{key}.png", 4 * REST_S)
            page.keyboard.press("o")
            bring_into_sight("Stitching")(page)
            take(page, folder / "5-surface-fields.png", 4 * REST_S)
            page.keyboard.press("o")
            page.get_by_role("button", name="Measure this surface").click()
            take(page, folder / "6-profile.png", 4 * REST_S)
            page.keyboard.press("k")
            take(page, folder / "7-step.png", 4 * REST_S)
            page.get_by_role("button", name="Keep result").click()
            session.wait_until(lambda now: bool(now.findings), 60)
            page.keyboard.press("Shift+R")
            take(page, folder / "8-review.png", 4 * REST_S)
            page.keyboard.press("Shift+O")
            take(page, folder / "8-report.png", 2 * REST_S)
            page.keyboard.press("Shift+M")
            ask_why(page)
            take(page, folder / "9-why.png", 4 * REST_S)
        finally:
            page.goto("about:blank")
            running.stop()
            session.close()


def take(page: Page, path: Path, rest_s: float = REST_S) -> None:
    """Wait for the page to come to rest and take its picture."""
    time.sleep(rest_s)
    page.screenshot(path=path, timeout=120_000)
    print(path, flush=True)


def main() -> int:
    """Take the pictures asked for."""
    from tests.browser.screen_list import SCREENS

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--only", nargs="+", default=list(SCREENS), choices=SCREENS, metavar="NAME")
    parser.add_argument("--size", default="1600x1000")
    parser.add_argument("--dark", action="store_true")
    parser.add_argument("--true", action="store_true")
    asked = parser.parse_args()
    asked.folder.mkdir(parents=True, exist_ok=True)
    width, height = (int(side) for side in asked.size.split("x"))
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=FLAGS)
        for name in ["tour"] if asked.true else asked.only:
            page = browser.new_context(viewport={"width": width, "height": height}).new_page()
            page.set_default_timeout(60_000)
            tour(page, asked.folder, asked.dark) if asked.true else picture(page, asked.folder, name, asked.dark)
            page.context.close()
        browser.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
