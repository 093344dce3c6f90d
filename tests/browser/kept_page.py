"""One page of a run, shown one session after the other: viser's client comes back to a program that starts anew.

Opening a page costs the browser two thirds of what most tests take, to read and compile viser's client. A kept page is
given another program at its address instead: whatever the program made is made anew, and this file sees to the rest.
"""

from __future__ import annotations

import itertools
import json
import os
import re
import socket
from typing import Any

from playwright.sync_api import BrowserContext, Page, TimeoutError

from tests.browser.screens import REMEMBERED
from tests.browser.sessions.fake_session import FakeSession, empty
from wafer_viewer.gui.app import Running, start

SMALL_PICTURE = """
for (const side of ['width', 'height']) {
  const own = Object.getOwnPropertyDescriptor(HTMLCanvasElement.prototype, side);
  Object.defineProperty(HTMLCanvasElement.prototype, side, {
    ...own,
    get() { return this.ofScene?.[side] ?? own.get.call(this); },
    set(px) {
      if (this.ofScene) this.ofScene[side] = px;
      own.set.call(this, this.ofScene ? Math.min(px, 16) : px);
    },
  });
}
const getContext = HTMLCanvasElement.prototype.getContext;
HTMLCanvasElement.prototype.getContext = function (kind, ...rest) {
  if (kind.startsWith('webgl') && !this.ofScene) {
    const { width, height } = this;
    this.ofScene = {};
    Object.assign(this, { width, height });
  }
  return getContext.call(this, kind, ...rest);
};
for (const name of ['drawArrays', 'drawArraysInstanced', 'drawElements', 'drawElementsInstanced']) {
  const draw = WebGL2RenderingContext.prototype[name];
  WebGL2RenderingContext.prototype[name] = function (...given) {
    if (window.drawsScene) draw.apply(this, given);
  };
}
"""
"""The scene has few pixels, scaled to its place, and nothing is drawn into it: tests read the page.

A software's drawing of a surface costs as much as the rest of the page. Whoever asks the canvas for its size hears the
one that it was given: the panel below the scene follows it.
"""
DRAW = "window.drawsScene = true"
"""For a test that looks at the picture of the scene; until the page is loaded again or shows another session."""
PATIENCE_MS = 120_000
"""A machine without a graphics card draws slowly; no test waits that long where it does not have to."""
CLOSING_MS = 20_000
"""Windows of the program before close a while after that of the next is there, on a busy machine."""
FIRST_PORT, N_PORTS = 20_000, 10_000
"""Below those that the system gives away by itself: nobody takes the port while no program is there."""
_PAGES = itertools.count()
"""Each page has a port of its own: one that waits for its program must not come to that of another."""
AWAY = "document.hasFocus = () => false; window.dispatchEvent(new Event('blur'))"
"""viser's client tries to connect again only in a window that has the focus."""
ITSELF = "viser-user:wafer-viewer-browser"
FORGET = f"""kept => {{
  const itself = localStorage.getItem('{ITSELF}');
  localStorage.clear();
  if (kept && itself) localStorage.setItem('{ITSELF}', itself);
  sessionStorage.clear();
  document.activeElement?.blur();
  scrollTo(0, 0);
  window.drawsScene = false;
  return document.querySelector('.wv-contact')?.dataset.page;
}}"""
"""Forget what the browser has kept, but not which browser it is: a session waits 20 s for the one with the control."""
AGAIN = "document.hasFocus = () => true; window.dispatchEvent(new Event('focus'))"
# The bar of a lost contact is there from the first loss on that the page notices.
IS_NEW = """before => {
  const bar = document.querySelector('.wv-bar-over'), contact = document.querySelector('.wv-contact');
  if (bar?.classList.contains('back')) bar.click();
  for (const note of document.querySelectorAll('.mantine-Notification-closeButton')) note.click();
  return contact && contact.dataset.page !== before && !bar?.classList.contains('on') &&
    document.querySelector('.wv-title') && !document.querySelector('.mantine-Notification-root');
}"""
LEFT_OPEN = """() => {
  const all = [...document.querySelectorAll('[role=dialog], [role=tooltip]')];
  return all.filter(e => e.checkVisibility({ opacityProperty: true, visibilityProperty: true })).map(e => e.outerHTML);
}"""


