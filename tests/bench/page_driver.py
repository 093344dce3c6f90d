"""The true viewer in a process of its own and a browser before it, for the page's benchmarks.

What is seen is judged in the browser: the scene is looked at many times a second, small.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import psutil
from playwright.sync_api import BrowserContext, Page, TimeoutError, sync_playwright

from tests.browser.screens import FLAGS, dismiss_viser_warning, remember
from wafer_viewer.session.painter import NICENESS

ROOT = Path(__file__).parents[2]
SIZE = {"width": 1600, "height": 1000}
QUIET_S, PATIENCE_S = 1.2, 40.0
"""The scene is settled when nothing has changed for so long."""
STRAY_BYTES = 3000
"""What is sent of itself: the time, a position."""
COLOURED, CHANGED = 0.04, 0.004
"""Shares of the scene: from the first on there is a picture; up to the second it counts as the same."""
WATCH = """
const get = HTMLCanvasElement.prototype.getContext;
HTMLCanvasElement.prototype.getContext = function (kind, options) {
  return get.call(this, kind, kind.startsWith('webgl') ? {...options, preserveDrawingBuffer: true} : options);
};
const small = Object.assign(document.createElement('canvas'), {width: 160, height: 120});
const pen = get.call(small, '2d', {willReadFrequently: true});
let before = null;
window.seen = [];
function look() {
  const scene = document.querySelector('canvas[data-engine]');
  if (!scene || !scene.width) return;
  pen.clearRect(0, 0, 160, 120);
  pen.drawImage(scene, 0, 0, 160, 120);
  const now = pen.getImageData(0, 0, 160, 120).data;
  let coloured = 0, changed = 0, middle = 0;
  for (let i = 0; i < now.length; i += 4) {
    const [r, g, b, a] = [now[i], now[i + 1], now[i + 2], now[i + 3]];
    const chroma = Math.max(r, g, b) - Math.min(r, g, b);
    const x = (i / 4) % 160, y = (i / 640) | 0;
    const there = a > 200 && chroma > 26;
    coloured += there;
    middle += there && x > 40 && x < 120 && y > 30 && y < 90;
    if (before) changed += Math.abs(r - before[i]) + Math.abs(g - before[i + 1]) + Math.abs(b - before[i + 2]) > 24;
  }
  before = now;
  window.seen.push([performance.now(), coloured / 19200, changed / 19200, middle / 4661]);
}
setInterval(look, 40);
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


class Seat:
    """A browser before the viewer, with what it sees; `context` keeps what it remembers over a reload."""

    def __init__(self, context: BrowserContext, viewer: Viewer) -> None:
        self.viewer, self._context = viewer, context
        context.add_init_script(WATCH)
        self.page: Page = context.new_page()
        self.page.set_default_timeout(1e3 * PATIENCE_S)
        remember(self.page, "surface", False)

    def open(self) -> None:
        """Go to the page."""
        self.page.goto(self.viewer.address)

    def leave(self) -> None:
        """Close the page and get another."""
        self.page.close()
        self.page = self._context.new_page()
        self.page.set_default_timeout(1e3 * PATIENCE_S)

    def choose(self, dataset: Path) -> None:
        """Open a dataset from the list."""
        self.page.locator(f'[data-pick=open][data-k="{dataset}"]').first.click()
        self.page.get_by_role("button", name="Surface", exact=True).first.click()
        self.page.locator("[data-floating-window]", has_text="Height").first.wait_for()
        dismiss_viser_warning(self.page)

    def first_picture_s(self) -> tuple[float, float]:
        """From opening the page, and from connecting, to the first picture of the surface."""
        condition = f"window.seen.some(s => s[1] > {COLOURED})"
        self.page.wait_for_function(condition, timeout=1e3 * PATIENCE_S, polling=50)
        at = self.page.evaluate(f"window.seen.find(s => s[1] > {COLOURED})[0]")
        return at / 1e3, (at - self.page.evaluate("window.connectedAt ?? 0")) / 1e3

    def now_ms(self) -> float:
        """The browser's clock."""
        return self.page.evaluate("performance.now()")

    def settled_s(self, since_ms: float) -> float:
        """From a moment of the browser's clock until the last change that was seen, once nothing more is sent either.

        NaN when it does not come to rest.
        """
        deadline, sent = time.monotonic() + PATIENCE_S, (self.viewer.bytes_sent(), time.monotonic())
        while time.monotonic() < deadline:
            n_bytes, now = self.viewer.bytes_sent(), time.monotonic()
            sent = sent if n_bytes - sent[0] < STRAY_BYTES else (n_bytes, now)
            looks = self.seen_since(since_ms)
            last = max((at for at, _, changed, _ in looks if changed > CHANGED), default=since_ms)
            at_rest = bool(looks) and looks[-1][0] - last > 1e3 * QUIET_S and now - sent[1] > QUIET_S
            if at_rest:
                return (last - since_ms) / 1e3
            self.page.wait_for_timeout(100)
        return float("nan")

    def seen_since(self, since_ms: float) -> list[list[float]]:
        """Time, share coloured, share changed, share of the middle coloured, of each look since then."""
        return self.page.evaluate(f"window.seen.filter(s => s[0] > {since_ms})")

    def middle(self) -> tuple[float, float]:
        """The middle of the scene on the page."""
        box = self.page.locator("canvas[data-engine]").first.bounding_box()
        if box is None:
            raise SystemExit("There is no scene.")
        return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2

    def zoom(self, notches: int) -> None:
        """Turn the wheel over the middle of the scene: towards it, or with a negative number away."""
        self.page.mouse.move(*self.middle())
        for _ in range(abs(notches)):
            self.page.mouse.wheel(0, -240 if notches > 0 else 240)
            self.page.wait_for_timeout(30)

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
