"""Independent parties: the makers' packages on the simulated controllers, and the true firmware of GRBL on its driver.

``zaber-motion`` and ``pipython`` (with ``pyusb``) are skipped where they are not installed. The GRBL simulator, GPL C
code from github.com/gnea/grbl with github.com/grbl/grbl-sim in its folder grbl, is built by
``make main CC="gcc -fcommon"``; it is skipped where the variable GRBL_SIM does not name its program.
"""

from __future__ import annotations

import os
import pty
import shutil
import socket
import subprocess
import threading
import tty
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.rigs.stages.conftest import axis_config, small_limits
from wafer_viewer.model.errors import RigError
from wafer_viewer.rigs.composed.rig import SystemClock, open_port
from wafer_viewer.rigs.stages.controllers import CONTROLLERS
from wafer_viewer.rigs.stages.grbl import GrblController
from wafer_viewer.rigs.stages.motion_controller import ControllerAxis
from wafer_viewer.rigs.virtual.clock import VirtualClock
from wafer_viewer.rigs.virtual.stage import VirtualStage, standing

pytestmark = pytest.mark.slow
GRBL_SIM = os.environ.get("GRBL_SIM") or shutil.which("grbl_sim.exe")


class Wire:
    """A simulated controller behind a socket or a pseudo-terminal; its clock jumps ahead by 20 ms for every command."""

    def __init__(self, driver: str) -> None:
        self.clock, self.limits = VirtualClock(), small_limits()
        self.stage = VirtualStage(self.clock, self.limits)
        self.axes = {axis: axis_config(driver, axis, self.limits, zero_units=0.0) for axis in ("x", "y", "z")}
        for axis, config in self.axes.items():
            self.stage.axes[axis].profile = standing(config.low_um + 500.0)
        self.device = CONTROLLERS[driver].simulate(self.clock, self.stage, self.axes)

    def serve(self, end: socket.socket) -> None:
        try:
            while data := end.recv(4096):
                self.clock.sleep(0.02)
                end.sendall(self.device.receive(data, self.clock.now_s()))
        except OSError:
            return


@contextmanager
def listening(wire: Wire) -> Generator[int]:
    """Accept one connection on a free port of this machine."""
    with socket.create_server(("127.0.0.1", 0)) as server:

        def accept() -> None:
            try:
                end, _ = server.accept()
            except OSError:
                return
            with end:
                wire.serve(end)

        thread = threading.Thread(target=accept, daemon=True)
        thread.start()
        yield server.getsockname()[1]
    thread.join(5)


@pytest.mark.campaign
def test_the_makers_package_drives_the_simulated_zaber():
    ascii_protocol = pytest.importorskip("zaber_motion.ascii")
    errors = pytest.importorskip("zaber_motion")
    wire = Wire("zaber")
    with listening(wire) as port, ascii_protocol.Connection.open_tcp("127.0.0.1", port) as connection:
        connection.checksum_enabled = True
        devices = connection.detect_devices(identify_devices=False)
        assert [device.device_address for device in devices] == [1, 2]
        axis = connection.get_device(2).get_axis(2)
        assert not axis.is_homed()
        assert "WR" in axis.warnings.get_flags()
        axis.home()
        assert axis.is_homed()
        config = wire.axes["z"]
        assert axis.get_position() == round(config.units_at(config.low_um))
        axis.move_absolute(round(config.units_at(250.0)))
        assert wire.stage.position().z_um == pytest.approx(250.0, abs=0.05)
        axis.move_relative(-2_000)
        assert axis.get_position() == round(config.units_at(250.0)) - 2_000
        axis.settings.set("maxspeed", 1000)
        assert axis.settings.get("maxspeed") == 1000
        axis.move_velocity(20_000)
        assert axis.is_busy()
        axis.stop()
        assert not axis.is_busy()
        with pytest.raises(errors.exceptions.CommandFailedException, match="BADDATA"):
            axis.move_absolute(round(config.units_at(1e6)))
        wire.device.axes["z"].stall()
        with pytest.raises(errors.exceptions.MovementFailedException, match="FS"):
            axis.wait_until_idle()


