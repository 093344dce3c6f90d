"""Firmware of the virtual pulse box: WPC/1 byte by byte, pulses at the crossings of the scales."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable

from wafer_viewer.model.acquisition.devices import Pulse
from wafer_viewer.model.acquisition.plan import Axis
from wafer_viewer.rigs.pulse_box.wpc_protocol import (
    ANSWER,
    COMMAND,
    EVENT,
    HALT,
    SEQUENCES,
    VERSION,
    Line,
    LineReader,
    encode,
)
from wafer_viewer.rigs.virtual.clock import Event, VirtualClock
from wafer_viewer.rigs.virtual.stage import VirtualStage

RING_RECORDS = 2048
SETTINGS = {
    "AX": "X", "DIV": "1", "WIDTH_US": "50", "DIR": "1", "START": "0", "STOP": "0", "MAX": "1", "MINGAP_US": "0",
    "SOURCE": "SCALE",
}  # fmt: skip
CHOICES = {"AX": ("X", "Y", "Z"), "DIR": ("1", "-1"), "SOURCE": ("SCALE", "COMMAND")}
AXES: dict[str, Axis] = {"X": "x", "Y": "y", "Z": "z"}


class CommandRefused(Exception):
    """Refusal of a command; the reason is part of the answer."""


class VirtualPulseBox:
    """Pulse box that counts the virtual scales, divides the counts and triggers the camera.

    trigger: sends a trigger and returns whether the camera exposed; suppresses: returns whether the due pulse is held
    back.
    """

    def __init__(
        self,
        clock: VirtualClock,
        stage: VirtualStage,
        trigger: Callable[[float], bool],
        suppresses: Callable[[], bool] = lambda: False,
    ) -> None:
        self._clock = clock
        self._stage = stage
        self._trigger = trigger
        self._suppresses = suppresses
        self._counted_off: dict[Axis, int] = dict.fromkeys(AXES.values(), 0)
        """Count of the box for each axis minus that of its scale."""
        self._send: Callable[[bytes, float], None] = lambda data, time_s: None
        self._boot = 1
        self.executed = 0
        self._power_up()
        stage.on_motion(self._motion_changed)

    def connect(self, send: Callable[[bytes, float], None]) -> None:
        """Set the receiver of events."""
        self._send = send

    def reboot(self) -> None:
        """Simulate a power loss; counts restart from 0 at the current stage position."""
        self._unwatch()
        if self._heart is not None:
            self._heart.cancel()
        self._boot += 1
        at = self._stage.position()
        for axis, um in zip(AXES.values(), (at.x_um, at.y_um, at.z_um), strict=True):
            self._counted_off[axis] = -self._stage.axes[axis].limits.counts(um)
        self._power_up()

    def slip(self, counts: int, *, reported: bool) -> None:
        """Lose counts of the moving axis; if reported, every two of them are one quadrature error."""
        self._counted_off[self._axis] -= self._setting("DIR") * counts
        self._quadrature_errors += math.ceil(counts / 2) if reported else 0

    def see_exposure(self) -> None:
        """Count an exposure that no pulse of the box triggered."""
        self._exposures += 1

    def receive(self, data: bytes, time_s: float) -> bytes:
        """Process bytes that arrive at a time; return the answers to the completed commands."""
        if HALT in data:
            self._disarm()
            data = data.replace(HALT, b"")
        commands = [line for line in self._reader.feed(data) if line.kind == COMMAND]
        return b"".join(self._answer(command, time_s) for command in commands)

    def _power_up(self) -> None:
        self._reader = LineReader()
        self._settings = dict(SETTINGS)
        self._answered: tuple[Line, bytes] | None = None
        self._event_sequence = 0
        self._armed = False
        self._watched: Event | None = None
        self._heart: Event | None = None
        self._heartbeat_s = math.inf
        self._begin_run()

    def _begin_run(self) -> None:
        self._ring: deque[Pulse] = deque(maxlen=RING_RECORDS)
        self._emitted = self._suppressed = self._exposures = self._quadrature_errors = 0
        self._crossed = 0
        self._last_pulse_s = -math.inf

    def _answer(self, command: Line, time_s: float) -> bytes:
        """Execute a command, or repeat the answer if it was executed already."""
        if self._answered is not None and self._answered[0] == command:
            return self._answered[1]
        try:
            values = self._carry_out(command, time_s)
            line = Line(ANSWER, command.sequence, "OK", {"BOOT": str(self._boot), **values})
        except CommandRefused as why:
            line = Line(ANSWER, command.sequence, "NO", {"BOOT": str(self._boot), "WHY": str(why).replace(" ", "_")})
        self._answered = command, encode(line)
        return self._answered[1]

    def _carry_out(self, command: Line, time_s: float) -> dict[str, str]:
        verb = VERBS.get(command.verb)
        if verb is None:
            raise CommandRefused(f"unknown command {command.verb}")
        self.executed += 1
        return verb(self, command.values, time_s)

    def _hello(self, values: dict[str, str], time_s: float) -> dict[str, str]:
        return {"VERSION": VERSION}

    def _configure(self, values: dict[str, str], time_s: float) -> dict[str, str]:
        if self._armed:
            raise CommandRefused("armed")
        for name, value in values.items():
            allowed = CHOICES.get(name)
            if name not in SETTINGS or not (value in allowed if allowed else value.lstrip("-").isdecimal()):
                raise CommandRefused(f"no setting {name} {value}")
        self._settings |= values
        return {}

    def _arm(self, values: dict[str, str], time_s: float) -> dict[str, str]:
        if self._armed:
            raise CommandRefused("armed already")
        self._begin_run()
        self._armed = True
        self._watch(time_s)
        return {"RUN": values.get("RUN", "0")}

    def _disarm_verb(self, values: dict[str, str], time_s: float) -> dict[str, str]:
        self._disarm()
        return self._summary()

    def _get(self, values: dict[str, str], time_s: float) -> dict[str, str]:
        return {"ARMED": str(int(self._armed)), **self._settings, **self._summary()}

    def _dump(self, values: dict[str, str], time_s: float) -> dict[str, str]:
        low, high = int(values.get("FROM", "0")), int(values.get("TO", "-1"))
        records = [p for p in self._ring if low <= p.number <= high]
        if len(records) != high - low + 1:
            raise CommandRefused(f"records {low} to {high} are not in the ring")
        for pulse in records:
            self._report(pulse, time_s)
        return {"COUNT": str(len(records))}

    def _heart_beats(self, values: dict[str, str], time_s: float) -> dict[str, str]:
        self._heartbeat_s = int(values["MS"]) / 1000 if "MS" in values else self._heartbeat_s
        if self._heart is not None:
            self._heart.cancel()
        self._heart = self._clock.at(time_s + self._heartbeat_s, self._heart_stops)
        return {"EMITTED": str(self._emitted), "ARMED": str(int(self._armed))}

    def _fire(self, values: dict[str, str], time_s: float) -> dict[str, str]:
        if not self._armed:
            raise CommandRefused("not armed")
        self._pulse(self._count_at(time_s), time_s)
        return {"EMITTED": str(self._emitted)}

    def _heart_stops(self, time_s: float) -> None:
        if self._armed:
            self._disarm()
            self._event("F", {"WHY": f"no_heartbeat_for_{self._heartbeat_s * 1000:.0f}_ms"}, time_s)

    def _disarm(self) -> None:
        self._armed = False
        self._unwatch()

    def _motion_changed(self, axis: Axis, time_s: float) -> None:
        if self._armed and axis == self._axis:
            self._watch(time_s)

    def _watch(self, time_s: float) -> None:
        """Schedule a pulse at the next crossing of the scale."""
        self._unwatch()
        if self._settings["SOURCE"] != "SCALE" or not self._armed:
            return
        setting, direction = self._setting, self._setting("DIR")
        count = setting("START") + direction * setting("DIV") * self._crossed
        if direction * (setting("STOP") - count) < 0:
            return
        axis, on_scale = self._stage.axes[self._axis], count - self._counted_off[self._axis]
        crossing_s = axis.profile.crossing_s(axis.limits.position_um(on_scale), direction, time_s)
        if crossing_s is not None:
            self._watched = self._clock.at(crossing_s, lambda t: self._cross(count, t))

    def _unwatch(self) -> None:
        if self._watched is not None:
            self._watched.cancel()
            self._watched = None

    def _cross(self, count: int, time_s: float) -> None:
        self._crossed += 1
        if (time_s - self._last_pulse_s) * 1e6 < self._setting("MINGAP_US") or self._suppresses():
            self._suppressed += 1
        else:
            self._pulse(count, time_s)
        self._watch(time_s)

    def _pulse(self, count: int, time_s: float) -> None:
        pulse = Pulse(self._emitted, count, round(time_s * 1e6))
        self._ring.append(pulse)
        self._emitted += 1
        self._last_pulse_s = time_s
        self._exposures += self._trigger(time_s)
        self._report(pulse, time_s)
        if self._emitted >= self._setting("MAX"):
            self._disarm()
            self._event("S", self._summary(), time_s)

    def _report(self, pulse: Pulse, time_s: float) -> None:
        record = {"N": pulse.number, "ENC": pulse.count, "T_US": pulse.time_us, "FLAGS": pulse.flags}
        self._event("P", {name: str(value) for name, value in record.items()}, time_s)

    def _event(self, verb: str, values: dict[str, str], time_s: float) -> None:
        self._event_sequence = (self._event_sequence + 1) % SEQUENCES
        self._send(encode(Line(EVENT, self._event_sequence, verb, values)), time_s)

    def _summary(self) -> dict[str, str]:
        numbers = {
            "EMITTED": self._emitted,
            "SUPPRESSED": self._suppressed,
            "QERR": self._quadrature_errors,
            "EXPOSURES": self._exposures,
        }
        return {name: str(value) for name, value in numbers.items()}

    def _setting(self, name: str) -> int:
        return int(self._settings[name])

    @property
    def _axis(self) -> Axis:
        return AXES[self._settings["AX"]]

    def _count_at(self, time_s: float) -> int:
        axis = self._stage.axes[self._axis]
        return axis.limits.counts(axis.profile.position_at(time_s)) + self._counted_off[self._axis]


Verb = Callable[[VirtualPulseBox, dict[str, str], float], dict[str, str]]
VERBS: dict[str, Verb] = {
    "HELLO": VirtualPulseBox._hello,
    "CFG": VirtualPulseBox._configure,
    "ARM": VirtualPulseBox._arm,
    "DISARM": VirtualPulseBox._disarm_verb,
    "GET": VirtualPulseBox._get,
    "DUMP": VirtualPulseBox._dump,
    "HB": VirtualPulseBox._heart_beats,
    "FIRE": VirtualPulseBox._fire,
}
