"""Virtual camera: one exposure per trigger when it is ready, with simulated faults."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Protocol

from wafer_viewer.model.acquisition.devices import CameraImage, Position
from wafer_viewer.model.acquisition.focus_stack import FrameStatus, Image
from wafer_viewer.model.acquisition.rig_limits import CameraLimits
from wafer_viewer.model.errors import RigError
from wafer_viewer.rigs.virtual.clock import VirtualClock
from wafer_viewer.rigs.virtual.faults import Faults
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
    """Exposure that is not rendered yet: true stage position at mid-exposure, and the camera's metadata."""

    truth: Position
    exposure_us: float
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
    ) -> None:
        self._clock = clock
        self._stage = stage
        self._limits = limits
        self.renderer = renderer
        self._faults = faults or Faults()
        self._seed = seed
        self._exposure_us: float | None = None
        self._waits = 0
        self._queue: deque[Exposure] = deque()
        self._ready_s = 0.0
        self._edges = self._exposures = 0
        self._triggers = 0

    @property
    def triggers(self) -> int:
        """Number of triggers received while armed since the rig was switched on."""
        return self._triggers

    def start(self, exposure_us: float) -> None:
        """Arm the camera with an exposure time; the trigger counter starts at 0."""
        limits = self._limits
        if not limits.exposure_min_us <= exposure_us <= limits.exposure_max_us:
            raise RigError(
                f"The camera cannot expose for {exposure_us:g} us: its range is {limits.exposure_min_us:g} to "
                f"{limits.exposure_max_us:g} us."
            )
        self._forget()
        self._exposure_us, self._edges, self._exposures = exposure_us, 0, 0

    def stop(self) -> None:
        """Disarm the camera; images not fetched are dropped."""
        self._forget()
        self._exposure_us = None

    def trigger(self, time_s: float) -> bool:
        """Process an edge from the pulse box; return whether the camera exposed."""
        if self._exposure_us is None:
            return False
        number = self._triggers
        self._triggers += 1
        return self._edge(time_s, self._exposure_us, number)

    def disturb(self, time_s: float) -> bool:
        """Process a spurious edge on the trigger input; return whether the camera exposed."""
        return self._exposure_us is not None and self._edge(time_s, self._exposure_us, EXTRA)

    def _edge(self, time_s: float, exposure_us: float, number: int) -> bool:
        count = self._exposures if self._faults.counts_exposures else self._edges
        self._edges += 1
        if time_s < self._ready_s or number in self._faults.ignored_triggers:
            return False
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
        if not self._clock.wait_for(lambda: bool(self._queue), timeout_s):
            return None
        return self._rendered_image(self._queue.popleft())

    def _expose(self, time_s: float, exposure_us: float, number: int, count: int) -> Exposure:
        middle_s = time_s + (TRIGGER_DELAY_US + exposure_us / 2) * 1e-6
        return Exposure(
            truth=self._stage.truth_at(middle_s),
            exposure_us=exposure_us,
            number=number,
            trigger_count=count,
            device_time_us=CLOCK_OFFSET_US + round(time_s * 1e6 * (1 + CLOCK_DRIFT)),
        )

    def _arrival_s(self, time_s: float, exposure_us: float) -> float:
        return time_s + (TRIGGER_DELAY_US + exposure_us + self._limits.readout_us) * 1e-6 + TRANSFER_S

    def _forget(self) -> None:
        self._clock.catch_up()
        self._queue.clear()
        self._waits += 1

    def _arrive(self, taken: Exposure, wait: int) -> None:
        if wait == self._waits and len(self._queue) < self._limits.queue_frames:
            self._queue.append(taken)

    def _rendered_image(self, taken: Exposure) -> CameraImage:
        at, seed = taken.truth, self._seed * 1_000_003 + taken.number
        image = self.renderer.frame(at.x_um, at.y_um, at.z_um, taken.exposure_us, seed)
        status, count = FrameStatus.OK, taken.trigger_count
        if taken.number in self._faults.incomplete:
            image, status, count = image.copy(), FrameStatus.INCOMPLETE, max(0, count - 1)
            image[image.shape[0] // 2 :] = 0
        if self._faults.counter_wraps_at:
            count %= self._faults.counter_wraps_at
        return CameraImage(image, count if self._faults.trigger_counter else None, taken.device_time_us, status)