def test_the_makers_package_drives_the_simulated_pi():
    pipython = pytest.importorskip("pipython.pidevice")
    from pipython.pidevice.gcs2.gcs2commands import GCS2Commands
    from pipython.pidevice.gcsmessages import GCSMessages
    from pipython.pidevice.interfaces.pisocket import PISocket

    wire = Wire("pi_gcs2")
    with listening(wire) as port, PISocket("127.0.0.1", port) as gateway:
        device = GCS2Commands(GCSMessages(gateway))
        assert "Physik Instrumente" in device.qIDN()
        assert device.qSAI() == ["1", "2", "3"]
        assert device.qFRF("3") == {"3": False}
        with pytest.raises(pipython.GCSError, match="servo"):
            device.MOV("3", 1.0)
        device.SVO(["1", "2", "3"], [True] * 3)
        device.FRF("3")
        while not device.IsControllerReady():
            pass
        assert device.qFRF("3") == {"3": True}
        device.VEL("3", 2.0)
        assert device.qVEL("3") == {"3": 2.0}
        device.MOV("3", 0.25)
        while device.IsMoving("3")["3"]:
            pass
        assert device.qONT("3") == {"3": True}
        assert device.qPOS("3")["3"] == pytest.approx(0.25, abs=1e-4)
        assert wire.stage.position().z_um == pytest.approx(250.0, abs=0.1)
        with pytest.raises(pipython.GCSError, match="limits"):
            device.MOV("3", 1e3)
        device.MOV("3", 5.0)
        assert device.IsMoving("3")["3"]
        device.StopAll(noraise=True)
        while device.IsMoving("3")["3"]:
            pass
        assert 0.25 < device.qPOS("3")["3"] < 5.0


@pytest.fixture
def grbl_port(tmp_path) -> Generator[str]:
    """The name of a port at which GRBL itself runs. All of its limit switches read as pressed."""
    if not GRBL_SIM or not Path(GRBL_SIM).exists():
        pytest.skip("GRBL_SIM does not name the program of the GRBL simulator")
    board_end, our_end = pty.openpty()
    tty.setraw(our_end)
    program = ["stdbuf", "-i0", "-o0", GRBL_SIM, "-n", "-s", "/dev/null", "-b", "/dev/null"]
    board = subprocess.Popen(program, stdin=board_end, stdout=board_end, stderr=subprocess.DEVNULL, cwd=tmp_path)
    yield os.ttyname(our_end)
    board.kill()
    board.wait()
    os.close(board_end)
    os.close(our_end)


def grbl_axis(letter: str, speed: float = 8.0) -> ControllerAxis:
    return ControllerAxis(letter, speed, 10.0)


def send(port, line: bytes) -> None:
    port.timeout = 5.0
    port.write(line + b"\n")
    assert port.read_until(b"ok\r\n").endswith(b"ok\r\n")


def wait_for_rest(grbl: GrblController, clock: SystemClock) -> None:
    while grbl.moving():
        clock.sleep(0.01)


def test_the_driver_drives_grbl_itself(grbl_port):
    clock, port = SystemClock(), open_port(grbl_port, 115_200)
    with pytest.raises(RigError, match=r"\$22 of the GRBL controller must be 1"):
        GrblController(port, clock, {"x": grbl_axis("X")})
    send(port, b"$22=1")
    with pytest.raises(RigError, match=r"speed of the x axis.*\$110=500"):
        GrblController(port, clock, {"x": grbl_axis("X", speed=9.0)})
    grbl = GrblController(port, clock, {"x": grbl_axis("X"), "y": grbl_axis("Y")})
    assert "1.1h" in grbl.identity()
    assert grbl.homed() == []
    send(port, b"$X")
    grbl.move({"x": -4.0, "y": 2.0}, {"x": 8.0, "y": 4.0})
    assert sorted(grbl.moving()) == ["x", "y"]
    wait_for_rest(grbl, clock)
    assert grbl.positions() == {"x": -4.0, "y": 2.0}
    grbl.move({"x": 20.0}, {"x": 8.0})
    clock.sleep(1.0)
    grbl.stop()
    wait_for_rest(grbl, clock)
    stood = grbl.positions()["x"]
    assert -4.0 < stood < 15.0
    grbl.move({"x": stood}, {"x": 8.0})
    assert not grbl.moving()
    grbl.home(["x", "y"])
    with pytest.raises(RigError, match=r"ALARM:8: it did not leave the limit switch"):
        wait_for_rest(grbl, clock)
    assert grbl.homed() == []
    grbl.close()


def test_a_reset_ends_a_search_of_grbl_itself(grbl_port):
    clock, port = SystemClock(), open_port(grbl_port, 115_200)
    port.timeout = 5.0
    assert b"for help]" in port.read_until(b"for help]\r\n")
    send(port, b"$5=1")
    send(port, b"$22=1")
    grbl = GrblController(port, clock, {"x": grbl_axis("X")})
    grbl.home(["x"])
    clock.sleep(0.5)
    assert grbl.moving() == ["x"]
    grbl.stop()
    assert not grbl.moving()
    assert grbl.homed() == []
    grbl.close()
