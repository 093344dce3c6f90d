"""Whether eleven others who look on, one of whom never reads, cost frames, the operator's time or memory.

    python tests/bench/bench_load.py [--watchers N] [--quick]

The true viewer as a process of its own, and browsers that speak with it over their websockets as a page does, without
a picture: the holder of the controls, some watchers, and one that never reads its socket. The holder takes the tour's
plan and scans; during scan and reconstruction it goes from step to step, and the time from the press to the page of the
other step is taken. Measured too: frames that are missing or damaged on the disk, and the memory of the viewer alone
(USS), before the scan, at most (looked at four times a second), and at the end. The same with the holder alone is
measured before. It exits with status 1 if a frame is missing, less than 95 % of the presses are answered in 0.5 s, or
the highest memory is 200 MB above that with nobody; and if a row holds less than 20 presses, which says nothing.
--quick: 3 watchers.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tests.bench.harness import highest, met, read_options, show
from tests.bench.page_driver import Viewer
from tests.support.plain_browser import PlainBrowser
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.store.dataset.dataset import Dataset

WATCHERS, QUICK = 10, 3
STEPS = ("Gauge check", "Plan")
"""Steps that are there at any time."""
ANSWER_S, SHARE, GROWTH_MB = 0.5, 0.95, 200.0
PAUSE_S, LEARN_S, PATIENCE_S = 0.4, 3.0, 900.0
LEAST_PRESSES, LOOK_S = 20, 0.25
HEADER = "looking on | frames | missing | damaged | presses | in 0.5 s | median, s | 95 %, s | before, MB | most | end"


@dataclass(frozen=True)
class Outcome:
    """A scan and its reconstruction: frames, seconds of the answers, MB of the viewer before, at most, at the end."""

    n_frames: int
    n_missing: int
    n_damaged: int
    answers_s: list[float]
    memory_mb: tuple[float, float, float]

    @property
    def share(self) -> float:
        """Share of the presses that were answered in time."""
        return float(np.mean(np.array(self.answers_s) <= ANSWER_S))


def scanned(n_watchers: int) -> Outcome:
    """Scan the tour and reconstruct it, with some who look on and one who never reads, or nobody."""
    data = Path(tempfile.mkdtemp(prefix="wafer-viewer-load-"))
    viewer, browsers = Viewer(data), list[PlainBrowser]()
    try:
        holder = PlainBrowser(viewer.address)
        browsers.append(holder)
        _wait(lambda: holder.button("Start scan") is not None, "the page")
        browsers += [PlainBrowser(viewer.address) for _ in range(n_watchers)]
        if n_watchers:
            browsers.append(PlainBrowser(viewer.address, reads=False))
        signs = _signs(holder)
        _until_ready(holder)

        def memory_mb() -> float:
            return viewer.memory().viewer / 1e6

        before = memory_mb()
        with highest(memory_mb, LOOK_S) as most_mb:
            holder.press("Start scan")
            answers_s, begun = list[float](), time.monotonic()
            time.sleep(LEARN_S)  # the page goes to the step of the scan by itself
            for label in STEPS:
                holder.press(label)
                time.sleep(PAUSE_S)
            while not _is_over(data) and time.monotonic() - begun < PATIENCE_S:
                label = STEPS[len(answers_s) % len(STEPS)]
                answers_s.append(holder.answer_s(label, signs[label], most_s=20.0))
                time.sleep(PAUSE_S)
        end = memory_mb()
        if len(answers_s) < LEAST_PRESSES:
            raise SystemExit(f"{len(answers_s)} presses say nothing: the scan was over too soon.")
        (path,) = data.glob("*.wafer")
        report = Dataset.open(path).check()
        n_frames = Dataset.open(path).scan.plan.n_frames
        return Outcome(n_frames, len(report.missing), len(report.damaged), answers_s, (before, most_mb[0], end))
    finally:
        for browser in browsers:
            browser.close()
        viewer.close()
        shutil.rmtree(data, ignore_errors=True)


def _signs(holder: PlainBrowser) -> dict[str, dict[tuple[str, str], Any]]:
    """Return, for each step, what becomes visible or hidden with it; some of it may stay hidden during a scan."""
    rounds = [[holder.changes(label, LEARN_S) for label in STEPS] for _ in range(3)][1:]
    kept = [
        {key: value for key, value in one.items() if key[1] == "visible" and other.get(key) == value}
        for one, other in zip(*rounds, strict=True)
    ]
    both = [key for key in kept[0].keys() & kept[1].keys() if kept[0][key] != kept[1][key]]
    if not both:
        raise SystemExit("Going from step to step changes nothing.")
    return {label: {key: values[key] for key in both} for label, values in zip(STEPS, kept, strict=True)}


def _until_ready(holder: PlainBrowser) -> None:
    """Take the plan of the tour as soon as the rig is ready, and wait until a scan can begin."""
    begun = time.monotonic()
    while not holder.is_ready("Start scan"):
        if time.monotonic() - begun > PATIENCE_S:
            raise SystemExit("No scan can begin.")
        holder.pick("tour")
        time.sleep(2.0)


def _wait(due: Any, what: str) -> None:
    begun = time.monotonic()
    while not due():
        if time.monotonic() - begun > PATIENCE_S:
            raise SystemExit(f"There is nothing of {what}.")
        time.sleep(0.1)


def _is_over(data: Path) -> bool:
    """Return whether the scan has ended and its surface is complete."""
    try:
        found = [Dataset.open(path) for path in data.glob("*.wafer")]
    except DatasetError:
        return False
    return bool(found) and all(one.finished and one.result().shows_all(one.fields) for one in found)


def main() -> None:
    arguments = read_options(__doc__, watchers=WATCHERS)
    n_watchers = QUICK if arguments.quick else arguments.watchers
    alone, watched = scanned(0), scanned(n_watchers)
    rows = []
    for name, outcome in (("nobody but the holder", alone), (f"{n_watchers}, and one that never reads", watched)):
        times = np.array(outcome.answers_s)
        frames = (outcome.n_frames, outcome.n_missing, outcome.n_damaged)
        spread = (f"{100 * outcome.share:.1f} %", float(np.median(times)), float(np.quantile(times, 0.95)))
        rows.append((name, *frames, len(times), *spread, *outcome.memory_mb))
    show("Scan and reconstruction of the tour, the holder going from step to step", HEADER, rows)
    growth_mb = max(watched.memory_mb) - max(alone.memory_mb)
    lost = watched.n_missing + watched.n_damaged
    print(
        f"\nno frame lost: {met(lost, 0)}; answers: {met(watched.share, SHARE, at_least=True)}; "
        f"memory, {growth_mb:.0f} MB more than with nobody: {met(growth_mb, GROWTH_MB)}"
    )
    sys.exit(lost > 0 or watched.share < SHARE or growth_mb > GROWTH_MB)


if __name__ == "__main__":
    main()
