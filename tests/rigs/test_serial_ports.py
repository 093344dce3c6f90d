"""Ports that are named by what their device calls itself, and ports that go and come back."""

from __future__ import annotations

import os
import pty
import tty
from contextlib import suppress

import pytest
from serial.tools import list_ports
from serial.tools.list_ports_common import ListPortInfo

from wafer_viewer.model.errors import PulseBoxRestarted, RigError
from wafer_viewer.rigs.composed.rig import ReopenedPort, SystemClock, open_port
from wafer_viewer.rigs.pulse_box.client import PulseBoxClient
from wafer_viewer.rigs.virtual.clock import VirtualClock
from wafer_viewer.rigs.virtual.pulse_box_firmware import VirtualPulseBox
from wafer_viewer.rigs.virtual.rig import virtual_limits
from wafer_viewer.rigs.virtual.stage import VirtualStage


class Cable:
    """A pseudo-terminal behind a link, as a system makes one for a device on USB; the device may go and come back."""

    def __init__(self, link):
        self.link = link
        self.plug()

    def plug(self):
        self.far, near = pty.openpty()
        tty.setraw(near)
        os.set_blocking(self.far, False)
        self.link.unlink(missing_ok=True)
        self.link.symlink_to(os.ttyname(near))
        self.near = near

    def pull(self):
        os.close(self.near)
        os.close(self.far)
        self.link.unlink()


@pytest.fixture
def cable(tmp_path):
    one = Cable(tmp_path / "usb-Pulse_box")
    yield one
    for fd in (one.near, one.far):
        with suppress(OSError):
            os.close(fd)


@pytest.fixture
def name_ports(monkeypatch):
    """A function that gives this machine ports, each with its device, product and serial number."""

    def give(*ports):
        found = []
        for device, product, number in ports:
            port = ListPortInfo(str(device), skip_link_detection=True)
            port.product, port.serial_number = product, number
            found.append(port)
        monkeypatch.setattr(list_ports, "comports", lambda: found)

    return give


@pytest.mark.parametrize("name", ["usb:Pulse box", "usb:pulse BOX", "usb:E6605838832A1B2C", "usb:e6605838832a1b2c"])
def test_a_port_is_found_by_the_name_or_the_number_of_its_device(name, cable, name_ports):
    name_ports(("/dev/ttyS0", None, None), (cable.link, "Pulse box", "E6605838832A1B2C"), ("/dev/x", "Stage", "7"))
    port = open_port(name, 115_200)
    port.write(b"HELLO")
    assert os.read(cable.far, 9) == b"HELLO"
    port.close()


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("usb:Pulse box", r"/dev/a, /dev/b have this name: use a serial number"),
        ("usb:Camera", r"no device on USB has this name.*machine: /dev/a \(usb:Pulse box or usb:1\), /dev/b "),
        ("usb:", "no device on USB has this name"),
    ],
)
def test_a_name_that_fits_none_or_several_is_refused_and_the_names_are_told(name, message, name_ports):
    name_ports(("/dev/a", "Pulse box", "1"), ("/dev/b", "Pulse box", "2"), ("/dev/c", "", None))
    with pytest.raises(RigError, match=message):
        open_port(name, 115_200)


def test_a_port_that_went_is_silent_until_it_is_back(cable):
    port = ReopenedPort(str(cable.link), 115_200)
    os.write(cable.far, b"before")
    port.timeout = 1.0
    assert port.read(6) == b"before"
    cable.pull()
    port.timeout = 0.01
    assert (port.read(1), port.in_waiting) == (b"", 0)
    assert port.write(b"lost") == 0
    cable.plug()
    assert port.write(b"back") == 4
    assert os.read(cable.far, 9) == b"back"
    os.write(cable.far, b"after")
    port.timeout = 1.0
    assert port.read(5) == b"after"
    port.close()


def test_a_box_that_restarts_and_takes_its_port_along_is_told_by_its_new_number(cable):
    class Answering:
        """The port, at whose far end the virtual box answers what was written; a restart takes the port along."""

        def __init__(self):
            self.port = ReopenedPort(str(cable.link), 115_200)
            self.timeout = None
            clock = VirtualClock()
            stage = VirtualStage(clock, virtual_limits(16, 24))
            self.box = VirtualPulseBox(clock, stage, lambda time_s: True)
            self.time_s = 0.0

        in_waiting = property(lambda self: self.port.in_waiting)

        def read(self, size=1, /):
            self.port.timeout = self.timeout
            return self.port.read(size)

        def write(self, data, /):
            if self.port.write(data):
                self.time_s += 10.0
                os.write(cable.far, self.box.receive(os.read(cable.far, 999), self.time_s))
            return len(data)

        def close(self):
            self.port.close()

    port = Answering()
    box = PulseBoxClient(port, SystemClock())
    box.reference("z", 5)
    cable.pull()
    port.box.reboot()
    cable.plug()
    with pytest.raises(PulseBoxRestarted, match="restarted"):
        box.count("z")
    box.close()
