"""Large stitched surfaces for the page's benchmarks: a made-up wafer as wide as wanted, written as any other is.

Dies with pads, streets with a scratch, the bow of the wafer, pixels that were not measured. Made once and kept between
runs under the folder for temporary files; a dataset of it has no frames, for nobody asks for them.
"""

from __future__ import annotations

import os
import shutil
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tests.bench.harness import HOME
from wafer_viewer.model.acquisition.plan import FieldGrid, FocusSweep, ScanPlan
from wafer_viewer.model.job import Job
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.height_map import HeightMap, Origin, Provenance, pixel_window
from wafer_viewer.session.core.dataset_library import save_summary, summarise
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.dataset.scan_record import JOURNAL, Finished, JournalWriter, ScanRecord, write_record
from wafer_viewer.store.mosaic.zarr_mosaic import write_mosaic

PIXEL_UM = 0.46729
FIELD_ROWS, FIELD_COLS = 1080, 1440
WAFER_PX, BLOCKS_PX, QUICK_PX = 12_850, 6_633, 3_300
"""Sides of a mosaic of 165 million points, as many as the paper's wafer has; of 44 million, its gauge blocks; of 11."""
RESULT = "default"
TAKEN = "2026-01-01T00:00:00"
_DIE_UM, _STREET_UM, _PAD_UM, _PAD_PITCH_UM = (820.0, 610.0), 46.0, 32.0, 64.0
_NOISE_PX = 1024
Floats = NDArray[np.float32]


@dataclass(frozen=True)
class MadeWafer:
    """A wafer of `side_px` x `side_px` pixels, its middle at the stage's zero; read as any mosaic is."""

    side_px: int
    pixel_um: float = PIXEL_UM
    levels: int = 1
    provenance: Provenance = Provenance(simulated=True)

    @property
    def shape(self) -> tuple[int, int]:
        return self.side_px, self.side_px

    @property
    def x0_um(self) -> float:
        return -(self.side_px - 1) / 2 * self.pixel_um

    @property
    def y0_um(self) -> float:
        return -self.x0_um

    def window(self, region: Region | None = None, level: int = 0) -> HeightMap:
        """The part that holds a region."""
        whole = slice(0, self.side_px), slice(0, self.side_px)
        rows, cols = whole if region is None else pixel_window(self, region, level)
        x = (self.x0_um + np.arange(cols.start, cols.stop) * self.pixel_um).astype(np.float32)[None, :]
        y = (self.y0_um - np.arange(rows.start, rows.stop) * self.pixel_um).astype(np.float32)[:, None]
        grain = self._grain[np.ix_(np.arange(rows.start, rows.stop) % _NOISE_PX, _run(cols))]
        raised = _raised(x, y)
        z = (_bow(x, y, self.side_px * self.pixel_um) + raised + np.float32(0.08) * grain).astype(np.float32)
        origin = _origin(x, y, raised, grain, self.side_px * self.pixel_um)
        z[origin != Origin.MEASURED] = np.nan
        grey = np.clip(96 + 8 * raised + 22 * grain, 0, 255).astype(np.uint8)
        return HeightMap(
            z_um=z, z_raw_um=z, confidence=np.where(origin == Origin.MEASURED, np.float32(0.9), np.float32(0.1)),
            all_in_focus=grey, origin=origin, overlap_um=_overlaps(rows, cols, grain), pixel_um=self.pixel_um,
            x0_um=self.x0_um + cols.start * self.pixel_um, y0_um=self.y0_um - rows.start * self.pixel_um,
            provenance=self.provenance,
        )  # fmt: skip

    @cached_property
    def _grain(self) -> Floats:
        return np.random.default_rng(1).normal(0, 1, (_NOISE_PX, _NOISE_PX)).astype(np.float32)


def _run(part: slice) -> NDArray[np.intp]:
    return np.arange(part.start, part.stop) % _NOISE_PX


def _bow(x: Floats, y: Floats, width_um: float) -> Floats:
    """The wafer is higher in its middle, and tilted a little."""
    return 28 * (1 - (x * x + y * y) / (0.5 * width_um * width_um)) + np.float32(1.5e-3) * x


