"""What comparing two large surfaces takes: time, memory, and whether what was moved and changed is found.

    python tests/bench/bench_compare.py [--quick]

A made-up wafer of 165 million points (--quick: 4 million) is compared with itself, laid down 7.3 and -4.1 um off,
1.2 um higher and tilted, with a pad more and noise of its own. Peak memory is that of a process of its own, without
mapped files.
"""

from __future__ import annotations

import dataclasses
import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests.bench.big_mosaic import RESULT, WAFER_PX, MadeWafer, big_dataset
from tests.bench.harness import alone, highest, met, read_options, show, took
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.comparison import Comparison, SurfaceName
from wafer_viewer.model.surface.height_map import HeightMap, Provenance
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.mosaic.zarr_mosaic import write_mosaic

QUICK_PX = 2048
SHIFT_UM, HIGHER_UM, TILT_MRAD, PAD_UM, PAD_PX, NOISE_UM = (7.3, -4.1), 1.2, 0.05, 3.0, 120, 0.05
GOAL_GB = 1.5
NAME = "difference-again"


@dataclass(frozen=True)
class LaidAnew:
    """The wafer as it is found once it was put on the stage again."""

    wafer: MadeWafer
    levels: int = 1
    provenance: Provenance = Provenance(simulated=True)

    @property
    def shape(self) -> tuple[int, int]:
        return self.wafer.shape

    @property
    def pixel_um(self) -> float:
        return self.wafer.pixel_um

    @property
    def x0_um(self) -> float:
        return self.wafer.x0_um - SHIFT_UM[0]

    @property
    def y0_um(self) -> float:
        return self.wafer.y0_um - SHIFT_UM[1]

    def window(self, region: Region | None = None, level: int = 0) -> HeightMap:
        """The wafer's own window, where the stage says it lies now."""
        here = None if region is None else _moved(region)
        part = self.wafer.window(here, level)
        x, y = part.x_um[None, :], part.y_um[:, None]
        pad = (np.abs(x) < PAD_PX / 2 * self.pixel_um) & (np.abs(y) < PAD_PX / 2 * self.pixel_um)
        noise = np.random.default_rng(abs(round(part.x0_um + part.y0_um))).normal(0, NOISE_UM, part.shape)
        z = (part.z_um + HIGHER_UM + 1e-3 * TILT_MRAD * x + PAD_UM * pad + noise).astype(np.float32)
        moved = {"x0_um": part.x0_um - SHIFT_UM[0], "y0_um": part.y0_um - SHIFT_UM[1]}
        return dataclasses.replace(part, z_um=z, z_raw_um=z, provenance=self.provenance, **moved)


def _moved(region: Region) -> Region:
    x0, y0, x1, y1 = region.bounds_um
    return Region.rectangle(x0 + SHIFT_UM[0], y0 + SHIFT_UM[1], x1 + SHIFT_UM[0], y1 + SHIFT_UM[1])


def main() -> None:
    side_px = QUICK_PX if read_options(__doc__).quick else WAFER_PX
    first = big_dataset(side_px)
    again = first.with_name(f"laid-anew-{side_px}.wafer")
    try:
        _make(first, again, side_px)
        _report(*alone(_compare, again, first), side_px)
    finally:
        shutil.rmtree(again, ignore_errors=True)


def _make(first: Path, again: Path, side_px: int) -> None:
    shutil.rmtree(again, ignore_errors=True)
    again.mkdir()
    for name in ("scan.json", "journal.jsonl"):
        shutil.copy(first / name, again / name)
    kept = Dataset.open(again).result(RESULT)
    kept.path.mkdir(parents=True)
    write_mosaic(kept.mosaic_path, LaidAnew(MadeWafer(side_px)), threads=2)


def _compare(again: Path, first: Path) -> tuple[Comparison, float, float]:
    """The comparison, the most memory of its process in GB, and its seconds."""
    from wafer_viewer.session.surface.comparison_job import subtract

    names = SurfaceName(path=str(first)), SurfaceName(path=str(again))
    with highest(every_s=0.05) as peak_mb:
        compared = took(lambda: subtract(again, NAME, *names, "images", False))
    return compared.result, peak_mb[0] * 1024**2 / 1e9, compared.clock_s


def _report(comparison: Comparison, peak_gb: float, seconds: float, side_px: int) -> None:
    found, change = comparison.registration, comparison.change
    pixel_um = MadeWafer(side_px).pixel_um
    show(
        f"{side_px**2 / 1e6:.0f} million points compared",
        ("", "found", "true", "U (k = 2)"),
        [
            ("x, um", found.x_um, SHIFT_UM[0], found.u_xy_um),
            ("y, um", found.y_um, SHIFT_UM[1], found.u_xy_um),
            ("turn, mrad", found.turn_mrad, 0.0, found.u_turn_mrad),
            ("tilt x, mrad", found.tilt_x_mrad, -TILT_MRAD, found.u_tilt_mrad),
            ("changed, net um3", change.gained_um3 - change.lost_um3, PAD_UM * (PAD_PX * pixel_um) ** 2, None),
            ("left over, um", found.residual_um, None, None),
        ],
    )
    print(f"\n{seconds:.0f} s; peak memory {peak_gb:.2f} GB, goal {GOAL_GB} GB: {met(peak_gb, GOAL_GB)}")


if __name__ == "__main__":
    main()
