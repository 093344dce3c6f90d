"""The audit of the page: every state of `audit_states` looked over at sizes of the window, light and dark.

    [WAFER_VIEWER_CAMPAIGNS=all] python -m tests.browser.audit [GROUP ...] [--pictures FOLDER]

A look (audit.js) waits until the panels are at rest, judges the page, turns it to the colours of the other theme and
judges the contrasts again. That turning by colours alone is the page's own is checked in every group.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from unittest.mock import patch

from playwright.sync_api import Browser, ConsoleMessage, Error, Page, sync_playwright

from tests.browser.kept_page import SMALL_PICTURE, KeptPage, a_page
from tests.browser.screens import FLAGS
from tests.support.campaigns import drawn_cases
from wafer_viewer.gui.scene.surface_tiles import MOST_TILES

NARROWEST = (1024, 768)
SIZES = (1366, 768), (1280, 720), (1600, 900), (2560, 1440)
"""An ordinary run draws one of these for a state."""
LOOK = (Path(__file__).parent / "audit.js").read_text()
STEADY = "&fixedDpr=1"
"""viser's own parameter: it would draw coarser on a busy machine, and panels follow the pixels of the scene."""
LOOKS, AGAIN_MS = 6, 300
"""What is found must be found again: names.js names an input a moment after it came."""
INK = {False: "rgb(21, 32, 43)", True: "rgb(233, 238, 243)"}
"""Colour of the program's name, light and dark."""


Themes = tuple[Any, Any]
"""The colours of the page, light and dark, as audit.js reads them."""


@dataclass
class Visit:
    """A page that is looked over, with the session behind it, and what its console complains of."""

    kept: KeptPage
    session: Any
    errors: list[str] = field(default_factory=list)

    @property
    def page(self) -> Page:
        return self.kept.page


Act = Callable[[Visit], None]


@dataclass(frozen=True)
class State:
    """A state of the page. act: how to come to it from the one before; until: selector of what is there then."""

    name: str
    act: Act | None = None
    until: str = ".wv-title"


@dataclass(frozen=True)
class Group:
    """States that one page of one session goes through, in order."""

    session: Callable[[], Any]
    step: str
    states: tuple[State, ...]


@contextmanager
def page_to_audit(browser: Browser, *, scene: bool = False) -> Iterator[KeptPage]:
    """A page for one group after the other; without its scene a surface is as coarse as it can be, and not drawn."""
    width, height = SIZES[0]
    coarse = {} if scene else dict.fromkeys(MOST_TILES, 1)
    size = {"width": width, "height": height}
    with (
        patch.dict(MOST_TILES, coarse),
        browser.new_context(viewport=size, reduced_motion="reduce") as context,
    ):
        yield KeptPage(a_page(context, "" if scene else SMALL_PICTURE), STEADY)


@contextmanager
def opened(kept: KeptPage, group: Group) -> Iterator[Visit]:
    """The page of a group's session."""
    session = group.session()
    visit = Visit(kept, session)

    def said(words: ConsoleMessage) -> None:
        if words.type == "error":
            visit.errors.append(words.text)

    def failed(fault: Error) -> None:
        visit.errors.append(str(fault))

    try:
        page = kept.show(session, step=group.step, dark=False)
        page.on("console", said)
        page.on("pageerror", failed)
        page.evaluate(LOOK)
        yield visit
    finally:
        kept.page.remove_listener("console", said)
        kept.page.remove_listener("pageerror", failed)
        kept.page.evaluate("window.wvAudit?.turnBack()")
        kept.leave()
        if "close" in dir(session):
            session.close()


def come_to(visit: Visit, state: State) -> None:
    """Bring the page to a state."""
    if state.act is not None:
        state.act(visit)
    visit.page.locator(state.until).first.wait_for()


def turn(page: Page, dark: bool) -> None:
    """Have the page turn itself light or dark."""
    page.locator("[data-pick=theme]").evaluate("switcher => switcher.click()")
    page.wait_for_function("c => getComputedStyle(document.querySelector('.wv-mark')).color === c", arg=INK[dark])


