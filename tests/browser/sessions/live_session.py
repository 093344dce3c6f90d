"""A session that stands still at the bench: a live frame, scores over z, marks and places."""

from __future__ import annotations

import dataclasses
import time

import numpy as np

from tests.browser.sessions.fake_session import FakeSession, planned
from wafer_viewer.acquire.commanded_frames import CommandedFrame
from wafer_viewer.model.acquisition.devices import Position
from wafer_viewer.model.acquisition.positioners import PositionerLimits, PositionerReading, PositionerState
from wafer_viewer.session.acquisition.live_camera import live_frame
from wafer_viewer.session.acquisition.live_controller import LiveLook
from wafer_viewer.session.state.instrument_state import FocusTrace, LivePlace, LiveState

HERE = Position(80.6, -32.4, 2.0)
POSITIONERS = (
    PositionerState(
        PositionerLimits(role="light", low=0.0, high=100.0),
        PositionerReading(name="lamp", role="light", position=80.0, unit="%"),
    ),
    PositionerState(
        PositionerLimits(role="objective", low=0.0, high=90.0, named={"10x": 0.0, "20x": 90.0}),
        PositionerReading(name="nosepiece", role="objective", position=0.0, unit="deg", named="10x"),
    ),
    PositionerState(
        PositionerLimits(role="tilt_a", low=-2.0, high=2.0),
        PositionerReading(name="tilt_a", role="tilt_a", unit="deg"),
    ),
)


def a_frame(z_um: float = HERE.z_um) -> LiveLook:
    """A frame of streets between dies, some of it at the limit, with the scores around it."""
    y, x = np.mgrid[:540, :720]
    streets = (np.abs(x - 360) < 40) | (np.abs(y - 270) < 40)
    image = np.where(streets, 190, 70 + 40 * ((x // 24 + y // 24) % 2)).astype(np.uint8)
    image[np.abs(x - y - 90) < 9] = 255
    points = tuple((float(z), float(0.1 + np.exp(-(((z - 4.6) / 6) ** 2)))) for z in np.arange(-30, 52, 1.5))
    frame = live_frame(CommandedFrame(image, Position(HERE.x_um, HERE.y_um, z_um)), 120.0)
    score = 0.1 + float(np.exp(-(((z_um - 4.6) / 6) ** 2)))
    frame = dataclasses.replace(frame, score=score, taken_s=time.time())
    return LiveLook(frame, FocusTrace(HERE.x_um, HERE.y_um, points, 4.6, 0.12), 19.8)


def live_session() -> FakeSession:
    """A planned session with the live view at a place near the first corner."""
    corners = LivePlace("Corner 1", -1248.0, 720.0, 3.1), LivePlace("Corner 2", 1242.0, -693.6, 6.8)
    live = LiveState(
        exposure_us=120.0,
        corners=corners,
        lowest_um=-25.0,
        highest_um=45.0,
        places=(LivePlace("Gauge blocks", 8100.0, -4250.0, 1640.2),),
        began_um=0.0,
    )
    now = planned()
    rig = dataclasses.replace(now.rig, x_um=HERE.x_um, y_um=HERE.y_um, z_um=HERE.z_um, positioners=POSITIONERS)
    session = FakeSession(dataclasses.replace(now, live=live, rig=rig))
    session.live.latest = a_frame()
    return session
