"""How soon a profile follows its handle: a line of 6000 points and more over a mosaic of 44 million points.

    python tests/bench/bench_profile.py [--quick] [--moves N] [--side PIXELS]

The true viewer in a process of its own, a headless Chromium that draws in software, a window of 1600 x 1000. A handle
of the line is taken hold of and moved as a hand does; times are of the browser's own clock, from its event of the move:
`changed`, until the new curve stands in the page, `drawn`, until the browser has drawn the frame that shows it. One
move at a time, then moves 16 ms apart: how many curves were drawn in a second of that. The viewer's processor time is
that of one move. The goal is 0.1 s. --side: another mosaic, 12850 for the paper's wafer; --quick: three
moves on one of 11 million points.
"""

from __future__ import annotations

import io
import shutil
import statistics
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import psutil
from PIL import Image
from playwright.sync_api import Page, sync_playwright
from scipy import ndimage

from tests.bench.big_mosaic import BLOCKS_PX, QUICK_PX, big_dataset
from tests.bench.harness import met, read_options, show
from tests.bench.page_driver import SIZE, Viewer
from tests.browser.screens import FLAGS, remember
from wafer_viewer.draw.colormaps import PROFILE_COLOURS, rgb

GOAL_S = 0.1
REST_MS = 1500
"""Between moves, so that each is answered by itself."""
CURVE = "path[data-curve=A]"
WATCH = """
window.moves = [];
let asked = null, before = '';
addEventListener('pointermove', event => { if (event.buttons) asked ??= performance.now(); }, true);
const curve = () => document.querySelector('path[data-curve=A]')?.getAttribute('d') ?? '';
new MutationObserver(() => {
  const now = curve();
  if (!now || now === before) return;
  before = now;
  if (!asked) return;
  const at = asked, changed = performance.now();
  asked = null;
  requestAnimationFrame(() => setTimeout(() => window.moves.push([changed - at, performance.now() - at]), 0));
}).observe(document, {childList: true, subtree: true, characterData: true});
"""


@dataclass(frozen=True, slots=True)
class Figures:
    """Seconds of each move, curves drawn in a second of moving on and on, the viewer's processor seconds a move."""

    changed_s: list[float]
    drawn_s: list[float]
    followed_hz: float
    cpu_s: float
    n_points: int


def main() -> None:
    asked = read_options(__doc__, side=BLOCKS_PX, moves=40)
    side, n_moves = (QUICK_PX, 3) if asked.quick else (asked.side, asked.moves)
    load = psutil.getloadavg()[0]
    show_figures(measured(big_dataset(side), n_moves), side, load)


def measured(dataset: Path, n_moves: int) -> Figures:
    """Open a mosaic, lay a line along a row of it, move its end."""
    viewer = Viewer(dataset.parent)
    try:
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=FLAGS)
            page = browser.new_context(viewport=SIZE).new_page()
            page.add_init_script(WATCH)
            begin(page, viewer.address, dataset)
            figures = moved(page, viewer, n_moves)
            browser.close()
            return figures
    finally:
        viewer.close()


def begin(page: Page, address: str, dataset: Path) -> None:
    """To the profile of a whole row, with the scene at rest."""
    remember(page, "surface", False)
    page.goto(address)
    page.locator(f'[data-pick=open][data-k="{dataset}"]').first.click()
    page.locator(f'.sel[data-pick=open][data-k="{dataset}"]').first.wait_for()
    page.get_by_role("button", name="Measure", exact=True).first.click()
    page.locator("[data-pick=tool][data-k=profile]").first.click()
    page.get_by_role("button", name="Add line", exact=True).and_(page.locator(":enabled")).wait_for(timeout=60_000)
    page.keyboard.press("t")
    page.wait_for_timeout(REST_MS)
    page.get_by_role("button", name="Horizontal cut", exact=True).click()
    page.wait_for_timeout(3 * REST_MS)


def moved(page: Page, viewer: Viewer, n_moves: int) -> Figures:
    """Take hold of the line's right end and move it up and down."""
    x, y = right_handle(page)
    page.mouse.move(x, y)
    page.mouse.down()
    before_s = viewer.cpu_s()
    for k in range(n_moves):
        page.mouse.move(x - 3, y - 12 * (1 + k % 6))
        page.wait_for_timeout(REST_MS)
    cpu_s = (viewer.cpu_s() - before_s) / n_moves
    answers = page.evaluate("window.moves")
    followed_hz = drag_on(page, x, y)
    page.mouse.up()
    changed, drawn = ([answer[n] / 1e3 for answer in answers] for n in (0, 1))
    return Figures(changed, drawn, followed_hz, cpu_s, n_points(page))


def drag_on(page: Page, x: float, y: float) -> float:
    """Curves drawn in a second while the handle moves on and on."""
    before, began = page.evaluate("[window.moves.length, performance.now()]")
    for k in range(60):
        page.mouse.move(x - 3, y - k)
        page.wait_for_timeout(16)
    after, ended = page.evaluate("[window.moves.length, performance.now()]")
    return (after - before) / (ended - began) * 1e3


def right_handle(page: Page) -> tuple[float, float]:
    """Where the handle at the line's right end is on the page: the rightmost ball in the line's colour."""
    box = page.locator("canvas[data-engine]").first.bounding_box()
    if box is None:
        raise SystemExit("There is no scene.")
    picture = np.asarray(Image.open(io.BytesIO(page.screenshot(clip=box))).convert("RGB"), int)
    alike = np.abs(picture - np.array(rgb(PROFILE_COLOURS[0][1:]))).max(axis=2) < 60
    balls, n = ndimage.label(ndimage.binary_opening(alike, iterations=4))
    if n == 0:
        raise SystemExit("There is no handle in sight.")
    row, col = max(ndimage.center_of_mass(alike, balls, range(1, n + 1)), key=lambda at: at[1])
    return box["x"] + float(col), box["y"] + float(row)


def n_points(page: Page) -> int:
    """Points of the line that stands there now: the file of it has a line for each."""
    with page.expect_download() as download:
        page.get_by_role("button", name="Profiles as CSV", exact=True).click()
    lines = Path(download.value.path()).read_text().splitlines()
    return sum(not line.startswith("#") for line in lines) - 1


def show_figures(figures: Figures, side: int, load: float) -> None:
    rows = [
        (name, statistics.median(values), max(values), met(statistics.median(values), GOAL_S))
        for name, values in (("changed", figures.changed_s), ("drawn", figures.drawn_s))
    ]
    title = f"A profile of {figures.n_points} points on {side} x {side}, s from the handle's move, load {load:.1f}"
    show(title, ("until", "median", "worst", f"goal {GOAL_S:g} s"), rows)
    print(
        f"  {len(figures.drawn_s)} moves; {figures.followed_hz:.1f} curves drawn in a second of moving on; "
        f"{1e3 * figures.cpu_s:.0f} ms of the viewer's processor time a move"
    )


if __name__ == "__main__":
    main()
