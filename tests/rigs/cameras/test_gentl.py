"""Settings of GenTL cameras, on genicam's virtual producer, which has neither triggers nor exposure times."""

from __future__ import annotations

import pytest

from wafer_viewer.model.acquisition.focus_stack import FrameStatus
from wafer_viewer.model.errors import RigError


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"exposure_us": 1000.0}, "offers no TriggerSource: it cannot be used with these options"),
        ({"trigger": "Free"}, "offers no exposure time: give its fixed one as exposure_us"),
        ({"trigger": "Free", "gain": 2.0}, "offers no Gain"),
        ({"trigger": "Free", "pixel_format": "Mono12p"}, "has no PixelFormat 'Mono12p': choose one of RGBa8, Mono8"),
        ({"trigger": "Free", "device": ""}, "3 cameras were found by viky.cti: choose one as device: VikyTL_DEV_red, "),
        ({"trigger": "Free", "device": "blue"}, "'blue' was not found by viky.cti"),
        ({"trigger": "Free", "rows": 4000}, "refuses or does not answer"),
        ({"producer": "lacking.cti"}, "'lacking.cti' does not exist: install the driver of the camera"),
    ],
)
def test_settings_that_the_camera_lacks_are_refused_in_words(gentl, options, words):
    with pytest.raises(RigError, match=words):
        gentl(**options)


def test_a_camera_can_be_opened_again(gentl):
    options = {"trigger": "Free", "exposure_us": 1000.0, "rows": 100, "cols": 120}
    camera = gentl(**options)
    assert camera.name == "Machine Vision Games Ltd. Viky 0"
    camera.close()
    with pytest.raises(RigError, match="is closed"):
        camera.start(1000.0)
    gentl(**options)


def test_a_frame_that_the_producer_calls_incomplete_has_no_image(gentl, monkeypatch):
    camera = gentl(trigger="Free", exposure_us=1000.0, rows=100, cols=120)
    acquirer = camera._acquirer
    camera.start(1000.0)
    with monkeypatch.context() as patched:
        patched.setattr(acquirer, "try_fetch", lambda **_: acquirer._emit_callbacks(acquirer.Events.INCOMPLETE_BUFFER))
        image = camera.next_image(1.0)
    assert (image.image, image.trigger_count, image.status) == (None, None, FrameStatus.INCOMPLETE)
    assert camera.next_image(1.0).status is FrameStatus.OK
