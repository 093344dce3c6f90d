"""What the paper's two jobs cost on the virtual rig, how fast they are priced, and how fast a scan's bookkeeping is.

    python tests/bench/bench_plan.py [--quick]

The scan runs on the virtual rig with empty pictures, so that only planner, wire, firmware and runner are timed; with
--quick it is the gauge-block job's first row of fields, otherwise the whole job.
"""

from __future__ import annotations

import numpy as np

from tests.bench.harness import read_options, took
from wafer_viewer.acquire.planner import plan_scan, price_all
from wafer_viewer.acquire.scan_runner import run_scan
from wafer_viewer.model.acquisition.plan import Field, FocusSweep, ScanPlan
from wafer_viewer.rigs.virtual.rig import VirtualRig, virtual_limits
from wafer_viewer.session.reproduction.paper_samples import FULL

LIMITS = virtual_limits(1080, 1440)
EXPOSURES_US = (100.0,)
Job = tuple[tuple[Field, ...], FocusSweep]


class Dark:
    """Renders nothing."""

    def __init__(self):
        self.image = np.zeros((1080, 1440), np.uint8)

    def frame(self, x_um, y_um, z_um, exposure_us, seed):
        return self.image


class Nowhere:
    """Fulfils ScanSink and ScanControl, keeps nothing and stops nothing."""

    def should_stop(self):
        return False

    def should_pause(self):
        return False

    def __getattr__(self, name):
        return lambda *_: None


JOBS: dict[str, Job] = {
    sample.name: (sample.job.all_fields(), sample.job.sweep) for sample in FULL if sample.rows * sample.cols > 1
}
"""Fields and sweep of the paper's jobs."""


def main() -> None:
    quick = read_options(__doc__).quick
    for title, job in JOBS.items():
        show_prices(title, *job)
    fields, sweep = next(iter(JOBS.values()))
    show_scan(plan_scan(fields[:7] if quick else fields, sweep, EXPOSURES_US, LIMITS))


def show_prices(title: str, fields: tuple[Field, ...], sweep: FocusSweep) -> None:
    """The table that the operator sees, and the milliseconds that it took."""
    price_all(fields, sweep, EXPOSURES_US, LIMITS)
    priced = took(lambda: price_all(fields, sweep, EXPOSURES_US, LIMITS))
    floor_s = len(fields) * sweep.n_frames / LIMITS.camera.frame_rate_hz
    print(f"{title}, {len(fields)} fields of {sweep.n_frames} frames: camera's floor {floor_s:.1f} s")
    print(f"  all strategies priced in {1e3 * priced.clock_s:.0f} ms")
    for price in sorted(priced.result, key=lambda p: p.predicted_s or float("inf")):
        cost = f"{price.predicted_s:8.1f} s  {price.motions:6d} motions" if price.predicted_s else price.ruled_out
        print(f"  {price.title:24s} {cost}")


def show_scan(plan: ScanPlan) -> None:
    """Predicted against the virtual clock, and the processor's time for each frame."""
    rig = VirtualRig(limits=LIMITS, renderer=Dark())
    scanned = took(lambda: run_scan(plan, rig, Nowhere(), Nowhere()))
    outcome, us = scanned.result, scanned.clock_s / plan.n_frames * 1e6
    rig.close()
    print(
        f"{plan.n_frames} frames scanned: predicted {plan.predicted_s:.2f} s, "
        f"took {outcome.duration_s:.2f} s of the rig's time, {len(outcome.missing)} missing; {us:.0f} us a frame"
    )


if __name__ == "__main__":
    main()
