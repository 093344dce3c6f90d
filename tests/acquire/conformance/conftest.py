"""A virtual rig whose pictures grow brighter with the exposure, and the numbers at which each check begins."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from wafer_viewer.acquire.conformance.runner import CHECKS, run_checks
from wafer_viewer.model.acquisition.conformance import ConformanceResult
from wafer_viewer.rigs.virtual.faults import Faults
from wafer_viewer.rigs.virtual.rig import VirtualRig, virtual_limits

BY_NAME = {check.name: check for check in CHECKS}


class GreyRenderer:
    """Pictures as bright as their exposure is long; `light` 0 is darkness."""

    def __init__(self, light=1.0):
        self.light = light

    def frame(self, x_um, y_um, z_um, exposure_us, seed):
        ramp = np.linspace(0.9, 1.1, 16 * 24).reshape(16, 24)
        return np.clip(self.light * exposure_us * ramp, 0, 255).astype(np.uint8)


@dataclass
class Begun:
    """Triggers and motions that a rig had carried out when a check began."""

    triggers: dict[str, int]
    motions: dict[str, int]


@pytest.fixture(scope="session")
def switched_on():
    """A function that switches on a small virtual rig."""

    def switch_on(faults=None, light=1.0):
        return VirtualRig(limits=virtual_limits(16, 24), renderer=GreyRenderer(light), faults=faults or Faults())

    return switch_on


@pytest.fixture(scope="session")
def healthy(switched_on) -> tuple[list[ConformanceResult], Begun]:
    """Results of a rig without faults, and the numbers at which each check began."""
    rig, begun = switched_on(), Begun({}, {})

    def begin(check):
        begun.triggers[check.name], begun.motions[check.name] = rig.camera.triggers, rig.stage.motions

    results = list(run_checks(rig, move=True, begin=begin))
    rig.close()
    return results, begun


@pytest.fixture(scope="session")
def begun(healthy) -> Begun:
    return healthy[1]
