"""How quick the page is on large surfaces: 165 million points, as many as the paper's wafer has, and 44 million.

    python tests/bench/bench_page.py [--brief | --quick | --points]

The true viewer in a process of its own, a headless Chromium that draws in software, a window of 1600 x 1000. The
surface is made up (tests/bench/big_mosaic.py), written as any other is, and open already. First pictures count from
the moment the page connects; settled is when nothing changes any more; a click counts until its read-out is there, at
rest, and while tiles stream and two workers reconstruct fields. Memory is what belongs to the process alone (USS). Of
the scene's middle so much is covered while the camera comes nearer, as a share of what is at both ends. --brief: one
round, no reconstruction; --quick: that with two jumps on a surface of 11 million points. --points: a cloud of 44
million points instead: seconds until the picture follows a clip and a slab, and those that drawing all of it takes.
"""

from __future__ import annotations

import statistics
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path

import psutil

from tests.bench.bench_workers import RECIPE, RESULT, make_dataset
from tests.bench.big_mosaic import BLOCKS_PX, PIXEL_UM, QUICK_PX, WAFER_PX, big_dataset
from tests.bench.harness import met, read_options, show
from tests.bench.page_driver import CHANGED, PATIENCE_S, Seat, Viewer, seats
from tests.browser.steps import put, set_numbers, text_field
from wafer_viewer.compute.crews import crew_for
from wafer_viewer.session.surface.worker_tasks import reconstruct_field
from wafer_viewer.store.dataset.dataset import Dataset

FIRST_GOAL_S, SETTLED_GOAL_S, CLICK_GOAL_S, MEMORY_GOAL, BYTES_GOAL = 2.0, 2.0, 0.3, 1.5e9, 8e6
COVERED_GOAL = 0.9
CLIP_GOAL_S, SLAB_GOAL_S = 2.0, 2.0
"""As soon as after a jump."""
JUMPS = (8, -5, 12, -10)
"""Notches of the wheel, one jump each; after them the camera shows everything again."""


HEAD_AT = """() => {
  const text = () => document.querySelector('.wv-points')?.textContent;
  const before = text();
  window.headAt = undefined;
  clearInterval(window.headTimer);
  window.headTimer = setInterval(() => {
    if (text() && text() !== before) {
      window.headAt = performance.timeOrigin + performance.now();
      clearInterval(window.headTimer);
    }
  }, 20);
}"""
"""Note when the words of the head line become others."""


@dataclass(frozen=True, slots=True)
class Figures:
    """Of one surface: seconds, bytes; `covered`: the least share of the scene's middle while coming nearer."""

    opened_s: float
    first_s: float
    settled_s: float
    covered: float
    view_bytes: float
    click_s: float
    busy_click_s: float
    viewer_bytes: float
    painter_bytes: float


def main() -> None:
    told = read_options(__doc__, brief=False, points=False)
    if told.points:
        show_cloud(cloud_of(big_dataset(BLOCKS_PX)), psutil.getloadavg()[0])
        return
    load, whole = psutil.getloadavg()[0], not (told.brief or told.quick)
    sides, jumps = ((QUICK_PX,), JUMPS[:2]) if told.quick else ((BLOCKS_PX, WAFER_PX), JUMPS)
    figures = {side: measured(big_dataset(side), 5 if whole else 1, jumps, whole) for side in sides}
    show_figures(figures, load, " and two workers reconstruct" if whole else "")


def measured(dataset: Path, rounds: int, jumps: tuple[int, ...], works: bool) -> Figures:
    """All figures of one surface: medians of some rounds; the largest of bytes."""
    viewer = Viewer(dataset.parent)
    try:
        with seats(viewer) as seat:
            seat.open()
            seat.choose(dataset)
            firsts, view_bytes = zip(*(connected(seat) for _ in range(rounds)), strict=True)
            settled, covered, sent = zip(*(jumped(seat, n) for _ in range(rounds) for n in jumps), strict=True)
            click_s = statistics.median(seat.answer_s(17.0 * k, 11.0 * k) for k in range(2 * rounds))
            with reconstruction() if works else nullcontext():
                busy_s = statistics.median(click_while_streaming(seat, k) for k in range(2 * rounds))
            memory = viewer.memory()
    finally:
        viewer.close()
    return Figures(
        opened_s=statistics.median(first[0] for first in firsts),
        first_s=statistics.median(first[1] for first in firsts),
        settled_s=statistics.median(settled),
        covered=min(covered),
        view_bytes=float(max(*view_bytes, *sent)),
        click_s=click_s,
        busy_click_s=busy_s,
        viewer_bytes=float(memory.viewer),
        painter_bytes=float(memory.painters),
    )


