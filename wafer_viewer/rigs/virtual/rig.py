"""The virtual rig: scene, optics and sensor, stage, pulse box and camera, with a common clock."""

from __future__ import annotations

import os
import secrets
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Literal
from zipfile import BadZipFile

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wafer_viewer.model.acquisition.calibration import Calibration, OpticalSetup
from wafer_viewer.model.acquisition.devices import DeviceIdentity, Overview
from wafer_viewer.model.acquisition.plan import Axis, ScanPlan
from wafer_viewer.model.acquisition.rig_limits import AxisLimits, CameraLimits, ObjectiveLimits, RigLimits
from wafer_viewer.model.acquisition.sample import Sample
from wafer_viewer.model.errors import RigError
from wafer_viewer.model.progress import ShouldStop
from wafer_viewer.model.spec import replace
from wafer_viewer.numerics.kernel_cache import cache_folder, is_writable, kernel_state
from wafer_viewer.rigs.pulse_box.client import PulseBoxClient
from wafer_viewer.rigs.virtual.camera import (
    LEVEL,
    TRIGGER_DELAY_US,
    FrameRenderer,
    Renderer,
    Sensor,
    VirtualCamera,
    overview,
)
from wafer_viewer.rigs.virtual.clock import VirtualClock
from wafer_viewer.rigs.virtual.faults import CalibrationErrors, Faults
from wafer_viewer.rigs.virtual.optics.optics import Optics
from wafer_viewer.rigs.virtual.positioners import (
    OWN,
    SimulatedPositioner,
    Slopes,
    VirtualPositioner,
    VirtualPositioners,
)
from wafer_viewer.rigs.virtual.pulse_box_firmware import VirtualPulseBox
from wafer_viewer.rigs.virtual.scenes.catalogue import SCENES, Scene, scene
from wafer_viewer.rigs.virtual.serial_port import VirtualPort
from wafer_viewer.rigs.virtual.stage import VirtualStage

Size = Literal["small", "full"]
SIZES: dict[Size, tuple[int, int]] = {"small": (540, 720), "full": (1080, 1440)}
"""Rows and columns of the virtual camera."""
PIXEL_UM, U_PIXEL_UM = 0.46729, 0.00005
U_Z_SCALE = 2e-4
NUMERICAL_APERTURE, WAVELENGTH_UM = 0.28, 0.55
SETUP = OpticalSetup(objective="10x/0.28 (simulated)", camera="virtual")
OVERVIEW_PX = 1000
NOISE_SEED_BITS = 31
VIRTUAL_MOUNT = "virtual stage"
"""`Sample.mount` of the samples that come with the virtual rig."""

LATERAL = AxisLimits(
    low_um=-155_000.0,
    high_um=155_000.0,
    speed_um_s=100_000.0,
    acceleration_um_s2=1_000_000.0,
    settle_s=0.06,
    counts_per_um=20.0,
)
AXIAL = AxisLimits(
    low_um=-10_000.0,
    high_um=10_000.0,
    speed_um_s=5_000.0,
    acceleration_um_s2=100_000.0,
    settle_s=0.05,
    counts_per_um=100.0,
)
OBJECTIVE = ObjectiveLimits(
    numerical_aperture=NUMERICAL_APERTURE,
    wavelength_um=WAVELENGTH_UM,
    magnification=10.0,
    working_distance_um=34_000.0,
    clearance_um=28_000.0,
    safe_z_um=9_000.0,
)
CALIBRATION = Calibration(
    pixel_um=PIXEL_UM,
    u_pixel_um=U_PIXEL_UM,
    u_z_scale=U_Z_SCALE,
    trigger_delay_us=TRIGGER_DELAY_US,
    setup=SETUP,
    made="2026-01-01",
    due="2999-12-31",
    against="the simulation itself",
    simulated=True,
)


def virtual_limits(rows: int, cols: int) -> RigLimits:
    """Return the limits of the virtual rig with a camera of the given size."""
    camera = CameraLimits(
        frame_rate_hz=60.0,
        exposure_min_us=10.0,
        exposure_max_us=100_000.0,
        readout_us=15_000.0,
        rows=rows,
        cols=cols,
        exposure_sequence=True,
    )
    return RigLimits(x=LATERAL, y=LATERAL, z=AXIAL, camera=camera, objective=OBJECTIVE, pixel_um=PIXEL_UM)