def _raised(x: Floats, y: Floats) -> Floats:
    """Dies stand 9 um over the streets, their pads 4 um over them."""
    u, v = (np.mod(along, pitch) for along, pitch in zip((x, y), _DIE_UM, strict=True))
    inside = (u > _STREET_UM) & (v > _STREET_UM)
    pads = (np.mod(u, _PAD_PITCH_UM) < _PAD_UM) & (np.mod(v, _PAD_PITCH_UM) < _PAD_UM)
    pads &= (v < 3 * _PAD_PITCH_UM) | (v > _DIE_UM[1] - 2.5 * _PAD_PITCH_UM)
    scratch = np.abs(y - 0.31 * x - 120) < 3
    return (9.0 * inside + 4.0 * (inside & pads) - 2.5 * (inside & scratch)).astype(np.float32)


def _origin(x: Floats, y: Floats, raised: Floats, grain: Floats, width_um: float) -> NDArray[np.uint8]:
    """One pixel in two hundred has no texture, discs as large as a pad are too bright, beyond the rim is nothing."""
    origin = np.where(grain > 2.576, np.uint8(Origin.NO_TEXTURE), np.uint8(Origin.MEASURED))
    glare = np.hypot(np.mod(x, 1730) - 400, np.mod(y, 1270) - 300) < 26
    origin[glare & (raised > 0)] = Origin.CLIPPED
    origin[x * x + y * y > (0.497 * width_um * 1.16) ** 2] = Origin.NOT_COVERED
    return origin


def _overlaps(rows: slice, cols: slice, grain: Floats) -> Floats:
    """Where neighbouring fields of the usual size overlap by an eighth."""
    across = np.mod(np.arange(cols.start, cols.stop), FIELD_COLS * 7 // 8) < FIELD_COLS // 8
    along = np.mod(np.arange(rows.start, rows.stop), FIELD_ROWS * 7 // 8) < FIELD_ROWS // 8
    return np.where(along[:, None] | across[None, :], np.abs(grain) * np.float32(0.1), np.float32(np.nan))


def big_dataset(side_px: int) -> Path:
    """The dataset of a made-up wafer, made now or kept from before."""
    path = HOME / f"made-{side_px}.wafer"
    if not (path / "results" / RESULT / "surface.json").exists():
        shutil.rmtree(path, ignore_errors=True)
        unfinished = path.with_name(f"unfinished-{os.getpid()}.wafer")
        _make(unfinished, MadeWafer(side_px))
        with suppress(OSError):  # another has made it meanwhile
            unfinished.rename(path)
        shutil.rmtree(unfinished, ignore_errors=True)
    return path


def _make(path: Path, wafer: MadeWafer) -> None:
    path.mkdir(parents=True)
    journal = JournalWriter(path / JOURNAL)
    journal.write(Finished(TAKEN))
    journal.close()
    job, plan = _plan(wafer)
    write_record(path, ScanRecord(software_version="bench", taken=TAKEN, simulated=True, job=job, plan=plan))
    result = Dataset.open(path).result(RESULT)
    result.save_recipe(job.recipe)
    save_summary(result, summarise(write_mosaic(result.mosaic_path, wafer), len(plan.fields), RESULT))


def _plan(wafer: MadeWafer) -> tuple[Job, ScanPlan]:
    """The fields that such a wafer is stitched from."""
    width_um, height_um = FIELD_COLS * wafer.pixel_um, FIELD_ROWS * wafer.pixel_um
    n_cols, n_rows = (-(-8 * wafer.side_px // (7 * side)) for side in (FIELD_COLS, FIELD_ROWS))
    size = {"field_width_um": width_um, "field_height_um": height_um}
    grid = FieldGrid(rows=n_rows, cols=n_cols, overlap_x_fraction=0.125, overlap_y_fraction=0.125, **size)
    sweep = FocusSweep(z_step_um=4.0, n_frames=5)
    job = Job(grid=grid.centred_on(0.0, 0.0), sweep=sweep)
    about = {"exposures_us": (100.0,), "strategy": "z_up", "legs": (), "predicted_s": 1.0, "prices": ()}
    size = {"rows": FIELD_ROWS, "cols": FIELD_COLS, "pixel_um": wafer.pixel_um}
    return job, ScanPlan(fields=job.all_fields(), sweep=sweep, **size, **about)
