"""
Drive a stage of your own
=========================

A stage is one class with eight methods that talk to its controller. This example writes that class for a made-up
controller, and drives it through the code that drives every stage. The controller here is simulated at the far end of
a serial port; with yours, pass ``serial.Serial("/dev/ttyUSB0")`` instead.
"""

from collections.abc import Collection, Mapping

import matplotlib.pyplot as plt

from wafer_viewer.model.errors import RigError
from wafer_viewer.rigs.stages.controller_stage import ControllerStage
from wafer_viewer.rigs.stages.motion_controller import AxisConfig
from wafer_viewer.rigs.virtual.clock import VirtualClock

# %%
# The made-up controller counts in mm and takes lines of text: ``MOVE x 12.5 10`` moves x to 12.5 mm at 10 mm/s.


class LineController:
    """Implementation of MotionController for the made-up protocol."""

    def __init__(self, port):
        self._port = port

    def identity(self) -> str:
        return self._ask("ID")

    def positions(self) -> Mapping[str, float]:
        return {name: float(at) for name, at in (pair.split("=") for pair in self._ask("POS").split())}

    def moving(self) -> Collection[str]:
        return self._ask("BUSY").split()

    def homed(self) -> Collection[str]:
        return self._ask("HOMED").split()

    def home(self, axes: Collection[str]) -> None:
        self._ask(f"HOME {' '.join(axes)}")

    def move(self, goals: Mapping[str, float], speeds: Mapping[str, float]) -> None:
        for axis, goal in goals.items():
            self._ask(f"MOVE {axis} {goal:.6f} {speeds[axis]:.6f}")

    def stop(self) -> None:
        self._ask("STOP")

    def close(self) -> None:
        self._port.close()

    def _ask(self, command: str) -> str:
        self._port.write(f"{command}\n".encode())
        answer = self._port.readline().decode().strip()
        if not answer.startswith("OK"):
            raise RigError(f"The stage answered '{answer}' to '{command}': check its power and its cable.")
        return answer.removeprefix("OK").strip()


# %%
# The simulated controller has the two methods of a serial port that the driver needs. Its time is that of the rig.


class SimulatedController:
    """The far end of the line: three axes that move at constant speed."""

    def __init__(self, clock):
        self._clock = clock
        self._motions = dict.fromkeys("xyz", (0.0, 0.0, 0.0, 1.0))  # start in s, from, to, speed
        self._homed = set()
        self._answer = b""
        self._commands = {
            "ID": lambda: "line stage, simulated",
            "POS": lambda: " ".join(f"{axis}={self._at(axis):.6f}" for axis in self._motions),
            "BUSY": lambda: " ".join(axis for axis, motion in self._motions.items() if self._at(axis) != motion[2]),
            "HOMED": lambda: " ".join(self._homed),
            "HOME": self._home,
            "MOVE": self._move,
            "STOP": self._stop,
        }

    def write(self, line: bytes) -> None:
        name, *words = line.decode().split()
        answer = self._commands[name](*words)
        self._answer = f"OK {answer or ''}\n".encode()

    def readline(self) -> bytes:
        return self._answer

    def close(self) -> None:
        pass

    def _at(self, axis):
        start, begin, end, speed = self._motions[axis]
        way = speed * (self._clock.now_s() - start)
        return end if way >= abs(end - begin) else begin + way * (1 if end > begin else -1)

    def _home(self, *axes):
        for axis in axes:
            self._homed.add(axis)
            self._move(axis, "0", "50")

    def _move(self, axis, goal, speed):
        self._motions[axis] = (self._clock.now_s(), self._at(axis), float(goal), float(speed))

    def _stop(self):
        for axis in self._motions:
            self._move(axis, str(self._at(axis)), "1")


# %%
# The settings of an axis turn its units into micrometres and bound its range. They are what a rig's file holds.


def axis(name: str) -> AxisConfig:
    return AxisConfig(
        controller="table",
        address=name,
        units_per_um=0.001,
        counts_per_um=20.0,
        low_um=-50_000.0,
        high_um=50_000.0,
        speed_um_s=20_000.0,
        acceleration_um_s2=1e6,
        settle_s=0.05,
    )


clock = VirtualClock()
controller = LineController(SimulatedController(clock))
stage = ControllerStage({"table": controller}, {name: axis(name) for name in ("x", "y", "z")}, clock)
print(stage.identities())

# %%
# The first move homes the stage, z first. A goal out of range is refused before anything moves.

stage.move_to(x_um=12_000.0, y_um=-3_000.0)
print(stage.position())
try:
    stage.move_to(x_um=60_000.0)
except RigError as refused:
    print(refused)

# %%
# A scan starts one axis at a constant speed and looks at its position on the way.

stage.start("x", 0.0, 10_000.0)
seen = []
while stage.moving():
    seen.append((clock.now_s(), stage.position().x_um))
    clock.sleep(0.02)
plt.figure(figsize=(6, 3))
plt.plot(*zip(*seen, strict=True), marker=".")
plt.xlabel("time, s")
plt.ylabel("x, µm")
stage.close()

# %%
# To use the class in a rig's file, give it a descriptor, as in ``wafer_viewer/rigs/stages/zaber.py``. Then
# ``wafer-viewer conformance --rig RIG.toml --move`` checks on your stage that it does what a scan needs.
