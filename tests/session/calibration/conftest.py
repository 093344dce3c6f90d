"""A virtual rig with hidden errors over a sample without end."""

from __future__ import annotations

import pytest

from tests.support.wave_renderer import COLS, PIXEL_UM, ROWS, WaveRenderer
from wafer_viewer.rigs.virtual.faults import CalibrationErrors
from wafer_viewer.rigs.virtual.rig import VirtualRig, virtual_limits


@pytest.fixture
def hidden_rig():
    """A function that switches a rig on whose pixel size, rotation and delay differ from its calibration."""
    rigs = []

    def switch_on(
        seed=0, shape=(ROWS, COLS), pixel_fraction=2e-4, rotation_rad=1e-4, trigger_delay_us=50.0, renderer=None, **more
    ):
        renderer = renderer or WaveRenderer(PIXEL_UM * (1 + pixel_fraction), rotation_rad, shape=shape)
        errors = CalibrationErrors(trigger_delay_us=trigger_delay_us, **more)
        rigs.append(VirtualRig(seed=seed, limits=virtual_limits(*shape), renderer=renderer, errors=errors))
        return rigs[-1]

    yield switch_on
    for rig in rigs:
        rig.close()