def connected(seat: Seat) -> tuple[tuple[float, float], int]:
    """A browser that comes: how soon there is a picture, and how many bytes it took until all is drawn."""
    seat.leave()
    seat.open()
    first = seat.first_picture_s()
    seat.settled_s(seat.now_ms())
    return first, seat.viewer.bytes_sent()


def jumped(seat: Seat, notches: int) -> tuple[float, float, int]:
    """One jump of the camera: seconds until all is drawn, the least that was covered meanwhile, bytes it took."""
    before, began = seat.viewer.bytes_sent(), seat.now_ms()
    seat.zoom(notches)
    settled_s = seat.settled_s(seat.now_ms())
    looks = [look.coloured for look in seat.seen_since(began)] or [float("nan")]
    ends = min(looks[0], looks[-1])  # the surface fills more of the scene the nearer it comes
    covered = min(looks) / max(ends, 1e-6) if notches > 0 else 1.0
    return settled_s, covered, seat.viewer.bytes_sent() - before


def click_while_streaming(seat: Seat, k: int) -> float:
    """A click at once after a jump, while its tiles are made and sent."""
    seat.zoom((6, -6)[k % 2])
    answer_s = seat.answer_s(23.0 * (k % 5), 13.0 * (k % 7))
    seat.settled_s(seat.now_ms())
    return answer_s


@contextmanager
def reconstruction() -> Iterator[None]:
    """Two workers that reconstruct fields one after the other, as the session's own do."""
    with tempfile.TemporaryDirectory() as folder, crew_for(workers=2) as crew:
        path = Path(folder) / "other.wafer"
        make_dataset(path, 2, 24)
        reconstruct_field(path, 1, RESULT, RECIPE)
        fields = [field.number for field in Dataset.open(path).fields]
        ended = threading.Event()

        def work() -> None:
            while not ended.is_set():
                for _ in crew.each(reconstruct_field, [(path, number, RESULT, RECIPE, 1) for number in fields]):
                    pass

        working = threading.Thread(target=work)
        working.start()
        try:
            yield
        finally:
            ended.set()
            working.join()


@dataclass(frozen=True, slots=True)
class Cloud:
    """Of a point cloud: seconds until all is drawn, from nothing, after each clip, and after a slab; bytes."""

    drawn_s: float
    clips_s: dict[str, float]
    counted_s: float
    section_s: float
    slab_s: float
    viewer_bytes: float
    painter_bytes: float


def cloud_of(dataset: Path) -> Cloud:
    """All figures of the point cloud of a surface, one round."""
    viewer = Viewer(dataset.parent)
    try:
        with seats(viewer) as seat:
            seat.open()
            seat.choose(dataset)
            seat.settled_s(seat.now_ms())
            page, head = seat.page, seat.page.locator(".wv-points")
            drawn_s = followed(seat, lambda: page.get_by_role("button", name="Points", exact=True).last.click())
            head.wait_for(timeout=4e3 * PATIENCE_S)
            side_um = BLOCKS_PX * PIXEL_UM / 2
            began_ms = seat.now_ms()
            clips_s = {"a box": followed(seat, lambda: set_numbers(page, "X, µm", -side_um / 2, side_um / 2))}
            counted_s = (page.evaluate("window.headAt") - began_ms) / 1e3
            clips_s["heights"] = followed(seat, lambda: set_numbers(page, "Z, µm", 20, 60))
            clips_s["confidence"] = followed(seat, lambda: put(page, text_field(page, "Minimum confidence"), "0.95"))
            page.get_by_role("button", name="Reset", exact=True).last.click()
            put(page, text_field(page, "Minimum confidence"), "0")
            seat.settled_s(seat.now_ms())
            page.keyboard.press("l")
            page.locator(".wv-slab-points").wait_for(timeout=4e3 * PATIENCE_S)
            points = page.locator(".wv-slab-points")
            before, began_ms = points.get_attribute("data-points"), seat.now_ms()
            set_numbers(page, "Width, µm", 20)
            page.wait_for_function(
                f"document.querySelector('.wv-slab-points')?.dataset.points !== {before!r}", polling=20
            )
            section_s = (seat.now_ms() - began_ms) / 1e3
            seat.settled_s(seat.now_ms())
            slab_s = followed(seat, lambda: page.get_by_role("button", name="Pale", exact=True).last.click())
            memory = viewer.memory()
    finally:
        viewer.close()
    return Cloud(drawn_s, clips_s, counted_s, section_s, slab_s, float(memory.viewer), float(memory.painters))


