"""Prerendering of the frames of a real-time scan in a separate process, and replay by position.

A full frame takes longer to render than the camera's frame period. The true stage position at every pulse is known from
the plan, so the frames are stored on disk before the scan.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.devices import Position
from wafer_viewer.model.acquisition.focus_stack import Image
from wafer_viewer.model.acquisition.plan import Leg, ScanPlan
from wafer_viewer.model.acquisition.rig_limits import RigLimits
from wafer_viewer.model.errors import RigError, WaferViewerError
from wafer_viewer.model.progress import ShouldStop
from wafer_viewer.model.spec import Spec, decode, encode
from wafer_viewer.rigs.virtual.camera import LEVEL, TRIGGER_DELAY_US, Renderer
from wafer_viewer.rigs.virtual.clock import VirtualClock
from wafer_viewer.rigs.virtual.faults import CalibrationErrors
from wafer_viewer.rigs.virtual.stage import VirtualStage

NEAR_UM = 0.02
"""Position tolerance of a stored frame in um; the repeatability of the stage is a few nm."""
LOOK_S = 0.05
ORDER, FRAMES = "rehearsal.json", "frames.raw"


class PrerenderJob(Spec, frozen=True, kw_only=True):
    """Prerender job: a plan on a virtual rig, and a frame at the current stage position for the test pulse.

    seed: of the scale errors; frame_seed: of the noise of the first frame, later ones have the next numbers; light:
    fraction of the full light; slopes: of the sample along x and y.
    """

    error: ClassVar[type[WaferViewerError]] = RigError
    scene: str
    seed: int
    frame_seed: int = 0
    limits: RigLimits
    plan: ScanPlan
    here_um: tuple[float, ...]
    errors: CalibrationErrors = CalibrationErrors()
    light: float = 1.0
    slopes: tuple[float, ...] = LEVEL

    @property
    def dtype(self) -> type[np.unsignedinteger]:
        """Pixel type of the frames."""
        return np.uint8 if self.limits.camera.bits == 8 else np.uint16

    def views(self) -> NDArray[np.float64]:
        """Return the position of every frame: true x, y, z in um and the exposure at full light in us, [frame, 4]."""
        stage = VirtualStage(VirtualClock(), self.limits, self.seed, z_fraction=self.errors.z_fraction)
        delay_us = TRIGGER_DELAY_US + self.errors.trigger_delay_us
        exposures_us = self.plan.exposures_us
        places = [(Position(*self.here_um), exposures_us[0])]
        for leg in self.plan.legs:
            places += scales_at_exposures(leg, self.limits, exposures_us, delay_us)
        truths = [(stage.truth_of(at), exposure_us) for at, exposure_us in places]
        return np.array([(at.x_um, at.y_um, at.z_um, exposure_us * self.light) for at, exposure_us in truths])


class ReplayRenderer:
    """Implementation of Renderer: stored frames where available, otherwise those of the live renderer.

    fits: returns whether the sample still stands as it was rendered.
    """

    def __init__(
        self, views: NDArray[np.float64], frames: Image, live: Renderer, fits: Callable[[], bool] = lambda: True
    ) -> None:
        self._fits = fits
        self._views = views
        self._frames = frames
        self.live = live

    def frame(self, x_um: float, y_um: float, z_um: float, exposure_us: float, seed: int) -> Image:
        """Return the image at the true stage position (x, y, z)."""
        away = np.abs(self._views - (x_um, y_um, z_um, exposure_us)).max(axis=1)
        nearest = int(away.argmin())
        if away[nearest] > NEAR_UM or not self._fits():
            return self.live.frame(x_um, y_um, z_um, exposure_us, seed)
        return np.array(self._frames[nearest])


def scales_at_exposures(
    leg: Leg, limits: RigLimits, exposures_us: tuple[float, ...], delay_us: float = TRIGGER_DELAY_US
) -> Iterator[tuple[Position, float]]:
    """Yield the scale reading at every mid-exposure of a leg, with the exposure in us."""
    train, axis = leg.train, limits.axis(leg.train.axis)
    at = {"x": leg.x_um, "y": leg.y_um, "z": leg.z_um}
    for i, shot in enumerate(leg.shots):
        exposure_us = exposures_us[shot.exposure]
        count = train.first_count + train.direction * train.counts_per_frame * i
        moved_um = train.direction * leg.speed_um_s * (delay_us + exposure_us / 2) * 1e-6
        at[train.axis] = axis.position_um(count) + moved_um
        yield Position(at["x"], at["y"], at["z"]), exposure_us


def prerender(
    order: PrerenderJob, live: Renderer, should_stop: ShouldStop, fits: Callable[[], bool] = lambda: True
) -> ReplayRenderer | None:
    """Render all frames in a separate process and wait for it; None if stopped.

    Raises RigError when the disk is too small or the process fails.
    """
    views = order.views()
    with tempfile.TemporaryDirectory(prefix="wafer-viewer-", ignore_cleanup_errors=True) as folder:
        frames = _frames_file(Path(folder), order, len(views), "w+")
        (Path(folder) / ORDER).write_text(encode(order, "json"))
        rendered = _wait_for(_started(folder), should_stop)
    # The mapping keeps the frames alive after their folder is gone: no crash leaves them behind.
    return ReplayRenderer(views, frames, live, fits) if rendered else None


def main(folder: Path) -> None:
    """Entry point of the rendering process: reads the job from a folder, and ends early when its parent is gone."""
    from wafer_viewer.rigs.virtual.rig import scene_renderer

    order, parent = decode((folder / ORDER).read_bytes(), PrerenderJob, ORDER, "json"), os.getppid()
    views = order.views()
    frames = _frames_file(folder, order, len(views), "r+")
    along_x, along_y = order.slopes
    renderer = scene_renderer(order.scene, order.limits, order.errors, lambda: (along_x, along_y))
    for i, (x_um, y_um, z_um, exposure_us) in enumerate(views.tolist()):
        if os.getppid() != parent:
            return
        frames[i] = renderer.frame(x_um, y_um, z_um, exposure_us, order.frame_seed + i)


def _frames_file(folder: Path, order: PrerenderJob, n_frames: int, mode: Literal["w+", "r+"]) -> Image:
    camera, dtype = order.limits.camera, order.dtype
    needed, free = n_frames * camera.rows * camera.cols * np.dtype(dtype).itemsize, shutil.disk_usage(folder).free
    if mode == "w+" and needed > free:
        raise RigError(
            f"The frames of this scan need {needed / 1e9:.1f} GB beforehand and {folder.parent} has {free / 1e9:.1f} "
            "GB free: take fewer fields, or let the virtual rig run without real time."
        )
    return np.memmap(folder / FRAMES, dtype, mode, shape=(n_frames, camera.rows, camera.cols))


def _started(folder: str) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "wafer_viewer.rigs.virtual.prerendering", folder]
    return subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)


def _wait_for(process: subprocess.Popen[bytes], should_stop: ShouldStop) -> bool:
    """Wait for the process; return True if it succeeded, False if stopped. Raises RigError when it failed."""
    with process:
        while True:
            try:
                _, said = process.communicate(timeout=LOOK_S)
                break
            except subprocess.TimeoutExpired:
                if should_stop():
                    process.terminate()
                    return False
    if process.returncode != 0:
        last = (said.decode(errors="replace").strip().splitlines() or ["no reason given"])[-1]
        raise RigError(f"Rendering the frames beforehand failed ({last}): let the virtual rig run without real time.")
    return True


if __name__ == "__main__":
    main(Path(sys.argv[1]))
