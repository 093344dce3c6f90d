"""The true viewer in a process of its own and a browser before it, for the page's benchmarks.

What is seen is judged by the frames that the browser shows, sent small as they come: reading the canvas in the page
would make it wait for every drawing.
"""

from __future__ import annotations

import base64
import io
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import psutil
from numpy.typing import NDArray
from PIL import Image
from playwright.sync_api import BrowserContext, Error, Page, TimeoutError, sync_playwright

from tests.browser.screens import FLAGS, remember
from wafer_viewer.session.rendering.render_process import NICENESS

ROOT = Path(__file__).parents[2]
SIZE = {"width": 1600, "height": 1000}
QUIET_S, PATIENCE_S = 1.2, 40.0
"""The scene is settled when nothing has changed for so long."""
STRAY_BYTES = 3000
"""What is sent of itself: the time, a position."""
COLOURED, CHANGED = 0.04, 0.004
"""Shares of the scene's middle: from the first on there is a picture; up to the second it counts as the same."""
SMALL_PX = 400
"""Width of the frames that are looked at."""
CHROMA, STEP = 26, 24
"""Levels: what is as colourful as that is the surface; what changes by more has changed."""
WATCH = """
const make = window.Worker;
window.Worker = class extends make {
  constructor(...args) { super(...args); window.connectedAt ??= performance.now(); }
};
window.answers = [];
let asked = null;
addEventListener('pointerdown', () => { asked = [performance.now(), document.querySelector('.wv-read')?.textContent]; },
                 true);
setInterval(() => {
  const text = document.querySelector('.wv-read')?.textContent;
  if (asked && text && text !== asked[1]) { window.answers.push(performance.now() - asked[0]); asked = null; }
}, 5);
"""
TURN = """({x, y, by, times}) => {
  const scene = document.querySelector('canvas[data-engine]');
  const turn = {clientX: x, clientY: y, deltaY: by, bubbles: true, cancelable: true};
  for (let n = 0; n < times; n++) scene.dispatchEvent(new WheelEvent('wheel', turn));
}"""


@dataclass(frozen=True, slots=True)
class Memory:
    """Of the viewer's process and of its painters together: bytes that are theirs alone (USS)."""

    viewer: int
    painters: int


class Viewer:
    """A viewer that serves a folder of datasets; its log is a file of its own."""

    def __init__(self, data: Path) -> None:
        self.log = Path(tempfile.mkdtemp(prefix="wafer-viewer-bench-")) / "viewer.log"
        environment = {**os.environ, "WAFER_VIEWER_LOG": str(self.log), "PYTHONPATH": str(ROOT)}
        command = [sys.executable, "-m", "wafer_viewer", "serve", "--data", str(data), "--port", "0"]
        self._errors = self.log.with_name("errors.txt").open("w+")
        self.process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=self._errors, env=environment, text=True, cwd=self.log.parent
        )
        told = self.process.stdout.readline() if self.process.stdout else ""
        found = re.search(r"http://\S+", told)
        if found is None:
            raise SystemExit(f"The viewer does not start: {told}{self.complaints()}")
        self.address = found.group()
        self.port = int(self.address.rsplit(":", 1)[1].split("/")[0])
        self._own = psutil.Process(self.process.pid)

    def close(self) -> None:
        self.process.terminate()
        try:
            self.process.wait(20)
        except subprocess.TimeoutExpired:
            self.process.kill()
        self._errors.close()
        shutil.rmtree(self.log.parent, ignore_errors=True)

    def complaints(self) -> str:
        """What went wrong: the log, and what stands on the error stream."""
        self._errors.flush()
        told = [path.read_text() for path in (self.log, Path(self._errors.name)) if path.exists()]
        return "".join(told)

    def memory(self) -> Memory:
        """What belongs to the viewer alone, and to the painters it started."""
        niceness = self._own.nice() + NICENESS  # as the host of the workers has, under which they live
        painters = [p for p in self._own.children() if p.nice() == niceness and not p.children()]
        return Memory(self._own.memory_full_info().uss, sum(p.memory_full_info().uss for p in painters))

    def cpu_s(self) -> float:
        """Processor seconds of the viewer's own process so far."""
        times = self._own.cpu_times()
        return times.user + times.system

    def bytes_sent(self) -> int:
        """Bytes sent on the connections that are open now."""
        told = subprocess.run(
            ["ss", "-tinH", "state", "established", f"sport = :{self.port}"], capture_output=True, text=True, check=True
        )
        return sum(int(n) for n in re.findall(r"bytes_sent:(\d+)", told.stdout))


@dataclass(frozen=True, slots=True)
class Look:
    """A frame that was shown: the browser's time, shares of the scene's middle that are coloured and that changed."""

    at_ms: float
    coloured: float
    changed: float


