"""How soon the viewer is there: from the start of the process to its address, from opening that to the first picture.

    python tests/bench/bench_start.py [--quick]

The goals are an address within 3 s and a first picture within 3 s of opening the page. The picture is the one that
headless Chromium shows, without a graphics card: the card of the first start and the lines of the stage behind it.
--quick: one start; otherwise six.
"""

from __future__ import annotations

import argparse
import io
import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from PIL import Image
from playwright.sync_api import Browser, Page, sync_playwright

sys.path.insert(0, str(Path(__file__).parents[2]))
from tests.browser.screens import FLAGS

GOAL_S = 3.0
WINDOW = {"width": 1600, "height": 1000}
SCENE = {"x": 320, "y": 150, "width": 200, "height": 600}
"""A part of the scene beside the card, in pixels of the page."""
LINES_GREY = 6
"""The lines of the stage differ from the gradient behind them by more than this."""


def start_once(browser: Browser) -> tuple[float, float]:
    """Seconds until the address is printed, and from opening it until there is a picture."""
    with tempfile.TemporaryDirectory() as folder:
        began = time.perf_counter()
        command = [sys.executable, "-m", "wafer_viewer", "serve", "--port", "0", "--data", folder]
        viewer = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        line = viewer.stdout.readline()
        address_s = time.perf_counter() - began
        page = browser.new_page(viewport=WINDOW)
        picture_s = open_page(page, re.search(r"http\S+", line).group())
        page.close()
        viewer.terminate()
        viewer.communicate(timeout=60)
        return address_s, picture_s


def open_page(page: Page, address: str) -> float:
    """Seconds until the card and the stage are on the screen."""
    began = time.perf_counter()
    page.goto(address)
    page.get_by_text("Start with a sample").wait_for(timeout=60_000)
    while not stage_is_drawn(page):
        page.wait_for_timeout(20)
    return time.perf_counter() - began


def stage_is_drawn(page: Page) -> bool:
    """Whether the scene holds lines; the empty one is a smooth gradient."""
    grey = np.asarray(Image.open(io.BytesIO(page.screenshot(clip=SCENE))).convert("L"), float)
    return bool(np.abs(np.diff(grey, axis=0)).max() > LINES_GREY)


def main() -> None:
    parser = argparse.ArgumentParser(description="How soon the viewer is there.")
    parser.add_argument("--quick", action="store_true", help="one start instead of six")
    starts = 1 if parser.parse_args().quick else 6
    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path=shutil.which("chromium"), args=list(FLAGS))
        for n in range(1, starts + 1):
            address_s, picture_s = start_once(browser)
            print(f"start {n}: {told('address', address_s)}, {told('first picture', picture_s)}")
        browser.close()


def told(what: str, seconds: float) -> str:
    return f"{what} after {seconds:.2f} s (goal {GOAL_S:.0f} s {'met' if seconds <= GOAL_S else 'MISSED'})"


if __name__ == "__main__":
    main()
