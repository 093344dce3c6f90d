"""Boxes to hold the contract of the role PulseBox against."""

from __future__ import annotations

import pytest

from tests.rigs.pulse_box.worlds import (
    ATMEGA2560,
    RP2040_DRAWN,
    RP2040_USB,
    RP2040JS,
    ProgramWorld,
    Rp2040World,
    VirtualWorld,
    build,
    missing_tools,
)


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


@pytest.fixture(scope="session")
def rp2040_image(built):
    """The image for the RP2040, where its emulator is installed too."""
    if not RP2040JS.exists():
        pytest.skip("The emulator of the RP2040 is not installed: npm package rp2040js.")
    return built("rp2040") / "pulse_box_rp2040.uf2"


@pytest.fixture(params=["virtual", "host", ATMEGA2560, RP2040_DRAWN, RP2040_USB])
def world(request, built):
    """Each kind of box in turn, with a scale and a watched trigger."""
    if request.param == "virtual":
        one = VirtualWorld()
    elif request.param == "host":
        one = ProgramWorld(built("sanitize") / "pulse_box_host_sanitized")
    elif request.param.startswith("rp2040"):
        one = Rp2040World(request.getfixturevalue("rp2040_image"), over_usb=request.param == "rp2040_usb")
    else:
        folder = built("avr", "emulator")
        one = ProgramWorld(folder / "atmega2560", folder / "pulse_box_atmega2560.elf")
    yield one
    one.close()
