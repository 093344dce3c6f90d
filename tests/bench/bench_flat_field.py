"""Grey of a stitched picture with and without a flat field, on a virtual rig with shading and a dark level.

    python tests/bench/bench_flat_field.py [--quick] [--figure FILE.png]

A blank plane is scanned twice into one data folder, before and after its flat field is accepted. *Seam* is the root
mean square difference of the grey of two fields beside each other, over blocks of 16 x 16 pixels of their overlap.
--quick takes small fields.
"""

from __future__ import annotations

import io
import tempfile
from itertools import pairwise
from pathlib import Path

import numpy as np

from tests.bench.harness import read_options
from wafer_viewer.model.acquisition.plan import FieldGrid, FocusSweep
from wafer_viewer.model.acquisition.sample import Sample
from wafer_viewer.model.job import Job
from wafer_viewer.reconstruct.field_pipeline import reconstruct
from wafer_viewer.reconstruct.stitching import stitch
from wafer_viewer.rigs.virtual.faults import CalibrationErrors
from wafer_viewer.rigs.virtual.rig import PIXEL_UM, VirtualRig, virtual_limits
from wafer_viewer.session.acquisition.headless import scan_to
from wafer_viewer.session.calibration.frames import CalibrationSite
from wafer_viewer.session.calibration.headless import accept_calibration, run_calibration
from wafer_viewer.store.dataset.dataset import Dataset

ERRORS = CalibrationErrors(shading_fraction=0.06, black_counts=4)
BLOCK = 16
OVERLAP = 0.12
DRAWN, GREYS = 6, 12
"""Side of the blocks of the figure in pixels, and its grey values."""


def main() -> None:
    chosen = read_options(__doc__, figure=Path)
    shape = (180, 240) if chosen.quick else (540, 720)
    pictures = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, heights in scans(Path(folder), shape):
            pictures[name] = stitched_grey(heights)
            seam = seam_difference([h.all_in_focus for h in heights], shape)
            print(f"{name:<20} seam {seam:6.2%}   heights {mean_um(heights):.9f} um", flush=True)
    if chosen.figure is not None:
        draw(pictures, chosen.figure)


def scans(folder: Path, shape: tuple[int, int]):
    """The heights of all fields, without and with the flat field."""
    rig = VirtualRig("plane", seed=1, limits=virtual_limits(*shape), errors=ERRORS)
    try:
        yield "without flat field", scanned(rig, folder / "before.wafer")
        site = CalibrationSite(x_um=0.0, y_um=0.0, z_um=0.0, z_range_um=60.0)
        found = run_calibration(rig, "flat-field", folder, site)
        accept_calibration(rig, folder, found, "bench")
        yield "with flat field", scanned(rig, folder / "after.wafer")
    finally:
        rig.close()


def scanned(rig: VirtualRig, path: Path):
    """The height maps of a scan of 2 x 3 fields."""
    rows, cols = rig.limits.camera.rows, rig.limits.camera.cols
    grid = FieldGrid(
        rows=2,
        cols=3,
        field_width_um=cols * PIXEL_UM,
        field_height_um=rows * PIXEL_UM,
        overlap_x_fraction=OVERLAP,
        overlap_y_fraction=OVERLAP,
    )
    sweep = FocusSweep(z_step_um=2.4, n_frames=12)
    sample = Sample(name="plane", lot="L", wafer_id="W")
    job = Job(product="plane", sample=sample, grid=grid.centred_on(0.0, 0.0), z_start_um=-13.2, sweep=sweep)
    ended = scan_to(path, job, rig, lambda _: None, lambda _: None, print)
    if ended.error:
        raise SystemExit(ended.error)
    data = Dataset.open(path)
    return [reconstruct(data.stack(field.number)) for field in data.fields]


def stitched_grey(heights):
    mosaic = stitch(heights)
    return np.asarray(mosaic.window().all_in_focus)


def mean_um(heights) -> float:
    return float(np.mean([np.nanmean(one.z_raw_um) for one in heights]))


def seam_difference(pictures, shape: tuple[int, int]) -> float:
    """Differences in the overlaps of fields side by side, by the places of the stage."""
    wide = round(shape[1] * OVERLAP)
    ratios = []
    for row in (pictures[:3], pictures[3:]):
        for left, right in pairwise(row):
            a, b = (block_means(part.astype(float)) for part in (left[:, -wide:], right[:, :wide]))
            ratios.append((a - b) / (a + b) * 2)
    return float(np.sqrt(np.mean(np.concatenate([r.ravel() for r in ratios]) ** 2)))


def block_means(grey, side: int = BLOCK):
    rows, cols = (n // side for n in grey.shape)
    return grey[: rows * side, : cols * side].reshape(rows, side, cols, side).mean(axis=(1, 3))


def draw(pictures, path: Path) -> None:
    from matplotlib.figure import Figure
    from PIL import Image

    figure = Figure(figsize=(9, 2.6), layout="constrained")
    for axes, (name, grey) in zip(figure.subplots(1, 2), pictures.items(), strict=True):
        mean = float(np.mean(grey[grey > 0]))
        axes.imshow(block_means(grey, DRAWN), cmap="gray", vmin=0.85 * mean, vmax=1.1 * mean)
        axes.set_title(name)
        axes.set_axis_off()
    buffer = io.BytesIO()
    figure.savefig(buffer, dpi=90)
    Image.open(buffer).convert("L").quantize(GREYS).save(path, optimize=True)


if __name__ == "__main__":
    main()
