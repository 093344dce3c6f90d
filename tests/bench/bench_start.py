"""How soon the viewer is there: from the start of the process to its address, from opening that to the first picture.

    python tests/bench/bench_start.py [--quick]

The goals are an address within 3 s, and a first picture at most 1 s later than that of a viser page with nothing but a
grid, opened in the same run: on the first opening by a browser, and on the next ones, when it has the page's files.
A picture is what headless Chromium shows, without a graphics card: the lines in the scene and, of the viewer, the card
of the first start. --quick: one start; otherwise four.
"""

from __future__ import annotations

import contextlib
import io
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from statistics import median

import numpy as np
from PIL import Image
from playwright.sync_api import Browser, Page, sync_playwright

from tests.bench.harness import goal, read_options
from tests.browser.screens import FLAGS

ADDRESS_GOAL_S, LATER_GOAL_S = 3.0, 1.0
WINDOW = {"width": 1600, "height": 1000}
SCENE = {"x": 320, "y": 150, "width": 200, "height": 600}
"""A part of the scene beside the card, in pixels of the page."""
LINES_GREY = 6
"""Lines of a scene differ from what is behind them by more than this; an empty one is a smooth gradient."""
OPENINGS = ("first opening", "next opening", "the one after")
CARD = "Start with a sample"
EMPTY = """
import socket, threading, viser
with socket.socket() as free:
    free.bind(("127.0.0.1", 0))
    port = free.getsockname()[1]
server = viser.ViserServer(host="127.0.0.1", port=port, verbose=False)
server.scene.add_grid("/grid", width=20.0, height=20.0, cell_color=(0, 0, 0), section_color=(0, 0, 0))
print(f"http://127.0.0.1:{port}", flush=True)
threading.Event().wait()
"""


@contextlib.contextmanager
def serving(*command: str) -> Iterator[tuple[float, str]]:
    """Start a process that prints an address; seconds until then, and the address."""
    began = time.perf_counter()
    process = subprocess.Popen([sys.executable, *command], stdout=subprocess.PIPE, text=True)
    try:
        line = process.stdout.readline()
        while "http" not in line:
            line = process.stdout.readline()
        yield time.perf_counter() - began, re.search(r"http\S+", line).group()
    finally:
        process.terminate()
        process.communicate(timeout=60)


def openings(browser: Browser, address: str, words: str | None) -> list[float]:
    """Seconds until the first picture, each time that one browser opens an address."""
    context = browser.new_context(viewport=WINDOW)
    page = context.new_page()
    seconds = []
    for _ in OPENINGS:
        page.goto("about:blank")
        seconds.append(open_page(page, address, words))
    context.close()
    return seconds


def open_page(page: Page, address: str, words: str | None) -> float:
    """Seconds until the words, if any, and the lines of the scene are on the screen."""
    began = time.perf_counter()
    page.goto(address)
    if words is not None:
        page.get_by_text(words).wait_for(timeout=60_000)
    while not lines_are_drawn(page):
        page.wait_for_timeout(20)
    return time.perf_counter() - began


def lines_are_drawn(page: Page) -> bool:
    """Whether the scene holds lines."""
    grey = np.asarray(Image.open(io.BytesIO(page.screenshot(clip=SCENE))).convert("L"), float)
    return bool(np.abs(np.diff(grey, axis=0)).max() > LINES_GREY)


def main() -> None:
    starts = 1 if read_options(__doc__).quick else 4
    later: list[list[float]] = [[] for _ in OPENINGS]
    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path=shutil.which("chromium"), args=list(FLAGS))
        for n in range(1, starts + 1):
            with serving("-c", EMPTY) as (_, address):
                empty = openings(browser, address, None)
            with tempfile.TemporaryDirectory() as folder:
                command = ("-m", "wafer_viewer", "serve", "--port", "0", "--data", folder)
                with serving(*command) as (address_s, address):
                    ours = openings(browser, address, CARD)
            print(f"start {n}: address after {address_s:.2f} s {goal(address_s, ADDRESS_GOAL_S, ' s')}", flush=True)
            for k, name in enumerate(OPENINGS):
                later[k].append(ours[k] - empty[k])
                print(f"  {name:<14} picture after {ours[k]:.2f} s, of an empty viser page after {empty[k]:.2f} s")
        browser.close()
    for name, seconds in zip(OPENINGS, map(median, later), strict=True):
        words = f"{seconds:.2f} s {goal(seconds, LATER_GOAL_S, ' s')}"
        print(f"{name:<14} first picture later than that of an empty viser page: {words}")


if __name__ == "__main__":
    main()
