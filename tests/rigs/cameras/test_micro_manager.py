"""Settings and faults of Micro-Manager cameras, on the device adapters for tests."""

from __future__ import annotations

import time

import numpy as np
import pytest

from wafer_viewer.model.errors import RigError


def test_twelve_bits_fill_the_range_of_sixteen(micro_manager):
    camera = micro_manager(
        trigger="software", properties={"PixelType": "16bit", "BitDepth": "12", "SaturatePixels": "1"}
    )
    assert camera.limits.bits == 12
    camera.start(10_000.0)
    camera.fire()
    image = camera.next_image(1.0).image
    assert image.dtype == np.uint16
    assert image.max() == 65535


def test_a_configuration_file_names_the_camera(micro_manager, tmp_path):
    file = tmp_path / "rig.cfg"
    file.write_text(
        "Device,Eye,DemoCamera,DCam\nProperty,Core,Initialize,1\nProperty,Core,Camera,Eye\nProperty,Eye,Binning,2\n"
    )
    camera = micro_manager(config=str(file), trigger="software")
    assert (camera.limits.rows, camera.limits.cols) == (256, 256)


def test_a_buffer_that_overflows_is_reported(micro_manager):
    camera = micro_manager(trigger="free", properties={"PixelType": "16bit"}, buffers=30)
    camera.start(10.0)
    deadline_s = time.monotonic() + 20.0
    while not camera._core.isBufferOverflowed() and time.monotonic() < deadline_s:
        time.sleep(0.01)
    with pytest.raises(RigError, match="the buffer of 30 frames is full: lower the frame rate or raise buffers"):
        camera.next_image(0.0)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({}, "properties is {}: it must be the property of the camera that selects its trigger input"),
        ({"trigger": "free", "library": ""}, "config is '': it must be a hardware configuration file"),
        ({"trigger": "free", "config": "lacking.cfg"}, "lacking.cfg.* open failed"),
        ({"trigger": "free", "library": "Lacking"}, 'Failed to load device adapter "Lacking"'),
        ({"trigger": "free", "properties": {"Colour": "red"}}, "Invalid property name encountered: Colour"),
        ({"trigger": "free", "properties": {"PixelType": "32bitRGB"}}, "sends colour or 32 bits per pixel"),
        ({"trigger": "free", "cols": 100, "left": 500}, "has 512 x 512 pixels: its region of 100 x 512 at"),
    ],
)
def test_settings_that_the_camera_lacks_are_refused_in_words(micro_manager, options, words):
    with pytest.raises(RigError, match=words):
        micro_manager(**options)


def test_adapters_need_a_folder_and_an_open_camera(micro_manager):
    camera = micro_manager(trigger="free")
    with pytest.raises(RigError, match="takes no frame on command"):
        camera.fire()
    camera.close()
    with pytest.raises(RigError, match="is closed"):
        camera.start(1000.0)
