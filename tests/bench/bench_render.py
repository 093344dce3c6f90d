"""How fast the virtual microscope renders; --quick: with the small camera only.

    python tests/bench/bench_render.py [--quick]

For every scene and camera size: preparing a field, one frame averaged over the scene's tour, one exposure, one core.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable

import numpy as np

from tests.bench.harness import read_options, took
from wafer_viewer.rigs.virtual.camera import FrameRenderer, Sensor, tour_range
from wafer_viewer.rigs.virtual.optics.optics import FieldPicture, Optics
from wafer_viewer.rigs.virtual.scenes.catalogue import SCENES, Scene

SMALL, FULL = (540, 720), (1080, 1440)


def main() -> None:
    quick = read_options(__doc__).quick
    compile_s = seconds(lambda: FrameRenderer(SCENES["wafer"], Optics(), Sensor(16, 16)).frame(0, 0, 0, 100, 0))
    print(f"first frame, compiled or loaded: {compile_s:.1f} s")
    for size in (SMALL,) if quick else (SMALL, FULL):
        for scene in SCENES.values():
            print(report(scene, *size, frames=6 if quick else 20), flush=True)


def report(scene: Scene, rows: int, cols: int, frames: int) -> str:
    sensor = Sensor(rows, cols)
    sensor.expose(np.zeros((rows, cols), np.float32), 1.0, 0)
    FieldPicture(scene, Optics(), 0, 0, 16, 16, tour_range(scene)).radiance(0)
    x, y = scene.tour_center_um
    prepared = took(lambda: FieldPicture(scene, Optics(), x, y, rows, cols, tour_range(scene)))
    field = prepared.result
    end_um = scene.tour_z_start_um + scene.tour_z_step_um * (scene.tour_frames - 1)
    z_um = np.linspace(scene.tour_z_start_um, end_um, frames)
    frame_s = seconds(lambda: consume(field.radiance(z) for z in z_um))
    light = field.radiance(z_um[0])
    expose_s = seconds(lambda: consume(sensor.expose(light, scene.gain, seed) for seed in range(frames)))
    ms = 1000 / frames
    return (
        f"{scene.name:13s} {rows} x {cols}: field {prepared.processor_s:.2f} s, frame {frame_s * ms:.1f} ms, "
        f"exposure {expose_s * ms:.1f} ms"
    )


def consume(frames: Iterable[object]) -> None:
    """Make every frame and keep none, as a scan does."""
    deque(frames, maxlen=0)


def seconds(work: Callable[[], object]) -> float:
    return took(work).processor_s


if __name__ == "__main__":
    main()
