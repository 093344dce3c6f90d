"""Cameras to hold the role against: the virtual one and those of other people's simulators."""

from __future__ import annotations

import fcntl
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from tests.support import fake_gige_camera
from wafer_viewer.model.acquisition.devices import Camera
from wafer_viewer.model.acquisition.plan import PulseTrain
from wafer_viewer.model.acquisition.rig_limits import CameraLimits
from wafer_viewer.rigs.cameras.drivers import CAMERAS
from wafer_viewer.rigs.virtual.rig import VirtualRig, virtual_limits

ROWS, COLS = 48, 64
REGION = {"rows": ROWS, "cols": COLS}
ON_COMMAND = PulseTrain(axis="z", first_count=0, counts_per_frame=100, n_frames=100, direction=1)


@dataclass
class Bench:
    """A camera with what makes it take a frame; `bits` of its images; `free`: it takes frames by itself."""

    camera: Camera
    limits: CameraLimits
    fire: Callable[[], None]
    close: Callable[[], None]
    free: bool = False

    def start(self):
        self.camera.start(self.limits.exposure_min_us * 2 if self.limits.exposure_max_us > 1000 else 1000.0)

    def take(self, n):
        """Take n frames one by one."""
        images = []
        for _ in range(n):
            if not self.free:
                self.fire()
            images.append(self.camera.next_image(2.0))
        return images


class GreyRenderer:
    def frame(self, x_um, y_um, z_um, exposure_us, seed):
        return np.full((ROWS, COLS), 100, np.uint8)


def virtual(exits):
    rig = VirtualRig(renderer=GreyRenderer(), limits=virtual_limits(ROWS, COLS))
    rig.box.reference(ON_COMMAND.axis, 0)
    rig.box.arm(ON_COMMAND, on_command=True)

    def fire():
        rig.box.fire()
        rig.clock.sleep(0.02)

    exits.append(rig.close)
    return Bench(rig.camera, rig.limits.camera, fire, rig.close)


def installed(driver):
    """Return a driver, or skip the test if its library is missing."""
    if CAMERAS[driver].missing:
        pytest.skip(CAMERAS[driver].missing)
    return CAMERAS[driver]


def fake_gige_address(exits):
    fake_gige(exits)
    return {"device": "127.0.0.1", "packet_bytes": 8000}


def connected(driver, **options):
    def bench(exits):
        chosen = installed(driver)
        camera = chosen.open(chosen.options(**OTHERS_SIMULATORS[driver](exits), **options))
        exits.append(camera.close)
        return Bench(camera, camera.limits, camera.fire, camera.close, camera.trigger == "free")

    return bench


def fake_gige(exits, lost=0.0):
    """Start the fake GigE camera; one on this computer at a time, as its port is fixed."""
    lock = (Path(tempfile.gettempdir()) / "wafer_viewer_fake_gige_camera.lock").open("w")
    fcntl.flock(lock, fcntl.LOCK_EX)
    exits.append(lock.close)
    command = [sys.executable, fake_gige_camera.__file__, str(lost)]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)

    def end():
        process.kill()
        process.communicate()

    exits.append(end)
    assert process.stdout.readline() == b"ready\n"
    return process


def demo_adapters(_):
    adapters = pytest.importorskip("mm_test_adapters", reason="pip install mm-test-adapters for simulated cameras")
    return {"adapters": adapters.device_adapter_path()}


def genicam_producer(_):
    import genicam

    return {"producer": str(Path(genicam.__file__).parent / "viky.cti"), "device": "VikyTL_DEV_red"}


OTHERS_SIMULATORS = {"aravis": fake_gige_address, "micro_manager": demo_adapters, "gentl": genicam_producer}
DEMO = {"library": "DemoCamera", "device": "DCam", "frame_rate_hz": 100.0}
KINDS = {
    "virtual": virtual,
    "aravis, software": connected("aravis", trigger="Software", **REGION),
    "aravis, free, 16 bits": connected("aravis", trigger="Free", pixel_format="Mono16", frame_rate_hz=60.0, **REGION),
    "micro-manager, software": connected("micro_manager", trigger="software", **DEMO, **REGION),
    "micro-manager, free, 12 bits": connected(
        "micro_manager", trigger="free", **DEMO, **REGION, properties={"PixelType": "16bit", "BitDepth": "12"}
    ),
    "gentl, free": connected(
        "gentl", trigger="Free", frame_rate_hz=100.0, exposure_us=1000.0, rows=100, cols=120, buffers=30
    ),
}


@pytest.fixture
def exits():
    """Functions to call at the end of the test, the last one first."""
    functions = []
    yield functions
    for function in reversed(functions):
        function()


QUICK = ("virtual", "micro-manager, software", "micro-manager, free, 12 bits")
"""Kinds whose frames come without much waiting."""


@pytest.fixture(params=[pytest.param(kind, marks=[pytest.mark.slow] * (kind not in QUICK)) for kind in KINDS])
def bench(request, exits):
    """Every kind of camera in turn."""
    return KINDS[request.param](exits)


@pytest.fixture
def aravis(exits):
    """A function that starts the fake GigE camera with a fraction of packets lost, and one that connects to it."""
    driver = installed("aravis")

    def connect(**options):
        camera = driver.open(driver.options(**{"device": "127.0.0.1", "packet_bytes": 8000, **options}))
        exits.append(camera.close)
        return camera

    return lambda lost=0.0: fake_gige(exits, lost), connect


@pytest.fixture
def micro_manager(exits):
    """A function that connects to a simulated Micro-Manager camera, by default the demonstration camera."""
    driver = installed("micro_manager")

    def connect(**options):
        camera = driver.open(driver.options(**demo_adapters(exits), **({} if "config" in options else DEMO) | options))
        exits.append(camera.close)
        return camera

    return connect


@pytest.fixture
def gentl(exits):
    """A function that connects to a camera of genicam's virtual producer."""
    driver = installed("gentl")

    def connect(**options):
        camera = driver.open(driver.options(**genicam_producer(exits) | options))
        exits.append(camera.close)
        return camera

    return connect
