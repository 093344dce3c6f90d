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
    rig.box.arm(ON_COMMAND, on_command=True)

    def fire():
        rig.box.fire()
        rig.clock.sleep(0.02)

    exits.append(rig.close)
    return Bench(rig.camera, rig.limits.camera, fire, rig.close)


def connected(driver, **options):
    def bench(exits):
        chosen = CAMERAS[driver]
        if chosen.missing:
            pytest.skip(chosen.missing)
        camera = chosen.open(chosen.options(**OTHERS_SIMULATORS[driver](exits), **options))
        exits.append(camera.close)
        return Bench(camera, camera.limits, camera.fire, camera.close, camera.trigger == "free")

    return bench


def fake_gige(exits, lost=0):
    """Start the fake GigE camera and return the options to reach it; one at a time, as it has a fixed port."""
    lock = (Path(tempfile.gettempdir()) / "wafer_viewer_fake_gige_camera.lock").open("w")  # noqa: SIM115
    fcntl.flock(lock, fcntl.LOCK_EX)
    exits.append(lock.close)
    process = subprocess.Popen([sys.executable, fake_gige_camera.__file__, str(lost)], stdout=subprocess.PIPE)

    def end():
        process.kill()
        process.communicate()

    exits.append(end)
    assert process.stdout.readline() == b"ready\n"
    return {"device": "127.0.0.1", "packet_bytes": 8000}


def demo_adapters(_):
    adapters = pytest.importorskip("mm_test_adapters", reason="pip install mm-test-adapters for simulated cameras")
    return {"adapters": adapters.device_adapter_path()}


def genicam_producer(_):
    import genicam

    return {"producer": str(Path(genicam.__file__).parent / "viky.cti"), "device": "VikyTL_DEV_red"}


OTHERS_SIMULATORS = {"aravis": fake_gige, "micro_manager": demo_adapters, "gentl": genicam_producer}
DEMO = {"library": "DemoCamera", "device": "DCam", "frame_rate_hz": 100.0}
KINDS = {
    "virtual": virtual,
    "aravis, software": connected("aravis", trigger="Software", **REGION),
    "aravis, software, 16 bits": connected("aravis", trigger="Software", pixel_format="Mono16", **REGION),
    "aravis, free": connected("aravis", trigger="Free", frame_rate_hz=60.0, **REGION),
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


@pytest.fixture(params=KINDS)
def bench(request, exits):
    """Every kind of camera in turn."""
    return KINDS[request.param](exits)


@pytest.fixture
def connect(exits):
    """A function that connects to a camera of a driver by its options, on top of those of its simulator."""

    def open_camera(driver, **options):
        return connected(driver, **options)(exits).camera

    return open_camera