def both_themes(page: Page) -> tuple[Themes, list[str]]:
    """Return the colours of the page light and dark, and texts that have others when it is only given those."""
    light = page.evaluate("wvAudit.theme()")
    turn(page, True)
    page.evaluate("wvAudit.rest()")
    dark, own = page.evaluate("[wvAudit.theme(), wvAudit.colours()]")
    turn(page, False)
    page.evaluate("wvAudit.rest()")
    given = page.evaluate("dark => wvAudit.coloursTurned(dark)", dark)
    both = own.keys() & given.keys()  # numbers may still come in
    differs = [f"theme: {text} is {own[text]}, here {given[text]}" for text in both if given[text] != own[text]]
    return (light, dark), differs


def sizes_of(state: str) -> list[tuple[int, int]]:
    """The narrowest window and those of the others that are drawn."""
    return [NARROWEST, *drawn_cases(SIZES, lambda size: f"{state} at {size[0]}")]


def look(page: Page, sizes: Iterable[tuple[int, int]], themes: Themes) -> Iterator[tuple[str, str]]:
    """What one look finds at each size of the window: where, and what."""
    for width, height in sizes:
        page.set_viewport_size({"width": width, "height": height})
        for _ in range(LOOKS):
            is_dark, (here, turned) = _look_once(page, themes)
            if not here and not turned:
                break
            page.wait_for_timeout(AGAIN_MS)
        names = f"{width}{' dark' if is_dark else ''}", f"{width}{'' if is_dark else ' dark'}"
        yield from ((names[0], what) for what in here)
        yield from ((names[1], what) for what in turned)


def _look_once(page: Page, themes: Themes) -> tuple[bool, tuple[list[str], list[str]]]:
    return page.evaluate(
        """async themes => {
             const dark = document.documentElement.dataset.mantineColorScheme === 'dark';
             return [dark, await wvAudit.look(themes[dark ? 0 : 1])];
           }""",
        themes,
    )


def look_over(kept: KeptPage, group: Group) -> dict[str, list[str]]:
    """Return all that was found in a group, with the states and sizes where."""
    found: dict[str, list[str]] = {}
    with opened(kept, group) as visit:
        themes, differs = both_themes(visit.page)
        found |= {what: [group.states[0].name] for what in differs}
        for state in group.states:
            visit.page.evaluate("light => wvAudit.turn(light)", themes[0])  # what is new is drawn as the page is
            try:
                come_to(visit, state)
            except Error as fault:
                found.setdefault(f"state: it was not reached, {str(fault).splitlines()[0]}", []).append(state.name)
                continue
            for where, what in look(visit.page, sizes_of(state.name), themes):
                found.setdefault(what, []).append(f"{state.name} at {where}")
        for error in visit.errors:
            found.setdefault(f"console: {error}", []).append("console")
    return found


def take_pictures(kept: KeptPage, group: Group, folder: Path) -> None:
    """A picture of every state of a group, light and dark, in the first of the sizes."""
    folder.mkdir(parents=True, exist_ok=True)
    with opened(kept, group) as visit:
        themes, _ = both_themes(visit.page)
        for n, state in enumerate(group.states):
            try:
                come_to(visit, state)
            except Error as fault:
                print(f"{state.name}: {fault}", flush=True)
                continue
            visit.page.evaluate("wvAudit.rest()")
            visit.page.wait_for_timeout(700)
            for name, colours in zip(("dark", "light"), themes[::-1], strict=True):
                visit.page.evaluate("colours => wvAudit.turn(colours)", colours)
                visit.page.screenshot(path=folder / f"{n:02d} {state.name} {name}.png")


def main() -> None:
    """Print what the audit finds, group by group."""
    from tests.browser.audit_states import GROUPS
    from tests.browser.conftest import LIGHT

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("groups", nargs="*", default=list(GROUPS), metavar="GROUP")
    parser.add_argument("--pictures", type=Path, metavar="FOLDER", help="take a picture of every state instead")
    asked = parser.parse_args()
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=[*FLAGS, *LIGHT])
        with page_to_audit(browser, scene=asked.pictures is not None) as kept:
            for name in asked.groups:
                if asked.pictures is not None:
                    take_pictures(kept, GROUPS[name], asked.pictures / name)
                    continue
                began = time.monotonic()
                for what, where in sorted(look_over(kept, GROUPS[name]).items()):
                    print(f"{what}   [{', '.join(dict.fromkeys(where))}]")
                print(f"== {name}: {len(GROUPS[name].states)} states, {time.monotonic() - began:.0f} s", flush=True)
        browser.close()


if __name__ == "__main__":
    sys.exit(main())
