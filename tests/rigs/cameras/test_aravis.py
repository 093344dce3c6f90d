"""Faults and settings of GigE cameras, on Aravis' fake camera over the loopback interface."""

from __future__ import annotations

import time

import pytest

from wafer_viewer.model.acquisition.focus_stack import FrameStatus
from wafer_viewer.model.errors import RigError

pytestmark = pytest.mark.slow
RATE_HZ = 60.0


def fetch_for(seconds, camera):
    deadline_s = time.monotonic() + seconds
    while time.monotonic() < deadline_s:
        camera.next_image(0.2)


def test_frames_with_lost_packets_have_no_image_and_no_number(aravis):
    fake, connect = aravis
    fake(lost=0.02)
    camera = connect(trigger="Free", frame_rate_hz=RATE_HZ, rows=512, cols=512)
    camera.start(1000.0)
    images = [image for _ in range(120) if (image := camera.next_image(1.0)) is not None]
    incomplete = [image for image in images if image.status is FrameStatus.INCOMPLETE]
    complete = [image for image in images if image.status is FrameStatus.OK]
    assert len(incomplete) > 10
    assert len(complete) > 10
    assert all(image.image is None and image.trigger_count is None for image in incomplete)
    counts = [image.trigger_count for image in complete]
    assert counts == sorted(set(counts))
    between = images[images.index(complete[0]) : images.index(complete[-1]) + 1]
    periods = (complete[-1].device_time_us - complete[0].device_time_us) * 1e-6 * RATE_HZ
    assert len(between) - 1 <= counts[-1] - counts[0] <= periods + 1


@pytest.mark.campaign
def test_a_lost_camera_is_reported_in_words(aravis):
    fake, connect = aravis
    process = fake()
    camera = connect(trigger="Free", rows=48, cols=64)
    camera.start(1000.0)
    assert camera.next_image(1.0) is not None
    process.kill()
    with pytest.raises(RigError, match="Aravis Fake GV01 no longer answers: check its power and its cable"):
        fetch_for(20.0, camera)
    camera.stop()
    with pytest.raises(RigError, match="no longer answers"):
        camera.start(1000.0)
    camera.close()


def test_the_trigger_line_and_the_region_are_set(aravis):
    fake, connect = aravis
    fake()
    camera = connect(rows=100, cols=200, left=8, top=16, gain=3.0)
    assert camera.trigger == "hardware"
    assert (camera.limits.rows, camera.limits.cols, camera.limits.queue_frames) == (100, 200, 32)
    device = camera._camera
    settings = ("TriggerSelector", "TriggerMode", "TriggerSource", "TriggerActivation")
    assert [device.get_string(name) for name in settings] == ["FrameStart", "On", "Line0", "RisingEdge"]
    assert [device.get_integer(name) for name in ("OffsetX", "OffsetY", "GainRaw")] == [8, 16, 3]
    camera.start(2000.0)
    assert device.get_exposure_time() == 2000.0
    assert camera.next_image(0.2) is None
    with pytest.raises(RigError, match="takes no frame on command: its trigger is 'hardware'"):
        camera.fire()


@pytest.mark.campaign(at_least_one=True)
@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"trigger": "Line7"}, "has no trigger source 'Line7': choose one of Line0, Software"),
        ({"pixel_format": "Mono12p"}, "has no pixel format 'Mono12p': choose one of .*Mono8"),
        ({"pixel_format": "RGB8"}, "'RGB8' cannot be read"),
        ({"gain": 99.0}, "has no gain 99: its range is 0 to 10"),
        ({"device": "GV99"}, "'GV99' was not found by Aravis; found are: Aravis-Fake-GV01"),
        ({"device": "127.0.0.99"}, "refuses or does not answer"),
    ],
)
def test_settings_that_the_camera_lacks_are_refused_in_words(aravis, options, words):
    fake, connect = aravis
    fake()
    with pytest.raises(RigError, match=words):
        connect(**options)


@pytest.mark.campaign
def test_a_camera_is_found_by_its_serial_number_and_has_one_controller(aravis):
    fake, connect = aravis
    fake()
    camera = connect(device="GV01")
    assert camera.name == "Aravis Fake GV01"
    with pytest.raises(RigError, match="is controlled by another program"):
        connect()
    camera.close()
    with pytest.raises(RigError, match="is closed"):
        camera.start(1000.0)
    connect()


def test_too_few_buffers_are_refused(aravis):
    _, connect = aravis
    with pytest.raises(RigError, match="buffers is 8: it must be at least 30"):
        connect(buffers=8)
