"""The tour on the virtual rig, from *Take the tour* to its report, by the verbs that its buttons ask for.

    python tests/bench/bench_tour.py [--quick]

The goals, on two idle processors: the first surface within 20 s, the report within 90 s, and the page usable meanwhile:
while the scan runs, the page's server is asked for the page twenty times a second, and the slowest answer is told. A
person who reads the notes of the tour takes longer; the card of the first start promises what is told here, rounded up.
The full run also takes the tour as soon as the rig answers, and on a machine that has never compiled a kernel;
--quick takes it once.
"""

from __future__ import annotations

import os
import tempfile
import time
import urllib.request
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import msgspec

from tests.bench.harness import goal, highest, read_options, took
from wafer_viewer.gui.app import start
from wafer_viewer.gui.scene.heightfield import HeightField
from wafer_viewer.gui.scene.scene_contents import DisplayedSurface
from wafer_viewer.gui.scenes.surface_scene import source_of
from wafer_viewer.gui.tools.initial_regions import initial_regions
from wafer_viewer.model.region import Region
from wafer_viewer.model.report import ReportOrder
from wafer_viewer.session.rendering.render_request import (
    CoarseHeightField,
    ColourScale,
    RenderRequest,
    SurfaceStatistics,
)
from wafer_viewer.session.session import Session

SURFACE_GOAL_S, REPORT_GOAL_S, ANSWER_GOAL_S = 20.0, 90.0, 0.5
PATIENCE_S = 600.0
ASK_EVERY_S = 0.05


@dataclass(frozen=True)
class Tour:
    """Seconds from *Take the tour*, what was found, and the slowest answer of the page meanwhile."""

    first_surface_s: float
    scan_s: float
    surface_s: float
    kept_s: float
    inspected_s: float
    report_s: float
    step: str
    defects: str
    report: str
    slowest_answer_s: float


def take_tour(folder: Path, *, wait_for_kernels: bool) -> Tour:
    """Take it as its notes lead."""
    session = Session(folder)
    running = start(session)
    try:
        session.wait_until(lambda s: s.rig.state == "ready" and s.overview is not None, PATIENCE_S)
        if wait_for_kernels:
            session.wait_until(lambda s: s.compute_ready, PATIENCE_S)
        began = time.perf_counter()

        def gone() -> float:
            return time.perf_counter() - began

        session.take_tour().result(PATIENCE_S)
        opener = urllib.request.build_opener(urllib.request.HTTPCookieProcessor())

        def answer_s() -> float:
            return took(lambda: opener.open(running.address, timeout=30).read()).clock_s

        with highest(answer_s, ASK_EVERY_S) as slowest_s:
            session.start_scan().result(PATIENCE_S)
            session.wait_until(lambda s: s.surface is not None or bool(s.faults), PATIENCE_S)
            first_surface_s = gone()
            session.wait_until(lambda s: not s.scanning, PATIENCE_S)
            scan_s = gone()
            done = session.wait_until(lambda s: s.surface_is_whole or bool(s.faults), PATIENCE_S)
            surface_s = gone()
        if done.surface is None:
            raise SystemExit(f"The tour failed: {done.faults}")
        kept = session.keep(session.measure("step", first_step(session))).result(PATIENCE_S)
        kept_s = gone()
        found = session.defects.inspect().result(PATIENCE_S).found
        inspected_s = gone()
        if found:
            session.defects.judge(found[0].number, judgement="real").result(PATIENCE_S)
        report = session.papers.write_report(ReportOrder()).result(PATIENCE_S)
        height = kept.main
        return Tour(
            first_surface_s, scan_s, surface_s, kept_s, inspected_s, gone(),
            step=f"{height.value:.2f} ± {height.expanded or float('nan'):.2f} um",
            defects=", ".join(f"{n} {kind}" for kind, n in Counter(d.seen_as for d in found).most_common()) or "none",
            report=f"{report.stat().st_size / 1e6:.1f} MB",
            slowest_answer_s=slowest_s[0],
        )  # fmt: skip
    finally:
        running.stop()
        session.close()


def first_step(session: Session) -> tuple[Region, ...]:
    """Where the page lays the two faces of a step to begin with."""
    source = source_of(session.snapshot, 0)
    if source is None:
        raise SystemExit("There is no surface to measure.")
    facts = msgspec.msgpack.decode(
        session.paint(RenderRequest(source, "facts")).result(PATIENCE_S), type=SurfaceStatistics
    )
    relief = msgspec.msgpack.decode(
        session.paint(RenderRequest(source, "relief")).result(PATIENCE_S), type=CoarseHeightField
    )
    scale = ColourScale("height", 0.0, 1.0, 0.0, 1.0, 0.0, 1.0, ())
    height_field = HeightField(relief, DisplayedSurface(source, facts, scale, facts.lowest_um, 1.0))
    x0, y0, x1, y1 = height_field.bounds_um
    return initial_regions("step", height_field, ((x0 + x1) / 2, (y0 + y1) / 2))


def report(title: str, tour: Tour) -> None:
    slowest_s = tour.slowest_answer_s
    print(
        f"{title:<26} from Take the tour: first surface {tour.first_surface_s:.1f} s "
        f"{goal(tour.first_surface_s, SURFACE_GOAL_S, ' s')}, scan {tour.scan_s:.1f} s, all fields stitched "
        f"{tour.surface_s:.1f} s, step kept {tour.kept_s:.1f} s, inspected {tour.inspected_s:.1f} s, report "
        f"{tour.report_s:.1f} s {goal(tour.report_s, REPORT_GOAL_S, ' s')}\n"
        f"{'':<26} step {tour.step} | found: {tour.defects} | report of {tour.report} | slowest answer of the page "
        f"{slowest_s:.1f} s {goal(slowest_s, ANSWER_GOAL_S, ' s')}",
        flush=True,
    )


def main() -> None:
    quick = read_options(__doc__).quick
    with tempfile.TemporaryDirectory() as folder:
        report("kernels compiled before", take_tour(Path(folder) / "warm", wait_for_kernels=True))
        if not quick:
            report("as soon as the rig answers", take_tour(Path(folder) / "soon", wait_for_kernels=False))
            os.environ["WAFER_VIEWER_CACHE"] = str(Path(folder) / "cache")
            report("nothing compiled before", take_tour(Path(folder) / "cold", wait_for_kernels=False))


if __name__ == "__main__":
    main()
