"""How soon a field's surface is there after its last frame, and the whole after the last field, in real time.

    python tests/bench/bench_live.py [--quick]

A session on the virtual rig with the full camera and a stage in real time, its frames rendered beforehand. A field
counts as there when the state that every page is drawn from holds its surface, and as stitched when it is part of the
map; the whole when the map is solved for all fields and no work is left. The goals, on two idle processors: a field
within 1 s, the whole within 5 s. 9 fields of 101 frames in 2 um steps; --quick: 2 fields of the small camera.
"""

from __future__ import annotations

import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path

from tests.bench.harness import met, read_options, show
from wafer_viewer.model.acquisition.plan import FieldGrid, FocusSweep
from wafer_viewer.model.job import Job
from wafer_viewer.rigs.rig_config import RigConfig
from wafer_viewer.rigs.virtual.scenes.catalogue import scene
from wafer_viewer.session.session import Session
from wafer_viewer.session.state.snapshot import Snapshot

SCENE = scene("wafer")
FIELD_GOAL_S, WHOLE_GOAL_S = 1.0, 5.0
PATIENCE_S = 1800.0


def main() -> None:
    quick = read_options(__doc__).quick
    with tempfile.TemporaryDirectory() as folder:
        seen = live(Path(folder), quick)
    rows = [
        (f"field {n}", *(f"{at_s[n] - taken_s:.2f}" if n in at_s else "" for at_s in (seen.there_s, seen.stitched_s)))
        for n, taken_s in sorted(seen.taken_s.items())
    ]
    show("SIMULATED scan in real time, seconds from the last frame", ("part", "its surface", "stitched"), rows)
    slowest_s = max(at_s - seen.taken_s[n] for n, at_s in seen.there_s.items())
    whole_s = seen.whole_s - max(seen.taken_s.values())
    print(f"slowest field: {slowest_s:.2f} s, goal {FIELD_GOAL_S} s {met(slowest_s, FIELD_GOAL_S)}")
    print(f"whole surface after the last frame: {whole_s:.2f} s, goal {WHOLE_GOAL_S} s {met(whole_s, WHOLE_GOAL_S)}")


@dataclass(slots=True)
class Seen:
    """When so many fields had their last frame, their surface and their place in the map, and when all was done."""

    taken_s: dict[int, float] = field(default_factory=dict[int, float])
    there_s: dict[int, float] = field(default_factory=dict[int, float])
    stitched_s: dict[int, float] = field(default_factory=dict[int, float])
    whole_s: float = 0.0


def live(folder: Path, quick: bool) -> Seen:
    """Scan, and look when what is there."""
    seen = Seen()
    n_frames = SCENE.tour_frames if quick else 101

    def listen(now: Snapshot) -> None:
        at_s = time.perf_counter()
        counts = (
            (seen.taken_s, now.scan.frames_done // n_frames if now.scan else 0),
            (seen.there_s, len(now.dataset.stamps) if now.dataset else 0),
            (seen.stitched_s, now.surface.n_fields if now.surface else 0),
        )
        for times_s, n_fields in counts:
            for n in range(1, n_fields + 1):
                times_s.setdefault(n, at_s)

    session = Session(folder, RigConfig(scene="wafer", size="small" if quick else "full", real_time=True, seed=1))
    try:
        limits = session.wait_until(lambda s: s.rig.state == "ready" and s.compute_ready, PATIENCE_S).rig.limits
        grid = FieldGrid(
            rows=1 if quick else 3,
            cols=2 if quick else 3,
            field_width_um=limits.field_width_um,
            field_height_um=limits.field_height_um,
        ).centred_on(*SCENE.tour_center_um)
        sweep = FocusSweep(z_step_um=SCENE.tour_z_step_um if quick else 2.0, n_frames=n_frames)
        session.edit_job(Job(product=SCENE.title, grid=grid, z_start_um=SCENE.tour_z_start_um, sweep=sweep)).result()
        leave = session.subscribe(listen)
        session.start_scan("live").result(PATIENCE_S)
        session.wait_until(lambda s: s.surface_is_whole or bool(s.faults), PATIENCE_S)
        seen.whole_s = time.perf_counter()
        leave()
        if faults := session.snapshot.faults:
            raise SystemExit(f"The scan failed: {faults}")
    finally:
        session.close()
    return seen


if __name__ == "__main__":
    main()
