"""The default tour, 3 x 3 fields of 60 frames on the virtual rig: from Start to the stitched surface.

    python tests/bench/bench_tour.py [--quick]

The goal is 30 s on two processors, with the page usable meanwhile: while the scan runs, the page's server is asked
for the page twenty times a second, and the slowest answer is told. The full run also takes the tour as soon as it can
and on a machine that has never compiled a kernel; --quick takes 2 x 1 of its fields, once.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import threading
import time
import urllib.request
from dataclasses import dataclass
from pathlib import Path

from wafer_viewer.gui.app import start
from wafer_viewer.model.spec import replace
from wafer_viewer.session.session import Session

GOAL_S, ANSWER_GOAL_S = 30.0, 0.5
PATIENCE_S = 600.0
ASK_EVERY_S = 0.05


@dataclass(frozen=True)
class Tour:
    """Seconds of one tour."""

    until_rig_s: float
    until_warm_s: float
    scan_s: float
    surface_s: float
    slowest_answer_s: float
    overlap_rms_um: float | None


class Asker:
    """Asks for the page again and again, and remembers the slowest answer."""

    def __init__(self, address: str) -> None:
        self._opener = urllib.request.build_opener(urllib.request.HTTPCookieProcessor())
        self._address = address
        self._over = threading.Event()
        self.slowest_s = 0.0
        self._thread = threading.Thread(target=self._ask)

    def __enter__(self) -> Asker:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()

    def _ask(self) -> None:
        while not self._over.wait(ASK_EVERY_S):
            asked = time.perf_counter()
            self._opener.open(self._address, timeout=30).read()
            self.slowest_s = max(self.slowest_s, time.perf_counter() - asked)


def take_tour(folder: Path, *, wait_for_kernels: bool, short: bool = False) -> Tour:
    began = time.perf_counter()
    session = Session(folder)
    running = start(session)
    try:
        session.wait_until(lambda s: s.rig.state == "ready", PATIENCE_S)
        until_rig_s = time.perf_counter() - began
        if wait_for_kernels:
            session.wait_until(lambda s: s.compute_ready, PATIENCE_S)
        until_warm_s = time.perf_counter() - began
        session.take_tour().result()
        if short:
            job = session.snapshot.draft.job
            session.edit_job(replace(job, grid=job.grid.resized(rows=1, cols=2))).result()
        pressed = time.perf_counter()
        with Asker(running.address) as asker:
            session.start_scan().result()
            session.wait_until(lambda s: not s.scanning, PATIENCE_S)
            scan_s = time.perf_counter() - pressed
            done = session.wait_until(lambda s: s.surface_is_whole or bool(s.faults), PATIENCE_S)
            surface_s = time.perf_counter() - pressed
        if done.surface is None:
            raise SystemExit(f"The tour failed: {done.faults}")
        return Tour(until_rig_s, until_warm_s, scan_s, surface_s, asker.slowest_s, done.surface.overlap_rms_um)
    finally:
        running.stop()
        session.close()


def report(title: str, tour: Tour) -> None:
    met = "met" if tour.surface_s <= GOAL_S else "MISSED"
    answered = "met" if tour.slowest_answer_s <= ANSWER_GOAL_S else "MISSED"
    print(
        f"{title:<28} rig ready {tour.until_rig_s:6.1f} s, kernels {tour.until_warm_s:6.1f} s | from Start: scan "
        f"{tour.scan_s:5.1f} s, surface {tour.surface_s:5.1f} s (goal {GOAL_S:.0f} s {met}) | slowest answer of the "
        f"page {tour.slowest_answer_s * 1e3:4.0f} ms (goal {answered}) | overlap rms {tour.overlap_rms_um or 0:.3f} um",
        flush=True,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description="From Start to the stitched surface of the default tour.")
    parser.add_argument("--quick", action="store_true", help="two fields of the tour, once")
    quick = parser.parse_args().quick
    with tempfile.TemporaryDirectory() as folder:
        report("kernels compiled before", take_tour(Path(folder) / "warm", wait_for_kernels=True, short=quick))
        if not quick:
            report("Start as soon as possible", take_tour(Path(folder) / "soon", wait_for_kernels=False))
            os.environ["WAFER_VIEWER_CACHE"] = str(Path(folder) / "cache")
            report("nothing compiled before", take_tour(Path(folder) / "cold", wait_for_kernels=False))


if __name__ == "__main__":
    main()
