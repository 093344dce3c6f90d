"""What a whole wafer of 300 mm takes: fields, bytes, hours of scan, hours of workers; from what one of each costs here.

    python tests/bench/bench_wafer.py [--quick]

Measured: heights of a full-size field of the virtual wafer, 126 frames (24 with --quick, which takes at most a minute),
an overlap, a tile of the mosaic, each by its processor time on one thread; bytes on the disk. The scan is priced by the
planner for a row of fields. What many fields take to be solved for together: python tests/bench/bench_poses.py.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests.bench.bench_workers import COLS, OVERLAP, PIXEL_UM, RECIPE, RESULT, ROWS, make_dataset
from tests.bench.harness import read_options, show, took
from wafer_viewer.acquire.planner import price_all
from wafer_viewer.model.acquisition.plan import FieldGrid, FocusSweep
from wafer_viewer.model.spec import replace
from wafer_viewer.rigs.virtual.rig import virtual_limits
from wafer_viewer.session.surface.stitching_job import bring_up_to_date, compare_pairs, draw_patch, register_pairs
from wafer_viewer.session.surface.worker_tasks import reconstruct_field
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.mosaic.zarr_mosaic import patches
from wafer_viewer.store.mosaic.zarr_shards import SHARD

WAFER_UM = 300_000.0
RUNS = 3
HOUR_S, TERA = 3600.0, 1e12


@dataclass(frozen=True, slots=True)
class Costs:
    """Of one field, of one overlap and of one tile: seconds of a processor, and bytes of one field."""

    heights_s: float
    overlap_s: float
    tile_s: float
    surface_bytes: float
    mosaic_bytes: float


def main() -> None:
    n_frames = 24 if read_options(__doc__).quick else 126
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "wafer.wafer"
        make_dataset(path, 4, n_frames)
        costs = costs_of(path)
    show_wafer(costs, n_frames, *wafer_fields())


def costs_of(path: Path) -> Costs:
    """What the fields of a dataset cost, with kernels loaded."""
    data = Dataset.open(path)
    numbers = [field.number for field in data.fields]
    for number in numbers:
        reconstruct_field(path, number, RESULT, RECIPE)
    bring_up_to_date(path, RESULT, RECIPE)
    kept = data.result(RESULT)
    poses, pair = kept.poses(), np.array([[0, 1]], np.int32)
    drawing = kept.begin_mosaic_update(poses)
    tile = next(p for p in patches(kept.mosaic().shape) if p.level == 1)
    overlap_s = spent_s(lambda: register_pairs(path, RESULT, numbers[:2], pair, None)) + spent_s(
        lambda: compare_pairs(path, RESULT, numbers[:2], pair, poses.x_um[:2], poses.y_um[:2])
    )
    tile_px = (tile.bottom - tile.top) * (tile.right - tile.left)
    return Costs(
        heights_s=spent_s(lambda: reconstruct_field(path, 1, RESULT, RECIPE)),
        overlap_s=overlap_s,
        tile_s=spent_s(lambda: draw_patch(path, RESULT, RECIPE, drawing, kept.mosaic_path, tile)) * SHARD**2 / tile_px,
        surface_bytes=size_of(kept.path / "surfaces") / len(numbers),
        mosaic_bytes=size_of(kept.mosaic_path) / len(numbers),
    )


def wafer_fields() -> tuple[int, int]:
    """Fields that a disc of 300 mm touches, and tiles of level 1 of its mosaic, each 4096 x 4096 px of level 0."""
    width_um, height_um = COLS * PIXEL_UM, ROWS * PIXEL_UM
    pitch_x_um, pitch_y_um = width_um * (1 - OVERLAP), height_um * (1 - OVERLAP)
    return touching(width_um, height_um, pitch_x_um, pitch_y_um), touching(*[2 * SHARD * PIXEL_UM] * 4)


def touching(width_um: float, height_um: float, pitch_x_um: float, pitch_y_um: float) -> int:
    """Rectangles of a grid over the wafer that its disc touches."""
    grids = ((WAFER_UM - size) / pitch for size, pitch in ((width_um, pitch_x_um), (height_um, pitch_y_um)))
    cols, rows = (1 + math.ceil(n) for n in grids)
    x_um = np.abs(np.arange(cols) - (cols - 1) / 2) * pitch_x_um - width_um / 2
    y_um = np.abs(np.arange(rows) - (rows - 1) / 2) * pitch_y_um - height_um / 2
    nearest_um = np.hypot(np.maximum(x_um, 0)[None, :], np.maximum(y_um, 0)[:, None])
    return int(np.count_nonzero(nearest_um < WAFER_UM / 2))


def scan_s(n_frames: int) -> tuple[str, float]:
    """The cheapest strategy for a long row of fields, and what a field of it takes."""
    limits = virtual_limits(ROWS, COLS)
    wide = {axis: replace(getattr(limits, axis), low_um=-WAFER_UM / 2, high_um=WAFER_UM / 2) for axis in ("x", "y")}
    size = {"field_width_um": COLS * PIXEL_UM, "field_height_um": ROWS * PIXEL_UM}
    row = FieldGrid(rows=1, cols=100, overlap_x_fraction=OVERLAP, **size).centred_on(0.0, 0.0)
    sweep = FocusSweep(z_step_um=4.0, n_frames=n_frames)
    prices = price_all(row.fields(), sweep, (100.0,), replace(limits, **wide))
    best = min((p for p in prices if p.predicted_s is not None), key=lambda p: p.predicted_s)
    return best.title, best.predicted_s / row.cols


def show_wafer(costs: Costs, n_frames: int, n_fields: int, n_tiles: int) -> None:
    """One of each, and the whole wafer."""
    strategy, field_s = scan_s(n_frames)
    frame_bytes = n_frames * ROWS * COLS
    rows = [
        ("fields", "1", f"{n_fields}"),
        (f"scan, {strategy}", f"{field_s:.2f} s a field", f"{n_fields * field_s / HOUR_S:.0f} h"),
        ("frames", f"{frame_bytes / 1e6:.0f} MB a field", f"{n_fields * frame_bytes / TERA:.1f} TB"),
        ("heights on disk", f"{costs.surface_bytes / 1e6:.1f} MB a field", tera(n_fields * costs.surface_bytes)),
        ("mosaic on disk", f"{costs.mosaic_bytes / 1e6:.1f} MB a field", tera(n_fields * costs.mosaic_bytes)),
        ("heights", f"{costs.heights_s:.2f} s a field", hours(n_fields * costs.heights_s)),
        ("overlaps, two a field", f"{1e3 * costs.overlap_s:.0f} ms each", hours(2 * n_fields * costs.overlap_s)),
        (f"tiles of {2 * SHARD} px, pyramid", f"{costs.tile_s:.2f} s each", hours(n_tiles * costs.tile_s)),
    ]
    title = f"A wafer of 300 mm, {n_frames} frames a field, {OVERLAP:.0%} overlap; hours of one worker"
    show(title, ("", "one", "the wafer"), rows)


def tera(n_bytes: float) -> str:
    return f"{n_bytes / TERA:.1f} TB"


def hours(seconds: float) -> str:
    return f"{seconds / HOUR_S:.1f} h"


def spent_s(work: Callable[[], object]) -> float:
    """The least processor time of several runs."""
    return took(work, RUNS).processor_s


def size_of(folder: Path) -> int:
    """Bytes of all files in it."""
    return sum(file.stat().st_size for file in folder.rglob("*") if file.is_file())


if __name__ == "__main__":
    main()
