"""Room that frames take in each compression, how fast they are written and read, and what their OME-XML costs.

    python tests/bench/bench_frames.py [--quick]      one field of a scene of the virtual rig; --quick: the small camera
    python tests/bench/bench_frames.py --dataset NAME.wafer        the first field of a dataset, which stays as it is

Compressing writes a file, reads it back and compares every frame. Reading is that of a new process' first stack: all
frames decoded, or mapped, and compared with their checksums; the files are in the cache of the operating system. The
best of some rounds, in time of one processor, which other work on the machine changes least.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from tests.bench.harness import read_options, show, took
from tests.support.plans import plan_without_motion
from wafer_viewer.model.acquisition.focus_stack import Frame, FrameStatus, Image
from wafer_viewer.model.acquisition.plan import FieldGrid, FocusSweep, Shot
from wafer_viewer.model.job import Job
from wafer_viewer.reconstruct.field_pipeline import reconstruct
from wafer_viewer.rigs.virtual.camera import FrameRenderer, Sensor
from wafer_viewer.rigs.virtual.optics.optics import Optics
from wafer_viewer.rigs.virtual.scenes.catalogue import SCENES
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.dataset.frame_pages import CODECS, decode_pages, map_pages
from wafer_viewer.store.dataset.ome_header import ome_xml
from wafer_viewer.store.dataset.scan_record import frames_file
from wafer_viewer.store.dataset.writer import DatasetWriter

SMALL, FULL = (540, 720), (1080, 1440)
QUICK_SCENES, QUICK_FRAMES, N_FRAMES = ("wafer",), 16, 60
PIXEL_UM, ROUNDS = 0.46729, 2


def main() -> None:
    arguments = read_options(__doc__, dataset=Path)
    if arguments.dataset is not None:
        data = Dataset.open(arguments.dataset)
        stack = data.stack(data.fields[0].number, 0)
        show_field(data.name, stack.images[stack.present])
        return
    size, n_frames = (SMALL, QUICK_FRAMES) if arguments.quick else (FULL, N_FRAMES)
    for name in QUICK_SCENES if arguments.quick else ("wafer", "gauge_blocks"):
        show_field(name, rendered(name, *size, n_frames))


def rendered(name: str, rows: int, cols: int, n_frames: int) -> Image:
    """The frames of one field over the tour of a scene."""
    scene, sensor = SCENES[name], Sensor(rows, cols)
    renderer = FrameRenderer(scene, Optics(), sensor)
    end_um = scene.tour_z_start_um + scene.tour_z_step_um * (scene.tour_frames - 1)
    z_um = np.linspace(scene.tour_z_start_um, end_um, n_frames)
    x_um, y_um = scene.tour_center_um
    return np.stack([renderer.frame(x_um, y_um, z, sensor.nominal_exposure_us, k + 1) for k, z in enumerate(z_um)])


def show_field(name: str, images: Image) -> None:
    with tempfile.TemporaryDirectory() as folder:
        data = stored(Path(folder) / "a.wafer", images)
        field, lines = data.fields[0], data.journal_lines(data.fields[0])
        header_ms = 1e3 * seconds(lambda: ome_xml(data.scan, field, lines))
        mb = images.nbytes / 1e6
        raw_bytes = data.frame_bytes()
        reconstruct(data.stack(1))  # kernels are compiled or loaded
        rows = [row(data, codec, mb, raw_bytes) for codec in CODECS]
    shape = f"{len(images)} frames of {images.shape[2]} x {images.shape[1]} px, {mb:.0f} MB"
    header = "compression | ratio | compress MB/s | read MB/s | verified MB/s | heights s"
    show(f"{name}: {shape}; OME-XML {header_ms:.1f} ms", header, rows)


def row(data: Dataset, codec: str, mb: float, raw_bytes: int) -> tuple[str | float, ...]:
    compress_s = took(lambda: data.compress(codec)).processor_s
    path, shape = frames_file(data.path, data.fields[0]), data.scan.pages(data.fields[0])
    read_s = seconds(lambda: map_pages(path, shape).sum() if codec == "none" else decode_pages(path, shape))

    def verified() -> None:
        path.touch()  # a file that has not changed is neither decoded nor compared again
        Dataset.open(data.path).stack(1)

    heights_s = seconds(lambda: (path.touch(), reconstruct(Dataset.open(data.path).stack(1))), 1)
    ratio = raw_bytes / data.frame_bytes()
    compress = mb / compress_s if codec != "none" else float("nan")
    return codec, f"{ratio:.2f}", compress, mb / read_s, mb / seconds(verified), heights_s


def stored(path: Path, images: Image) -> Dataset:
    """The frames as the only field of a new dataset."""
    n_frames, rows, cols = images.shape
    grid = FieldGrid(rows=1, cols=1, field_width_um=cols * PIXEL_UM, field_height_um=rows * PIXEL_UM)
    job = Job(grid=grid, z_start_um=0.0, sweep=FocusSweep(z_step_um=1.0, n_frames=n_frames))
    plan = plan_without_motion(job, (rows, cols), PIXEL_UM)
    with DatasetWriter.create(path, plan, job, bits=8 * images.dtype.itemsize) as writer:
        for k, image in enumerate(images):
            writer.frame(Frame(Shot(1, k), k, 0.0, 0.0, float(k), 100.0, 1000 * k, FrameStatus.OK, image))
    return Dataset.open(path)


def seconds(work: Callable[[], object], rounds: int = ROUNDS) -> float:
    """The least time of the processor, all threads together."""
    return took(work, rounds).processor_s


if __name__ == "__main__":
    main()