def followed(seat: Seat, act: Callable[[], object]) -> float:
    """Seconds from something that is done until the picture has followed, typing included; NaN where it does not."""
    seat.page.evaluate(HEAD_AT)
    began_ms = seat.now_ms()
    act()
    seat.page.wait_for_function("window.headAt", polling=20, timeout=4e3 * PATIENCE_S)
    deadline = time.monotonic() + PATIENCE_S
    while not any(look.changed > CHANGED for look in seat.seen_since(began_ms)):
        if time.monotonic() > deadline:
            return float("nan")
        seat.page.wait_for_timeout(50)
    return seat.settled_s(began_ms)


def show_cloud(cloud: Cloud, load: float) -> None:
    """The table, with goals and the ratio to drawing the cloud from nothing."""
    rows = [("drawn from nothing, s", cloud.drawn_s, "", "", "")]
    parts = [*((f"picture after a clip by {name}, s", s, CLIP_GOAL_S) for name, s in cloud.clips_s.items())]
    parts.append(("picture after a slab, s", cloud.slab_s, SLAB_GOAL_S))
    rows += [(name, s, s / cloud.drawn_s, f"{goal:g}", met(s, goal)) for name, s, goal in parts]
    rows += [
        ("head line after a clip by a box, s", cloud.counted_s, cloud.counted_s / cloud.drawn_s, "", ""),
        ("section after another width, s", cloud.section_s, cloud.section_s / cloud.drawn_s, "", ""),
        ("memory of the viewer (USS), MB", cloud.viewer_bytes / 1e6, "", "1500", met(cloud.viewer_bytes, MEMORY_GOAL)),
        ("- of its painters, MB", cloud.painter_bytes / 1e6, "", "", ""),
    ]
    title = f"A point cloud of {BLOCKS_PX**2 / 1e6:.0f} M points; load of the machine before: {load:.1f}"
    show(title, ("", "", "of drawing it", "goal", ""), rows)


def show_figures(figures: dict[int, Figures], load: float, beside: str) -> None:
    """The table, with goals; `beside` says what went on beside the streaming of tiles."""
    goals = [
        ("first picture after connecting, s", "first_s", FIRST_GOAL_S, 1.0, False),
        ("- after opening the page, s", "opened_s", None, 1.0, False),
        ("settled after a jump, s", "settled_s", SETTLED_GOAL_S, 1.0, False),
        ("covered while coming nearer, least share", "covered", COVERED_GOAL, 1.0, True),
        ("sent for a settled view, MB", "view_bytes", BYTES_GOAL, 1e6, False),
        ("click to read-out at rest, s", "click_s", CLICK_GOAL_S, 1.0, False),
        (f"- while tiles stream{beside}, s", "busy_click_s", CLICK_GOAL_S, 1.0, False),
        ("memory of the viewer (USS), MB", "viewer_bytes", MEMORY_GOAL, 1e6, False),
        ("- of its painters, MB", "painter_bytes", None, 1e6, False),
    ]
    rows = [
        (
            what,
            *(getattr(f, name) / unit for f in figures.values()),
            "" if goal is None else f"{goal / unit:g}",
            "" if goal is None else worst([met(getattr(f, name), goal, at_least) for f in figures.values()]),
        )
        for what, name, goal, unit, at_least in goals
    ]
    header = ("", *(f"{side**2 / 1e6:.0f} M points" for side in figures), "goal", "")
    show(f"The page on large surfaces; load of the machine before: {load:.1f}", header, rows)


def worst(words: list[str]) -> str:
    """Missed where any is."""
    return min(words)


if __name__ == "__main__":
    main()
