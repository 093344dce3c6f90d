"""Virtual camera: one exposure per trigger when it is ready, light to counts, with simulated faults.

It also contains the frame renderer of the virtual rig.
"""

from __future__ import annotations

import dataclasses
import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.devices import CameraImage, Position
from wafer_viewer.model.acquisition.focus_stack import FrameStatus, Image
from wafer_viewer.model.acquisition.rig_limits import CameraLimits
from wafer_viewer.model.errors import RigError
from wafer_viewer.numerics.jit import fast_kernel, fast_part
from wafer_viewer.rigs.virtual.clock import VirtualClock
from wafer_viewer.rigs.virtual.faults import Faults
from wafer_viewer.rigs.virtual.optics.blur import Plane
from wafer_viewer.rigs.virtual.optics.optics import FieldPicture, Optics
from wafer_viewer.rigs.virtual.positioners import Slopes
from wafer_viewer.rigs.virtual.scenes.catalogue import Scene, SceneWindow
from wafer_viewer.rigs.virtual.scenes.drawing import Points, SceneSheets
from wafer_viewer.rigs.virtual.stage import VirtualStage

TRIGGER_DELAY_US = 12.0
"""Delay from the pulse to the start of the exposure."""
CLOCK_OFFSET_US = 7_654_321
CLOCK_DRIFT = 20e-6
"""Relative frequency error of the camera clock; `CLOCK_OFFSET_US` is its time when the rig is switched on."""
TRANSFER_S = 0.002
EXTRA = -1
"""Trigger number of an image that no pulse triggered."""


class Renderer(Protocol):
    """Protocol of a source of sensor images by stage position."""

    def frame(self, x_um: float, y_um: float, z_um: float, exposure_us: float, seed: int) -> Image:
        """Return the image [row, col] at the true stage position (x, y, z), with the frame centre at (x, y)."""
        ...


@dataclass(frozen=True, slots=True)
class Exposure:
    """Exposure that is not rendered yet: true stage position at mid-exposure, and the camera's metadata.

    light: fraction of the full light.
    """

    truth: Position
    exposure_us: float
    light: float
    number: int
    trigger_count: int
    device_time_us: int


