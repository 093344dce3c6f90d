"""Pad that drives the stage: the digits as on a keypad, held keys jog, steps and clicks; its script and its words."""

from __future__ import annotations

import threading
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Any

import viser
from markupsafe import Markup

from wafer_viewer.draw.number_format import with_unit
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.widgets import html

STEPS_UM = (5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0)
"""Steps in x and y."""
Z_SHARE = 1 / 50
"""Step in z as a share of that in x and y: a field is about fifty depths of field wide."""
FAST = 10
"""Factor with Shift."""
JOG_STEPS_S = 4.0
"""Steps in a second of a jog."""
NOT_MOVED = "The stage did not move"
_ICON = viser.Icon
KEYS: tuple[tuple[int, str, Any, str], ...] = (
    (7, "Step ÷", _ICON.MINUS, "step"),
    (8, "Y +", _ICON.ARROW_UP, "xy"),
    (9, "Z up", _ICON.ARROW_BAR_TO_UP, "z"),
    (4, "X \u2212", _ICON.ARROW_LEFT, "xy"),
    (5, "Focus", _ICON.FOCUS_CENTERED, "focus"),
    (6, "X +", _ICON.ARROW_RIGHT, "xy"),
    (1, "Step ×", _ICON.PLUS, "step"),
    (2, "Y \u2212", _ICON.ARROW_DOWN, "xy"),
    (3, "Z down", _ICON.ARROW_BAR_TO_DOWN, "z"),
)
"""Digit, name, icon and kind, in the order of a keypad."""


@dataclass(frozen=True, slots=True)
class JogWord:
    """Word of the script: number of the press, direction of each axis, and whether Shift is held."""

    hold: int
    x: int
    y: int
    z: int
    fast: bool


def parse_word(key: str) -> JogWord:
    """Parse the word of a held key."""
    hold, x, y, z, fast = (int(part) for part in key.split(","))
    return JogWord(hold, x, y, z, bool(fast))


def parse_step(key: str) -> JogWord:
    """Parse the word of a tapped key."""
    return parse_word(f"0,{key}")


def next_step_um(step_um: float, by: int) -> float:
    """Return the next larger or smaller step."""
    nearest = min(range(len(STEPS_UM)), key=lambda k: abs(STEPS_UM[k] - step_um))
    return STEPS_UM[min(max(nearest + by, 0), len(STEPS_UM) - 1)]


def distances_um(word: JogWord, step_um: float) -> tuple[float, float, float]:
    """Return the step of a word along x, y and z in um."""
    along = step_um * (FAST if word.fast else 1)
    return word.x * along, word.y * along, word.z * along * Z_SHARE


def pad_html() -> Markup:
    """Return the pad. It stays the same, so that it keeps the focus."""
    keys = Markup("").join(
        Markup('<span class="wv-key {kind}" data-n="{n}"><kbd>{n}</kbd>{icon}<b>{name}</b></span>').format(
            kind=kind, n=n, icon=html.icon(sign, 18), name=name
        )
        for n, name, sign, kind in KEYS
    )
    return Markup(
        '<div class="wv-pad" role="application" tabindex="0" aria-label="Drive the stage: the digits as on a keypad; '
        'Escape leaves" data-needs-control>{}</div>'
    ).format(keys)


def step_words(step_um: float) -> Markup:
    """Return the steps, and what Shift and a held key do."""
    return Markup(
        '<div class="wv-steps"><span>Step, X and Y<b>{}</b></span><span>Step, Z<b>{}</b></span>'
        "<small><kbd>Shift</kbd> ten times. Hold a key: it jogs, and stops when you let go.</small></div>"
    ).format(with_unit(step_um, 0), with_unit(step_um * Z_SHARE, 1))


class JogPad:
    """Words of the pad's script to commands of the session; a word that is overtaken by a later one is dropped."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._lock = threading.Lock()
        self._hold = 0
        """Latest press; words of an earlier one come late."""
        self._released = False
        page.on_pick("live-jog", self._jog)
        page.on_pick("live-step", self._step)
        page.on_pick("live-smaller", lambda _: self._resize(-1))
        page.on_pick("live-larger", lambda _: self._resize(1))
        page.on_pick("live-watch", self._watch)
        page.on_close(self._let_go)

    def _jog(self, key: str) -> None:
        word = parse_word(key)
        at_rest = not (word.x or word.y or word.z)
        with self._lock:
            if word.hold < self._hold or (word.hold == self._hold and self._released):
                return
            self._hold, self._released = word.hold, at_rest
            step_um = self._page.view.jog_step_um
            speeds = (JOG_STEPS_S * um for um in distances_um(word, step_um))
            answer = self._page.session.live.jog(word.hold, *speeds)
        self._page.ask(NOT_MOVED, answer)

    def _step(self, key: str) -> None:
        step = distances_um(parse_step(key), self._page.view.jog_step_um)
        self._page.ask(NOT_MOVED, self._page.session.live.step(*step))

    def _resize(self, by: int) -> None:
        self._page.change(jog_step_um=next_step_um(self._page.view.jog_step_um, by))

    def _watch(self, _: str) -> None:
        """Keep the view on; a browser that only looks on sees it while the holder of the controls does."""
        page = self._page
        if page.session.snapshot.control.holds(page.browser.key):
            page.ask("The live view did not begin", page.session.live.watch())

    def _let_go(self) -> None:
        """Stop a jog of a page that closes."""
        with self._lock:
            if self._hold and not self._released:
                self._released = True
                answer: Future[None] = self._page.session.live.jog(self._hold, 0.0, 0.0, 0.0)
                answer.add_done_callback(lambda done: done.exception())
