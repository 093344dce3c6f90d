"""Eight hours at the page in minutes: does memory grow, does anything go wrong?

    python tests/bench/bench_soak.py [--hours H] [--quick]

The true viewer on a surface of 44 million points, and a browser that does what an operator does in a day, without the
pauses between: 500 changes of the view (nearer, farther, aside, presets, colours), 100 profiles, 20 times the page is
closed and opened again. Memory is what belongs to the viewer's process and to its painters alone (USS), from after a
warm-up of a tenth of it all to the end, both times with the browser at rest; and, each time before the page is closed,
the slope of a line through the later half of these looks, as growth in 24 hours. --hours: another length of use, for
which 8 hours are 500 changes of the view. --quick: a fiftieth of the whole on 11
million points, half of it to warm up: it says whether it runs, not what it leaves.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterator

import numpy as np

from tests.bench.big_mosaic import BLOCKS_PX, QUICK_PX, big_dataset
from tests.bench.harness import met, read_options, show
from tests.bench.page_driver import Memory, Seat, Viewer, seats

HOURS, CHANGES, PROFILES, RECONNECTS = 8.0, 500, 100, 20
WARM_UP, QUICK = 0.1, 0.01
GROWTH_GOAL = 0.1
LEAST_LOOKS = 4
PAUSE_MS = 250
"""An operator looks at least so long."""


def main() -> None:
    arguments = read_options(__doc__, hours=HOURS)
    quick = arguments.quick
    warm_up, share = (QUICK, QUICK) if quick else (WARM_UP, arguments.hours / HOURS)
    dataset, began = big_dataset(QUICK_PX if quick else BLOCKS_PX), time.monotonic()
    viewer = Viewer(dataset.parent)
    try:
        with seats(viewer) as seat:
            seat.open()
            seat.choose(dataset)
            use(seat, warm_up)
            before = at_rest(seat)
            looks = use(seat, share)
            after = at_rest(seat)
        told = viewer.complaints()
    finally:
        viewer.close()
    show_growth(before, after, share, time.monotonic() - began, told)
    show_slope(looks, share)


def use(seat: Seat, share: float) -> list[float]:
    """A share of a day: views are changed, now and then a profile is taken, or the page opened anew.

    Returns the memory of viewer and painters, MB, each time before the page is closed.
    """
    looks = list[float]()
    change, profile = changes(seat), profiles(seat)
    n_changes = round(CHANGES * share)
    per_profile, per_reconnect = CHANGES // PROFILES, CHANGES // RECONNECTS
    for n in range(1, n_changes + 1):
        next(change)()
        seat.page.wait_for_timeout(PAUSE_MS)
        if n % per_profile == 0:
            next(profile)()
        if n % per_reconnect == 0:
            memory = seat.viewer.memory()
            looks.append((memory.viewer + memory.painters) / 1e6)
            seat.leave()
            seat.open()
            seat.first_picture_s()
    return looks


def changes(seat: Seat) -> Iterator[Callable[[], object]]:
    """One change of the view after the other, over and over."""
    return itertools.cycle(
        [
            lambda: seat.zoom(4),
            lambda: seat.pan(160, 90),
            lambda: seat.zoom(5),
            lambda: seat.pan(-240, 60),
            lambda: seat.page.keyboard.press("t"),
            lambda: seat.zoom(-6),
            lambda: seat.page.keyboard.press("i"),
            lambda: seat.page.keyboard.press("h"),
            lambda: seat.page.keyboard.press("u"),
            lambda: seat.page.keyboard.press("Home"),
        ]
    )


def profiles(seat: Seat) -> Iterator[Callable[[], object]]:
    """A profile in the step for measuring, and back to the surface."""

    def take(k: int) -> None:
        page = seat.page
        page.get_by_role("button", name="Measure", exact=True).first.click()
        page.keyboard.press("l")
        page.locator(".wv-dock", has_text="Pt").first.wait_for()
        seat.zoom(1 if k % 2 else -1)
        page.wait_for_timeout(PAUSE_MS)
        page.keyboard.press("Escape")
        page.get_by_role("button", name="Surface", exact=True).first.click()

    return (lambda k=k: take(k) for k in itertools.count())


def at_rest(seat: Seat) -> Memory:
    """What the processes hold when all is drawn and the browser shows everything."""
    seat.page.keyboard.press("i")
    seat.settled_s(seat.now_ms())
    return seat.viewer.memory()


def show_growth(before: Memory, after: Memory, share: float, took_s: float, told: str) -> None:
    """The table, and what the log says."""
    parts = [("viewer", before.viewer, after.viewer), ("painters", before.painters, after.painters)]
    parts.append(("together", sum(part[1] for part in parts), sum(part[2] for part in parts)))
    rows = [
        (name, old / 1e6, new / 1e6, f"{100 * (new / old - 1):+.1f}", met(new / old - 1, GROWTH_GOAL))
        for name, old, new in parts
    ]
    title = f"{share:.0%} of a day's use in {took_s / 60:.0f} min; goal: no growth beyond {GROWTH_GOAL:.0%}"
    show(title, ("memory (USS)", "warmed up, MB", "at the end, MB", "growth, %", ""), rows)
    errors = [line for line in told.splitlines() if "ERROR" in line or "Traceback" in line]
    print(f"\nErrors in the log: {len(errors)}")
    for line in errors[:20]:
        print(f"  {line}")


def show_slope(looks: list[float], share: float) -> None:
    """The growth in 24 hours by the slope of the later half of the looks at the memory."""
    later = np.array(looks[len(looks) // 2 :])
    if len(later) < LEAST_LOOKS:
        print(f"\n{len(later)} looks at the memory in the later half: too few for a slope.")
        return
    hours = np.arange(len(later)) * HOURS / RECONNECTS
    (slope, _), covariance = np.polyfit(hours, later, 1, cov=True)
    growth, error = (24 * value / later.mean() for value in (slope, np.sqrt(covariance[0, 0])))
    print(
        f"\nSlope of {len(later)} looks, the later half of {share * HOURS:g} h: {100 * growth:+.1f} % in 24 h, "
        f"standard error {100 * error:.1f} %; all looks, MB: {' '.join(f'{look:.0f}' for look in looks)}"
    )


if __name__ == "__main__":
    main()
