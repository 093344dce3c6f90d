"""Boxes to hold the contract of the role PulseBox against."""

from __future__ import annotations

import pytest

from tests.rigs.pulse_box.worlds import ProgramWorld, VirtualWorld, build, missing_tools


@pytest.fixture(scope="session")
def built(tmp_path_factory):
    """A function that builds targets of the firmware once and returns their folder, or skips."""
    folder = tmp_path_factory.mktemp("pulse_box")

    def make(*targets):
        if reason := missing_tools(*targets):
            pytest.skip(f"The firmware cannot be built: {reason}.")
        build(folder, *targets)
        return folder

    return make


@pytest.fixture(params=["virtual", "host", pytest.param("atmega2560", marks=[pytest.mark.slow, pytest.mark.real_time])])
def world(request, built):
    """Each kind of box in turn, with a scale and a watched trigger."""
    if request.param == "virtual":
        one = VirtualWorld()
    elif request.param == "host":
        one = ProgramWorld(built("sanitize") / "pulse_box_host_sanitized")
    else:
        folder = built("avr", "emulator")
        one = ProgramWorld(folder / "atmega2560", folder / "pulse_box_atmega2560.elf")
    yield one
    one.close()
