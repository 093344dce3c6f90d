"""Rigs to hold every device role against: each contract test runs on all of them."""

from __future__ import annotations

import numpy as np
import pytest

from wafer_viewer.acquire.pulse_reconciliation import reference_axes
from wafer_viewer.rigs.virtual.faults import Faults
from wafer_viewer.rigs.virtual.rig import VirtualRig, virtual_limits
from wafer_viewer.rigs.virtual.serial_port import Interference

BAD_WIRE = Interference(lost_fraction=0.02, damaged_fraction=0.02, seed=3)
KINDS = {
    "virtual": {},
    "virtual, bad wire": {"faults": Faults(wire=BAD_WIRE)},
    "virtual, no trigger counter": {"faults": Faults(trigger_counter=False)},
    "virtual, real time": {"real_time": True},
}


class HeightRenderer:
    """Pictures as grey as z is high."""

    def frame(self, x_um, y_um, z_um, exposure_us, seed):
        return np.full((16, 24), np.clip(round(z_um), 0, 255), np.uint8)


@pytest.fixture
def switch_on():
    """A function that switches a virtual rig on and sets the counts of its pulse box."""
    rigs = []

    def virtual(**settings):
        rigs.append(VirtualRig(**{"renderer": HeightRenderer(), "limits": virtual_limits(16, 24), **settings}))
        reference_axes(rigs[-1])
        return rigs[-1]

    yield virtual
    for rig in rigs:
        rig.close()


@pytest.fixture(params=KINDS)
def rig(request, switch_on):
    """Every kind of rig in turn."""
    return switch_on(**KINDS[request.param])
