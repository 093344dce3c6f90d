"""What it costs that the frames of a pass are on the disk when it has ended, on the disk of a folder.

    python tests/bench/bench_durable.py [--quick] [--folder DIR]        --quick: the small camera, fewer passes

Passes of one field each are written as fast as they can be, in turn with and without waiting for the disk (os.fsync
does nothing then). The wait is compared with the time that such a pass takes on the rig at 60 frames a second. A disk
with other work to do varies a lot: the least of some passes, and the median.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from tests.bench.harness import read_options, show, took
from tests.support.plans import plan_without_motion
from wafer_viewer.model.acquisition.devices import PulseSummary
from wafer_viewer.model.acquisition.focus_stack import Frame, FrameStatus, Image
from wafer_viewer.model.acquisition.plan import FieldGrid, FocusSweep, Leg, PulseTrain, Shot
from wafer_viewer.model.job import Job
from wafer_viewer.store.dataset.writer import DatasetWriter

SMALL, FULL = (540, 720), (1080, 1440)
N_FRAMES, RATE_HZ, PIXEL_UM = 60, 60.0, 0.46729


def main() -> None:
    arguments = read_options(__doc__, folder=Path)
    rows = []
    for size in (SMALL,) if arguments.quick else (SMALL, FULL):
        rows.append(row(size, 6 if arguments.quick else 12, arguments.folder))
    header = "camera | MB a pass | ms without | ms with | ratio | median ratio | waits' share of the rig's 1 s"
    show(f"Passes of {N_FRAMES} frames, least of some", header, rows)


def row(size: tuple[int, int], n_passes: int, folder: Path | None) -> tuple[str | float, ...]:
    """Return the seconds of passes with and without waiting, in turn, each into fields of their own."""
    image = np.random.default_rng(1).integers(0, 255, size, np.uint8)
    job = Job(
        grid=FieldGrid(
            rows=1, cols=2 * n_passes, field_width_um=size[1] * PIXEL_UM, field_height_um=size[0] * PIXEL_UM
        ),
        sweep=FocusSweep(z_step_um=2.0, n_frames=N_FRAMES),
        exposures_us=(100.0,),
    )
    plan = plan_without_motion(job, size, PIXEL_UM)
    without, waited = list[float](), list[float]()
    with (
        tempfile.TemporaryDirectory(dir=folder) as place,
        DatasetWriter.create(Path(place) / "a.wafer", plan, job) as writer,
    ):
        for n, field in enumerate(plan.fields):
            if n % 2:
                waited.append(pass_s(writer, n, field.number, image))
            else:
                with no_waiting():
                    without.append(pass_s(writer, n, field.number, image))
                os.sync()  # what was not waited for is not waited for by the next one
    low, high = min(without), min(waited)
    share = f"{100 * (high - low) * RATE_HZ / N_FRAMES:.1f} %"
    ratio = float(np.median(waited) / np.median(without))
    mb = N_FRAMES * image.nbytes / 1e6
    return f"{size[1]} x {size[0]}", mb, 1e3 * low, 1e3 * high, high / low, ratio, share


def pass_s(writer: DatasetWriter, number: int, field: int, image: Image) -> float:
    shots = tuple(Shot(field, k) for k in range(N_FRAMES))
    train = PulseTrain(axis="z", first_count=0, counts_per_frame=20, n_frames=N_FRAMES, direction=1)
    leg = Leg(train=train, shots=shots, x_um=0.0, y_um=0.0, z_um=0.0, speed_um_s=50.0)

    def write() -> None:
        writer.pass_begun(number, leg)
        for shot in shots:
            at = (20 * shot.k, 0.0, 0.0, 2.0 * shot.k)
            writer.frame(Frame(shot, *at, 100.0, 17_000 * shot.k, FrameStatus.OK, image))
        writer.pass_ended(number, PulseSummary(N_FRAMES, 0, 0, N_FRAMES))

    return took(write).clock_s


@contextmanager
def no_waiting() -> Generator[None]:
    """Let os.fsync do nothing."""
    waiting = os.fsync
    os.fsync = lambda _: None  # pyright: ignore[reportAttributeAccessIssue]
    try:
        yield
    finally:
        os.fsync = waiting


if __name__ == "__main__":
    main()