class VirtualCamera:
    """Implementation of Camera; the pulse box calls `trigger`. Images are rendered when they are fetched."""

    def __init__(
        self,
        clock: VirtualClock,
        stage: VirtualStage,
        limits: CameraLimits,
        renderer: Renderer,
        faults: Faults | None = None,
        seed: int = 0,
        delay_us: float = TRIGGER_DELAY_US,
        light_at: Callable[[float], float] = lambda time_s: 1.0,
    ) -> None:
        self._light_at = light_at
        """Light at a time, as a fraction of the full one."""
        self._clock = clock
        self._stage = stage
        self._limits = limits
        self._delay_us = delay_us
        self.renderer = renderer
        self._faults = faults or Faults()
        self._seed = seed
        self._exposures_us: tuple[float, ...] = ()
        self._waits = 0
        self._queue: deque[Exposure] = deque()
        self._ready_s = 0.0
        self._edges = self._exposures = 0
        self._triggers = 0
        self._lost = False

    def pull_cable(self) -> None:
        """Lose the line to the camera: commands raise a RuntimeError, as the drivers of some libraries."""
        self._lost = True

    def _check_cable(self) -> None:
        if self._lost:
            raise RuntimeError("Camera is not available.")

    @property
    def triggers(self) -> int:
        """Number of triggers received while armed since the rig was switched on."""
        return self._triggers

    @property
    def next_frame_seed(self) -> int:
        """Seed of the noise of the next trigger's frame; that of later ones rises by 1."""
        return self._frame_seed(self._triggers)

    def start(self, exposure_us: float) -> None:
        """Arm the camera with an exposure time; the trigger counter starts at 0."""
        self.start_sequence((exposure_us,))

    def start_sequence(self, exposures_us: tuple[float, ...]) -> None:
        """Arm the camera with exposures in turn, from the first one on; an ignored trigger does not use one up."""
        self._check_cable()
        limits = self._limits
        for exposure_us in exposures_us:
            if not limits.exposure_min_us <= exposure_us <= limits.exposure_max_us:
                raise RigError(
                    f"The camera cannot expose for {exposure_us:g} us: its range is {limits.exposure_min_us:g} to "
                    f"{limits.exposure_max_us:g} us."
                )
        self._forget()
        self._exposures_us, self._edges, self._exposures = exposures_us, 0, 0

    def stop(self) -> None:
        """Disarm the camera; images not fetched are dropped."""
        self._check_cable()
        self._forget()
        self._exposures_us = ()

    def trigger(self, time_s: float) -> bool:
        """Process an edge from the pulse box; return whether the camera exposed."""
        if not self._exposures_us:
            return False
        number = self._triggers
        self._triggers += 1
        return self._edge(time_s, number)

    def disturb(self, time_s: float) -> bool:
        """Process a spurious edge on the trigger input; return whether the camera exposed."""
        return bool(self._exposures_us) and self._edge(time_s, EXTRA)

    def _edge(self, time_s: float, number: int) -> bool:
        count = self._exposures if self._faults.counts_exposures else self._edges
        self._edges += 1
        if time_s < self._ready_s or number in self._faults.ignored_triggers:
            return False
        exposure_us = self._exposures_us[self._exposures % len(self._exposures_us)]
        self._exposures += 1
        self._ready_s = time_s + self._limits.period_s(exposure_us) - 1e-6
        if number not in self._faults.lost_images:
            taken = self._expose(time_s, exposure_us, number, count)
            arrival_s, wait = self._arrival_s(time_s, exposure_us), self._waits
            for _ in range(1 + (number in self._faults.duplicated_images)):
                self._clock.at(arrival_s, lambda _: self._arrive(taken, wait))
        return True

    def next_image(self, timeout_s: float) -> CameraImage | None:
        """Return the next image, or None on timeout."""
        self._check_cable()
        if not self._clock.wait_for(lambda: bool(self._queue), timeout_s):
            return None
        self._check_cable()
        return self._rendered_image(self._queue.popleft())

    def _frame_seed(self, number: int) -> int:
        return self._seed * 1_000_003 + number

    def _expose(self, time_s: float, exposure_us: float, number: int, count: int) -> Exposure:
        middle_s = time_s + (self._delay_us + exposure_us / 2) * 1e-6
        return Exposure(
            truth=self._stage.truth_at(middle_s),
            exposure_us=exposure_us,
            light=self._light_at(middle_s),
            number=number,
            trigger_count=count,
            device_time_us=CLOCK_OFFSET_US + round(time_s * 1e6 * (1 + CLOCK_DRIFT)),
        )

    def _arrival_s(self, time_s: float, exposure_us: float) -> float:
        return time_s + (self._delay_us + exposure_us + self._limits.readout_us) * 1e-6 + TRANSFER_S

    def _forget(self) -> None:
        self._clock.catch_up()
        self._queue.clear()
        self._waits += 1

    def _arrive(self, taken: Exposure, wait: int) -> None:
        if wait == self._waits and len(self._queue) < self._limits.queue_frames:
            self._queue.append(taken)

    def _rendered_image(self, taken: Exposure) -> CameraImage:
        at, seed = taken.truth, self._frame_seed(taken.number)
        image = self.renderer.frame(at.x_um, at.y_um, at.z_um, taken.exposure_us * taken.light, seed)
        status, count = FrameStatus.OK, taken.trigger_count
        if taken.number in self._faults.incomplete:
            image, status, count = image.copy(), FrameStatus.INCOMPLETE, max(0, count - 1)
            image[image.shape[0] // 2 :] = 0
        if taken.number in self._faults.cut_images:
            image = image.copy()
            image[image.shape[0] // 2 :] = 0
        if self._faults.counter_wraps_at:
            count %= self._faults.counter_wraps_at
        trigger_count = count if self._faults.trigger_counter else None
        return CameraImage(image, trigger_count, taken.device_time_us, status, taken.exposure_us)


NOISE_SIGMA = 32  # counts of one standard deviation in the table of noise
NOISE_LENGTH = 1 << 20
VIGNETTE, PIXEL_SPREAD = 0.09, 0.004
REUSE_WITHIN_UM = 0.05  # a tenth of a pixel: more than the scatter of a stage that stands still
LEVEL: Slopes = (0.0, 0.0)
HEADROOM_UM = 25.0  # prepared beyond the z asked for: a slow search for focus need not prepare at every step


@dataclass(frozen=True, slots=True)
class Sensor:
    """Monochrome sensor: size, full well and read noise in electrons, bits per pixel.

    `seed` selects the individual sensitivity pattern of the pixels. `nominal_exposure_us` is the exposure at which gain
    1 maps radiance 1 to white. shading_fraction: rise of the sensitivity from the left to the right edge; black_counts:
    counts without light, of 255.
    """

    rows: int
    cols: int
    well_e: float = 10_000.0
    read_e: float = 8.0
    bits: int = 8
    seed: int = 7
    nominal_exposure_us: float = 100.0
    shading_fraction: float = 0.0
    black_counts: int = 0

    def __post_init__(self) -> None:
        if self.bits not in (8, 16):
            raise RigError(f"The virtual sensor has {self.bits} bits per pixel; choose 8 or 16.")

    def expose(self, radiance: Plane, gain: float, seed: int) -> Image:
        """Convert radiance [row, col] to counts of one exposure, deterministic for a seed, clipped at white.

        The variance of a count d is white d / well + (white read / well)^2, plus that of rounding.
        """
        out: Image = np.empty(radiance.shape, np.uint8) if self.bits == 8 else np.empty(radiance.shape, np.uint16)
        white = np.float32(2**self.bits - 1)
        flat = flat_field(self.rows, self.cols, self.seed, self.shading_fraction)
        per_electron = white / np.float32(self.well_e)
        expose(radiance, flat, np.float32(gain), white, per_electron, np.float32(self.read_e), seed, noise_table(), out)
        black = self.black_counts << (self.bits - 8)
        if black:
            np.add(np.minimum(out, np.iinfo(out.dtype).max - black), black, out=out, casting="unsafe")
        return out


@lru_cache(maxsize=4)
def flat_field(rows: int, cols: int, seed: int, shading_fraction: float = 0.0) -> Plane:
    """Return the sensitivity of every pixel: vignetting, shading along x, and pixel variation; 1 in the centre."""
    y = (np.arange(rows)[:, None] - (rows - 1) / 2) / (cols / 2)
    x = (np.arange(cols)[None, :] - (cols - 1) / 2) / (cols / 2)
    uneven = np.random.default_rng(seed).standard_normal((rows, cols))
    shading = 1 + shading_fraction / 2 * x
    return ((1 - VIGNETTE * (x**2 + y**2)) * (1 + PIXEL_SPREAD * uneven) * shading).astype(np.float32)


@lru_cache(maxsize=1)
def noise_table() -> NDArray[np.int8]:
    """Return a table of Gaussian noise for all rows; fresh noise would cost as much as the rest of the frame."""
    draw = np.random.default_rng(12345).standard_normal(NOISE_LENGTH)
    return np.clip(np.round(draw * NOISE_SIGMA), -127, 127).astype(np.int8)


@fast_kernel
def expose(
    radiance: Plane,
    flat: Plane,
    gain: np.float32,
    white: np.float32,
    per_electron: np.float32,
    read_e: np.float32,
    seed: int,
    noise: NDArray[np.int8],
    out: Image,
) -> None:
    """Compute the counts of one exposure; (seed, row) selects the noise of each row from the table."""
    rows, cols = out.shape
    shot = per_electron / np.float32(NOISE_SIGMA**2)
    read = (per_electron * read_e / np.float32(NOISE_SIGMA)) ** np.float32(2)
    for y in range(rows):
        start = scattered(seed, y) % np.uint64(noise.size - cols)
        row = noise[start : start + np.uint64(cols)]
        for x in range(cols):
            count = radiance[y, x] * flat[y, x] * gain * white
            count += np.sqrt(max(count, np.float32(0)) * shot + read) * np.float32(row[x]) + np.float32(0.5)
            out[y, x] = min(max(count, np.float32(0)), white)


@fast_part
def scattered(seed: int, row: int) -> np.uint64:
    """Return a 64-bit hash of a seed and a row (the finalizer of splitmix64)."""
    h = np.uint64(seed) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(row) * np.uint64(0xD1B54A32D192ED03)
    h = (h ^ (h >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    h = (h ^ (h >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return h ^ (h >> np.uint64(31))


class FrameRenderer:
    """Renderer of camera frames at any stage position.

    Preparing a field takes ten to thirty times as long as a frame, so the last `keep` fields are cached, and a frame
    within 0.05 um of one of them (a tenth of a pixel) reuses it. The x, y scatter of a stage at rest during a z pass
    thus costs nothing, and is not visible in the frames.

    slopes: returns how far the sample rises along x and y from (0, 0).
    """

    def __init__(
        self,
        scene: Scene,
        optics: Optics,
        sensor: Sensor,
        keep: int = 3,
        camera_rotation_rad: float = 0.0,
        distortion_fraction: float = 0.0,
        slopes: Callable[[], Slopes] = lambda: LEVEL,
    ) -> None:
        self._scene, self._optics, self._sensor, self._keep = scene, optics, sensor, keep
        self._camera_rotation_rad = camera_rotation_rad
        self._distortion_fraction = distortion_fraction
        self._wanted_slopes, self._slopes = slopes, LEVEL
        self._z_range_um = tour_range(scene)
        self._fields: dict[tuple[float, float], FieldPicture] = {}

    def frame(self, x_um: float, y_um: float, z_um: float, exposure_us: float, seed: int) -> Image:
        """Return one frame centred at (x, y) with the focus at z; uint8 [row, col] (uint16 for 16 bits)."""
        if (slopes := self._wanted_slopes()) != self._slopes:
            self._slopes = slopes
            self._fields.clear()
        over_um = z_um - (slopes[0] * x_um + slopes[1] * y_um)
        radiance = self._field(x_um, y_um, over_um).radiance(over_um)
        gain = self._scene.gain * exposure_us / self._sensor.nominal_exposure_us
        return self._sensor.expose(radiance, gain, seed)

    def overview(self, width_px: int) -> NDArray[np.uint8]:
        """Return an overview image of the sample in focus: uint8 [row, col], y up."""
        return overview(self._scene, width_px)

    def _field(self, x_um: float, y_um: float, z_um: float) -> FieldPicture:
        low, high = self._z_range_um
        if not low <= z_um <= high:
            self._z_range_um = min(low, z_um - HEADROOM_UM), max(high, z_um + HEADROOM_UM)
            self._fields.clear()
        place = self._prepared_near(x_um, y_um) or (x_um, y_um)
        field = self._fields.pop(place, None) or self._prepare(*place)
        self._fields[place] = field
        while len(self._fields) > self._keep:
            del self._fields[next(iter(self._fields))]
        return field

    def _prepared_near(self, x_um: float, y_um: float) -> tuple[float, float] | None:
        """Return the nearest prepared position if it is close enough, else None."""
        away = {place: max(abs(place[0] - x_um), abs(place[1] - y_um)) for place in self._fields}
        nearest = min(away, key=away.__getitem__, default=None)
        return nearest if nearest is not None and away[nearest] <= REUSE_WITHIN_UM else None

    def _prepare(self, x_um: float, y_um: float) -> FieldPicture:
        sensor = self._sensor
        corner_um = math.hypot(sensor.rows, sensor.cols) / 2 * self._optics.pixel_um
        tilted = tilted_scene(self._scene, x_um, y_um, self._slopes)
        scene = imaged_scene(tilted, (x_um, y_um), self._camera_rotation_rad, self._distortion_fraction, corner_um)
        return FieldPicture(scene, self._optics, x_um, y_um, sensor.rows, sensor.cols, self._z_range_um)


def imaged_scene(
    scene: Scene, centre_um: tuple[float, float], angle_rad: float, distortion_fraction: float, corner_um: float
) -> Scene:
    """Return a scene as a camera rotated anticlockwise about the centre of its image sees it through a lens.

    A pixel at the distance r from the centre shows what lies at r (1 - distortion (r / corner_um)^2).
    """
    if angle_rad == 0.0 and distortion_fraction == 0.0:
        return scene
    cos, sin = math.cos(angle_rad), math.sin(angle_rad)
    x_um, y_um = centre_um

    def fill(x: Points, y: Points, footprint_um: float, out: SceneSheets) -> None:
        right, up = x - x_um, y - y_um
        if distortion_fraction:
            nearer = 1 - distortion_fraction * (right**2 + up**2) / corner_um**2
            right, up = right * nearer, up * nearer
        scene.fill(x_um + cos * right - sin * up, y_um + sin * right + cos * up, footprint_um, out)

    return dataclasses.replace(scene, fill=fill)


def tilted_scene(scene: Scene, x_um: float, y_um: float, slopes: Slopes) -> Scene:
    """Return a scene that rises along x and y about (x_um, y_um)."""
    if slopes == LEVEL:
        return scene

    def fill(x: Points, y: Points, footprint_um: float, out: SceneSheets) -> None:
        scene.fill(x, y, footprint_um, out)
        rise = (slopes[0] * (x - x_um) + slopes[1] * (y - y_um)).astype(np.float32)
        for height in (out.height_a, out.height_b):
            np.add(height, rise, out=height)

    return dataclasses.replace(scene, fill=fill)


def tour_range(scene: Scene) -> tuple[float, float]:
    """Return the z range of the scene's tour and of its heights, with a margin of 5 um."""
    tour_end = scene.tour_z_start_um + scene.tour_z_step_um * (scene.tour_frames - 1)
    return min(scene.tour_z_start_um, scene.z_min_um) - 5, max(tour_end, scene.z_max_um) + 5


def overview(scene: Scene, width_px: int, oversampling: int = 3) -> NDArray[np.uint8]:
    """Return the sample from straight above, all in focus, uint8 [row, col]."""
    pixel_um = scene.width_um / width_px
    height_px = round(scene.height_um / pixel_um)
    step_um = pixel_um / oversampling
    x0, y0 = -scene.width_um / 2 + step_um / 2, scene.height_um / 2 - step_um / 2
    picture = np.empty((height_px, width_px), np.uint8)
    for row in range(height_px):
        line = SceneWindow(x0, y0 - row * pixel_um, step_um, oversampling, oversampling * width_px)
        seen = scene.raster(line).radiance()
        grey = 255 * scene.gain * seen.reshape(oversampling, width_px, oversampling).mean((0, 2))
        picture[row] = np.clip(grey, 0, 255)
    return picture