REMEMBER_INPUT = """
window.inputs = [];
for (const kind of ['pointerdown', 'pointerup', 'click', 'keydown', 'focusin']) {
  document.addEventListener(kind, event => {
    const at = event.target, text = (at.textContent || at.value || '').trim().slice(0, 40);
    window.inputs.push(`${Math.round(performance.now())} ms ${kind} ${event.key ?? ''} ${at.tagName} "${text}"`);
    window.inputs.splice(0, window.inputs.length - 40);
  }, true);
}
"""
ON_THE_PAGE = """() => {
  const seen = [...document.querySelectorAll('[role=dialog], .wv-note, .mantine-Notification-root, .wv-bar-over.on')];
  const what = at => `${at.className || at.tagName}: ${at.innerText.trim().slice(0, 300)}`;
  return [`now ${Math.round(performance.now())} ms`, ...(window.inputs ?? []), 'in focus ' +
    document.activeElement?.outerHTML.slice(0, 200), ...seen.map(what)].join('\\n');
}"""
"""What was pressed and typed, and what lies over the page: for the report of a test that failed."""


def a_page(context: BrowserContext, script: str = SMALL_PICTURE) -> Page:
    """A page with a small picture, not drawn."""
    context.add_init_script(script)
    context.add_init_script(REMEMBER_INPUT)
    page = context.new_page()
    page.set_default_timeout(PATIENCE_MS)
    return page


class KeptPage:
    """A page that stays open while sessions come and go; `show` one, then `leave` it."""

    def __init__(self, page: Page, parameters: str = "") -> None:
        self.page, self._size = page, page.viewport_size
        self._parameters = parameters
        self._running: Running | None = None
        self._session: Any = None
        self._address = ""

    def show(self, session: Any, **remembered: object) -> Page:
        """Serve a session at the page's address, and wait until it is there as on a page that was just opened.

        remembered: what the browser has kept of its view, as after a reload.
        """
        if not self._address:
            self._open()
        self.leave()
        port, token = re.findall(r":(\d+)/.*token=(\S+)", self._address)[0]
        if self.page.viewport_size != self._size:
            self.page.set_viewport_size(self._size)
        self.page.mouse.move(-1, -1)
        before = self.page.evaluate(FORGET, session is self._session)
        self._session = session
        if remembered:
            self.page.evaluate("view => localStorage.setItem(...view)", [REMEMBERED, json.dumps(remembered)])
        self._running = start(session, port=int(port), token=token)
        self.page.evaluate(AGAIN)
        self.page.wait_for_function(IS_NEW, arg=before)
        try:
            self.page.wait_for_function(f"() => !({LEFT_OPEN})().length", timeout=CLOSING_MS)
        except TimeoutError as fault:
            left = self.page.evaluate(LEFT_OPEN)
            raise AssertionError(f"A test before this one left open: {left}") from fault
        return self.page

    def _open(self) -> None:
        """Load the page, of a session of its own: the first browser of a session gets the controls."""
        self._running = start(FakeSession(empty()), port=_free_port())
        self._address = self._running.address
        self.page.goto(self._address + self._parameters)
        self.page.locator(".wv-contact").wait_for(state="attached")
        self.page.locator(".wv-title").first.wait_for()

    def leave(self) -> None:
        """End the program behind the page; the page waits for the next."""
        for other in self.page.context.pages:
            if other is not self.page:
                other.close()
        self.page.evaluate(AWAY)
        self.stop()

    def stop(self) -> None:
        """End the program behind the page, which looks for it."""
        if self._running is not None:
            self._running.stop()
            self._running = None


def _free_port() -> int:
    """A port that nobody listens at; other runs at the same time begin their search elsewhere."""
    port = FIRST_PORT + (os.getpid() + 1000 * next(_PAGES)) % N_PORTS
    with socket.socket() as trial:
        while trial.connect_ex(("127.0.0.1", port)) == 0:
            port += 1
    return port