class VirtualRig:
    """Implementation of Rig with simulated devices, operated by the same drivers as real ones.

    scene: name of a scene; size: of the camera; real_time: time follows the wall clock, and frames are rendered in
    advance by `prepare`; seed: of the camera noise and the scale errors. Without it the noise is fresh, and the scale
    errors, which belong to the instrument, are those of seed 0; renderer: replacement for the scene's renderer, for
    tests; errors: hidden errors of the calibration; positioners: in place of its own lamp and tilts.
    """

    def __init__(
        self,
        scene: str = "wafer",
        size: Size = "small",
        *,
        name: str = "Virtual rig",
        real_time: bool = False,
        seed: int | None = None,
        faults: Faults | None = None,
        limits: RigLimits | None = None,
        renderer: Renderer | None = None,
        errors: CalibrationErrors = CalibrationErrors(),
        positioners: Mapping[str, SimulatedPositioner] = OWN,
    ) -> None:
        self._name = name
        self._own_scene = self._scene = scene
        self._scale_seed = seed or 0
        self._noise_seed = secrets.randbits(NOISE_SEED_BITS) if seed is None else seed
        self._real_time = real_time
        limits = limits or virtual_limits(*SIZES[size])
        self._faults = faults or Faults()
        self._errors = errors
        self._clock = VirtualClock(real_time=real_time)
        self._stage = VirtualStage(self._clock, limits, self._scale_seed, self._faults, errors.z_fraction)
        self._positioners = VirtualPositioners(self._clock, self._stage, positioners)
        self._renderer = renderer or scene_renderer(scene, limits, errors, self._positioners.slopes)
        self._camera = VirtualCamera(
            self._clock,
            self._stage,
            limits.camera,
            self._renderer,
            self._faults,
            self._noise_seed,
            TRIGGER_DELAY_US + errors.trigger_delay_us,
            self._positioners.light_at,
        )
        self._firmware = VirtualPulseBox(self._clock, self._stage, self._triggered, self._suppresses)
        self._firmware.ignores_heartbeat = self._faults.ignores_heartbeat
        self._held_back: set[int] = set()
        self._slipped: set[int] = set()
        self._stage.on_motion(self._moved)
        self._port = VirtualPort(self._clock, self._firmware, self._faults.wire)
        self._firmware.connect(self._port.deliver)
        self._box = PulseBoxClient(self._port, self._clock)
        self._limits = replace(limits, count_rate_hz=float(self._box.identity.count_rate_hz))

    @property
    def name(self) -> str:
        """Name shown to the operator."""
        return self._name

    @property
    def simulated(self) -> bool:
        """Always True."""
        return True

    @property
    def limits(self) -> RigLimits:
        """Limits of the rig."""
        return self._limits

    @property
    def setup(self) -> OpticalSetup:
        """Optical setup."""
        return SETUP

    @property
    def calibration(self) -> Calibration:
        """Calibration of the simulation."""
        return CALIBRATION

    @property
    def clock(self) -> VirtualClock:
        """Clock of the rig."""
        return self._clock

    @property
    def stage(self) -> VirtualStage:
        """Stage of the rig."""
        return self._stage

    @property
    def box(self) -> PulseBoxClient:
        """Pulse box of the rig."""
        return self._box

    @property
    def camera(self) -> VirtualCamera:
        """Camera of the rig."""
        return self._camera

    @property
    def positioners(self) -> Mapping[str, VirtualPositioner]:
        """Its lamp and the tilts of its sample."""
        return self._positioners.by_name

    def identities(self) -> tuple[DeviceIdentity, ...]:
        """Return its devices, all of them virtual."""
        return (
            DeviceIdentity(role="stage", driver="virtual", identity="virtual stage"),
            DeviceIdentity(role="pulse box", driver="WPC/2", identity=self._box.identity.name),
            DeviceIdentity(role="camera", driver="virtual", identity="virtual camera"),
        )

    def overview(self) -> Overview:
        """Return an overview image of the sample, as from a camera of low magnification."""
        return scene_overview(self._scene)

    def load_sample(self, sample: Sample | None) -> bool:
        """Load a sample: the scene named by `sample.product`, if mounted on the virtual stage.

        Any other sample, and None, selects the scene of the rig's configuration. Return True if the scene changed.
        """
        virtual = sample is not None and sample.mount == VIRTUAL_MOUNT and sample.product in SCENES
        wanted = sample.product if sample is not None and virtual else self._own_scene
        if wanted == self._scene:
            return False
        self._scene = wanted
        self._render()
        return True

    def look_through(self, limits: RigLimits) -> None:
        """Show the sample through the objective and with the pixels of other limits, as when a nosepiece was turned."""
        if limits.objective != self._limits.objective or limits.pixel_um != self._limits.pixel_um:
            self._limits = replace(self._limits, objective=limits.objective, pixel_um=limits.pixel_um)
            self._render()

    def _render(self) -> None:
        self._renderer = scene_renderer(self._scene, self._limits, self._errors, self._positioners.slopes)
        self._camera.renderer = self._renderer

    def prepare(self, plan: ScanPlan, should_stop: ShouldStop) -> None:
        """In real time, prerender the plan's frames in a separate process; otherwise do nothing."""
        if not self._real_time:
            return
        from wafer_viewer.rigs.virtual.prerendering import PrerenderJob, prerender

        here = self._stage.position()
        order = PrerenderJob(
            scene=self._scene,
            seed=self._scale_seed,
            frame_seed=self._camera.next_frame_seed,
            limits=self._limits,
            plan=plan,
            here_um=(here.x_um, here.y_um, here.z_um),
            errors=self._errors,
            light=self._positioners.light_at(self._clock.now_s()),
            slopes=self._positioners.slopes(),
        )
        self._camera.renderer = (
            prerender(order, self._renderer, should_stop, lambda: self._positioners.slopes() == order.slopes)
            or self._renderer
        )

    def close(self) -> None:
        """Stop motion, stop the pulses, and close the port, as far as the devices answer."""
        if not self._port.has_room:
            return
        for stop in (self._box.halt, self._stage.stop, self._camera.stop):
            with suppress(RigError, OSError, RuntimeError):
                stop()
        self._port.close()

    def truth_for_tests(self, x_um: ArrayLike, y_um: ArrayLike) -> NDArray[np.float32]:
        """Return true heights in um at points of any shape. Only tests may use it."""
        flat, (along_x, along_y) = scene(self._scene).truth(x_um, y_um), self._positioners.slopes()
        if (along_x, along_y) == LEVEL:
            return flat
        return flat + (along_x * np.asarray(x_um) + along_y * np.asarray(y_um)).astype(np.float32)

    def _triggered(self, time_s: float) -> bool:
        """Send a pulse to the camera, with its faults; return whether the box detected an exposure."""
        number, faults = self._camera.triggers, self._faults
        exposed = self._camera.trigger(time_s)
        if self._camera.triggers == number:
            return exposed
        if number in faults.reboots:
            self._clock.at(time_s, lambda _: self._firmware.reboot())
        if number in faults.slips:
            self._firmware.slip(faults.slip_counts, reported=faults.slips_reported)
        self._pull_cables(number)
        if number in faults.extra_edges:
            self._clock.at(time_s + faults.extra_edge_us * 1e-6, self._disturbed)
        return exposed and number not in faults.unseen_exposures

    def _pull_cables(self, number: int) -> None:
        faults = self._faults
        lost = (faults.stage_lost, self._stage), (faults.box_lost, self._port), (faults.camera_lost, self._camera)
        for numbers, device in lost:
            if number in numbers:
                device.pull_cable()

    def _disturbed(self, time_s: float) -> None:
        """Simulate interference on the camera cable."""
        if self._camera.disturb(time_s):
            self._firmware.see_exposure()

    def _moved(self, axis: Axis, time_s: float) -> None:
        """Let the box lose counts in a motion, once for each number in its faults."""
        number, faults = self._stage.motions - 1, self._faults
        if number in faults.slipping_motions and number not in self._slipped:
            self._slipped.add(number)
            self._firmware.slip(faults.slip_counts, reported=faults.slips_reported)

    def _suppresses(self) -> bool:
        """Return whether the box holds back the next trigger: once for each number in its faults."""
        number = self._camera.triggers
        if number not in self._faults.suppressed_pulses or number in self._held_back:
            return False
        self._held_back.add(number)
        return True