class Watch:
    """Looks at the middle of the scene in every frame that a page shows."""

    def __init__(self, page: Page) -> None:
        self.looks: list[Look] = []
        self._before: NDArray[np.int16] | None = None
        self._channel = page.context.new_cdp_session(page)
        self._channel.on("Page.screencastFrame", self._frame)
        size = {"maxWidth": SMALL_PX, "maxHeight": SMALL_PX}
        self._channel.send("Page.startScreencast", {"format": "jpeg", "quality": 70, **size})

    def _frame(self, event: dict[str, Any]) -> None:
        with suppress(Error):  # the page closes while its last frame is on the way
            self._channel.send("Page.screencastFrameAck", {"sessionId": event["sessionId"]})
        picture = np.asarray(Image.open(io.BytesIO(base64.b64decode(event["data"]))).convert("RGB"), np.int16)
        rows, cols = picture.shape[:2]
        # Between the panels on both sides, and clear of what lies on glass over the scene.
        middle = picture[int(0.25 * rows) : int(0.75 * rows), int(0.28 * cols) : int(0.62 * cols)]
        coloured = np.ptp(middle, axis=2) > CHROMA
        same = self._before is not None and self._before.shape == middle.shape  # not while the window gets its size
        before = self._before if same else middle
        changed = np.abs(middle - before).sum(axis=2) > STEP
        self._before = middle
        self.looks.append(Look(1e3 * event["metadata"]["timestamp"], float(coloured.mean()), float(changed.mean())))


class Seat:
    """A browser before the viewer, with what it sees; `context` keeps what it remembers over a reload."""

    def __init__(self, context: BrowserContext, viewer: Viewer) -> None:
        self.viewer, self._context = viewer, context
        context.add_init_script(WATCH)
        self.page = self._new_page()
        remember(self.page, "surface", False)

    def open(self) -> None:
        """Go to the page."""
        self.page.goto(self.viewer.address)

    def leave(self) -> None:
        """Close the page and get another."""
        self.page.close()
        self.page = self._new_page()

    def _new_page(self) -> Page:
        page = self._context.new_page()
        page.set_default_timeout(1e3 * PATIENCE_S)
        self.watch = Watch(page)
        return page

    def choose(self, dataset: Path) -> None:
        """Open a dataset from the list."""
        self.page.locator(f'[data-pick=open][data-k="{dataset}"]').first.click()
        self.page.get_by_role("button", name="Surface", exact=True).first.click()
        self.page.locator("[data-floating-window]", has_text="Height").first.wait_for()

    def first_picture_s(self) -> tuple[float, float]:
        """From opening the page, and from connecting, to the first picture of the surface."""
        opened_ms = self.page.evaluate("performance.timeOrigin")
        deadline = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline:
            first = next((look for look in self.seen_since(opened_ms) if look.coloured > COLOURED), None)
            if first is not None:
                after_s = (first.at_ms - opened_ms) / 1e3
                return after_s, after_s - self.page.evaluate("window.connectedAt") / 1e3
            self.page.wait_for_timeout(50)
        return float("nan"), float("nan")

    def now_ms(self) -> float:
        """The browser's clock."""
        return self.page.evaluate("performance.timeOrigin + performance.now()")

    def settled_s(self, since_ms: float) -> float:
        """From a moment of the browser's clock until the last change that was seen, once nothing more is sent either.

        NaN when it does not come to rest.
        """
        deadline, sent = time.monotonic() + PATIENCE_S, (self.viewer.bytes_sent(), time.monotonic())
        while time.monotonic() < deadline:
            n_bytes, now = self.viewer.bytes_sent(), time.monotonic()
            sent = sent if n_bytes - sent[0] < STRAY_BYTES else (n_bytes, now)
            last = max((look.at_ms for look in self.seen_since(since_ms) if look.changed > CHANGED), default=since_ms)
            if self.now_ms() - last > 1e3 * QUIET_S and now - sent[1] > QUIET_S:
                return (last - since_ms) / 1e3
            self.page.wait_for_timeout(100)
        return float("nan")

    def seen_since(self, since_ms: float) -> list[Look]:
        """What was shown since then."""
        return [look for look in self.watch.looks if look.at_ms > since_ms]

    def middle(self) -> tuple[float, float]:
        """The middle of the scene on the page."""
        box = self.page.locator("canvas[data-engine]").first.bounding_box()
        if box is None:
            raise SystemExit("There is no scene.")
        return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2

    def zoom(self, notches: int) -> None:
        """Turn the wheel over the middle of the scene, all notches at once: towards it, or with a negative number away.

        A browser that draws hands on the notches of a real wheel one a frame: that is no jump.
        """
        x, y = self.middle()
        self.page.evaluate(TURN, {"x": x, "y": y, "by": -240 if notches > 0 else 240, "times": abs(notches)})

    def pan(self, right_px: float, down_px: float) -> None:
        """Drag the surface along."""
        x, y = self.middle()
        self.page.mouse.move(x, y)
        self.page.mouse.down(button="right")
        self.page.mouse.move(x + right_px, y + down_px, steps=4)
        self.page.mouse.up(button="right")

    def answer_s(self, x_px: float, y_px: float) -> float:
        """From a click beside the middle of the scene to its read-out."""
        n = self.page.evaluate("window.answers.length")
        x, y = self.middle()
        self.page.mouse.click(x + x_px, y + y_px)
        try:
            self.page.wait_for_function(f"window.answers.length > {n}", timeout=8e3, polling=20)
        except TimeoutError:
            return float("nan")
        return self.page.evaluate("window.answers.at(-1)") / 1e3


@contextmanager
def seats(viewer: Viewer) -> Iterator[Seat]:
    """A browser before a viewer."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=FLAGS)
        try:
            yield Seat(browser.new_context(viewport=SIZE), viewer)
        finally:
            browser.close()