def scene_renderer(
    name: str,
    limits: RigLimits,
    errors: CalibrationErrors = CalibrationErrors(),
    slopes: Callable[[], Slopes] = lambda: LEVEL,
) -> Renderer:
    """Return the renderer of a scene for the camera and objective of a rig, with the hidden errors of its pixels."""
    objective, camera = limits.objective, limits.camera
    pixel_um = limits.pixel_um * (1 + errors.pixel_fraction)
    optics = Optics(na=objective.numerical_aperture, wavelength_um=objective.wavelength_um, pixel_um=pixel_um)
    sensor = Sensor(
        rows=camera.rows,
        cols=camera.cols,
        bits=camera.bits,
        shading_fraction=errors.shading_fraction,
        black_counts=errors.black_counts,
    )
    return FrameRenderer(
        scene(name),
        optics,
        sensor,
        camera_rotation_rad=errors.camera_rotation_rad,
        distortion_fraction=errors.distortion_fraction,
        slopes=slopes,
    )


def scene_overview(name: str) -> Overview:
    """Return the overview image and the layout of a scene's sample."""
    sample = scene(name)
    pixel_um = sample.width_um / OVERVIEW_PX
    dies = [sample.dies.rectangle_um(*cell) for cell in sample.dies.cells] if sample.dies else []
    return Overview(
        image=_overview_image(sample),
        pixel_um=pixel_um,
        x0_um=(pixel_um - sample.width_um) / 2,
        y0_um=(sample.height_um - pixel_um) / 2,
        outline_um=sample.outline_um,
        dies_um=tuple(corners(*die) for die in dies),
        title=sample.title,
    )


def _overview_image(sample: Scene) -> NDArray[np.uint8]:
    """Return the overview image of a sample, which is drawn once for a state of the sources."""
    state, path = kernel_state(), cache_folder() / f"overview-{sample.name}.npz"
    with suppress(OSError, EOFError, KeyError, ValueError, BadZipFile), path.open("rb") as file:
        stored = np.load(file)
        if stored["state"] == state:
            return stored["image"]
    image = overview(sample, OVERVIEW_PX)
    if is_writable(path.parent):
        part = path.with_name(f"{path.stem}.{os.getpid()}.npz")
        with suppress(OSError):
            np.savez(part, state=state, image=image)
            part.replace(path)
    return image


def corners(left: float, lower: float, right: float, upper: float) -> tuple[tuple[float, float], ...]:
    """Return the corners of a rectangle, anticlockwise."""
    return (left, lower), (right, lower), (right, upper), (left, upper)
