"""Firmware of the virtual pulse box: WPC/2 byte by byte, pulses at the crossings of the scales."""

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

NAME = "virtual_pulse_box"
RING_RECORDS = 512
COUNT_RATE_HZ = 10_000_000
WIDTHS_US = (1, 10_000)
BOOT_S = 1.5
"""Time in s without answers after a restart, as of common boards."""
HEARTBEAT_S = 2.0
"""Heartbeat timeout in s until one is given."""
SETTINGS = {
    "AX": "", "DIV": "1", "WIDTH_US": "50", "DIR": "1", "START": "0", "STOP": "0", "MAX": "1", "MINGAP_US": "0",
    "SOURCE": "SCALE",
}  # fmt: skip
INT32 = (-(2**31), 2**31 - 1)
RANGES = {
    "DIV": (1, INT32[1]), "WIDTH_US": WIDTHS_US, "START": INT32, "STOP": INT32, "MAX": (1, INT32[1]),
    "MINGAP_US": (0, 60_000_000), "COUNT": INT32, "MS": (1, 60_000), "FROM": (0, INT32[1]), "TO": (0, INT32[1]),
}  # fmt: skip
CHOICES = {"AX": ("X", "Y", "Z"), "MODE": ("SET", "INDEX"), "DIR": ("1", "-1"), "SOURCE": ("SCALE", "COMMAND")}
AXES: dict[str, Axis] = {"X": "x", "Y": "y", "Z": "z"}


class CommandRefused(Exception):
    """Refusal of a command; the reason is part of the answer."""


class VirtualPulseBox:
    """Pulse box that counts the virtual scales, divides the counts and triggers the camera.

    As in a real one, counts and time start at 0 at power-up, wherever the stage stands.

    trigger: sends a trigger and returns whether the camera exposed; suppresses: returns whether the due pulse is held
    back; ignores_heartbeat: true for one that stays armed without a heartbeat.
    """

    ignores_heartbeat = False

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
        self._send: Callable[[bytes, float], None] = lambda data, time_s: None
        self._boot = 1
        self._ready_s = -math.inf
        """Time from which commands are answered."""
        self.executed = 0
        self._power_up()
        stage.on_motion(self._motion_changed)

    def connect(self, send: Callable[[bytes, float], None]) -> None:
        """Set the receiver of events."""
        self._send = send

    def reboot(self) -> None:
        """Simulate a power loss."""
        self._unwatch()
        for axis in AXES.values():
            self._forget_index(axis)
        if self._heart is not None:
            self._heart.cancel()
        self._boot += 1
        self._ready_s = self._clock.now_s() + BOOT_S
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
        if time_s < self._ready_s:
            return b""
        if HALT in data:
            self._disarm()
            data = data.replace(HALT, b"")
        commands = [line for line in self._reader.feed(data) if line.kind == COMMAND]
        return b"".join(self._answer(command, time_s) for command in commands)

    def _power_up(self) -> None:
        self._powered_s = self._clock.now_s()
        self._counted_off = {axis: -self._on_scale(axis, self._powered_s) for axis in AXES.values()}
        """Count of the box for each axis minus that of its scale."""
        self._referenced: set[Axis] = set()
        self._index_counts: dict[Axis, int] = {}
        """Count that an axis gets when it meets its index mark."""
        self._marks: dict[Axis, Event] = {}
        self._latched: dict[Axis, int] = {}
        self._reader = LineReader()
        self._settings = dict(SETTINGS)
        self._answered: tuple[Line, bytes] | None = None
        self._event_sequence = 0
        self._armed = False
        self._watched: Event | None = None
        self._heart: Event | None = None
        self._heartbeat_s = HEARTBEAT_S
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
            verb, values = "OK", self._carry_out(command, time_s)
        except CommandRefused as why:
            verb, values = "NO", {"WHY": str(why).replace(" ", "_")}
        axis = command.values.get("AX", self._settings["AX"])
        values = {"BOOT": str(self._boot), **self._where(axis, time_s), **values}
        self._answered = command, encode(Line(ANSWER, command.sequence, verb, values))
        return self._answered[1]

    def _where(self, name: str, time_s: float) -> dict[str, str]:
        """Return count and reference of an axis, for every answer."""
        if name not in AXES:
            return {}
        axis = AXES[name]
        return {"AX": name, "COUNT": str(self._count_at(axis, time_s)), "REF": str(int(axis in self._referenced))}

    def _carry_out(self, command: Line, time_s: float) -> dict[str, str]:
        verb = VERBS.get(command.verb)
        if verb is None:
            raise CommandRefused(f"unknown command {command.verb}")
        self.executed += 1
        return verb(self, command.values, time_s)

    def _hello(self, values: dict[str, str], time_s: float) -> dict[str, str]:
        low_us, high_us = map(str, WIDTHS_US)
        ring, rate = str(RING_RECORDS), str(COUNT_RATE_HZ)
        return {
            "VERSION": VERSION, "NAME": NAME, "RING": ring, "RATE": rate, "WIDTH_MIN": low_us, "WIDTH_MAX": high_us,
            "INDEX": "1",
        }  # fmt: skip

    def _reference(self, values: dict[str, str], time_s: float) -> dict[str, str]:
        self._refuse_if_armed()
        if values.get("AX") not in AXES:
            raise CommandRefused("no axis")
        axis, count, mode = AXES[values["AX"]], _integer(values, "COUNT"), values.get("MODE", "SET")
        if mode not in CHOICES["MODE"]:
            raise CommandRefused(f"no mode {mode}")
        self._forget_index(axis)
        if mode == "INDEX":
            self._referenced.discard(axis)
            self._index_counts[axis] = count
            self._watch_index(axis, time_s)
        else:
            self._set_count(axis, count, time_s)
        return {}

    def _set_count(self, axis: Axis, count: int, time_s: float) -> None:
        self._counted_off[axis] = count - self._on_scale(axis, time_s)
        self._referenced.add(axis)

    def _forget_index(self, axis: Axis) -> None:
        self._latched.pop(axis, None)
        self._index_counts.pop(axis, None)
        if axis in self._marks:
            self._marks.pop(axis).cancel()

    def _watch_index(self, axis: Axis, time_s: float) -> None:
        """Schedule the crossing of an awaited index mark."""
        if axis in self._marks:
            self._marks.pop(axis).cancel()
        one = self._stage.axes[axis]
        if one.index_um is None:
            return
        crossing_s = one.profile.crossing_s(one.index_um, one.profile.direction, time_s)
        if crossing_s is not None:
            self._marks[axis] = self._clock.at(crossing_s, lambda t: self._meet_index(axis, t))

    def _meet_index(self, axis: Axis, time_s: float) -> None:
        latched, count = self._count_at(axis, time_s), self._index_counts[axis]
        self._forget_index(axis)
        self._latched[axis] = latched
        self._set_count(axis, count, time_s)

    def _configure(self, values: dict[str, str], time_s: float) -> dict[str, str]:
        self._refuse_if_armed()
        for name, value in values.items():
            if name not in SETTINGS or value not in CHOICES.get(name, (value,)):
                raise CommandRefused(f"no setting {name} {value}")
            if name in RANGES:
                _integer(values, name)
        self._settings |= values
        return {}

    def _arm(self, values: dict[str, str], time_s: float) -> dict[str, str]:
        self._refuse_if_armed()
        if self._settings["AX"] not in AXES:
            raise CommandRefused("no axis configured")
        if self._axis not in self._referenced:
            raise CommandRefused(f"{self._axis} axis not referenced since the box started")
        self._begin_run()
        self._armed = True
        self._watch_heart(time_s)
        self._watch(time_s)
        return {"RUN": values.get("RUN", "0")}

    def _disarm_verb(self, values: dict[str, str], time_s: float) -> dict[str, str]:
        self._disarm()
        return self._summary()

    def _get(self, values: dict[str, str], time_s: float) -> dict[str, str]:
        axis = AXES.get(values.get("AX", self._settings["AX"]))
        latched = {} if axis not in self._latched else {"LATCHED": str(self._latched[axis])}
        return {"ARMED": str(int(self._armed)), **self._summary(), **latched}

    def _dump(self, values: dict[str, str], time_s: float) -> dict[str, str]:
        low, high = _integer(values, "FROM"), _integer(values, "TO")
        records = [p for p in self._ring if low <= p.number <= high]
        if not records or len(records) != high - low + 1:
            raise CommandRefused(f"records {low} to {high} are not in the ring")
        for pulse in records:
            self._report(pulse, time_s)
        return {"RECORDS": str(len(records))}

    def _heart_beats(self, values: dict[str, str], time_s: float) -> dict[str, str]:
        self._heartbeat_s = _integer(values, "MS") / 1000 if "MS" in values else self._heartbeat_s
        self._watch_heart(time_s)
        return {"EMITTED": str(self._emitted), "ARMED": str(int(self._armed))}

    def _fire(self, values: dict[str, str], time_s: float) -> dict[str, str]:
        if not self._armed:
            raise CommandRefused("not armed")
        if self._settings["SOURCE"] != "COMMAND":
            raise CommandRefused("armed for the scale")
        if (time_s - self._last_pulse_s) * 1e6 < self._setting("WIDTH_US"):
            raise CommandRefused("pulse not over")
        self._pulse(self._count_at(self._axis, time_s), time_s)
        return {"EMITTED": str(self._emitted)}

    def _watch_heart(self, time_s: float) -> None:
        if self._heart is not None:
            self._heart.cancel()
        self._heart = self._clock.at(time_s + self._heartbeat_s, self._heart_stops)

    def _heart_stops(self, time_s: float) -> None:
        if self._armed and not self.ignores_heartbeat:
            self._disarm()
            self._event("F", {"WHY": f"no_heartbeat_for_{self._heartbeat_s * 1000:.0f}_ms"}, time_s)

    def _refuse_if_armed(self) -> None:
        if self._armed:
            raise CommandRefused("armed")

    def _disarm(self) -> None:
        self._armed = False
        self._unwatch()

    def _motion_changed(self, axis: Axis, time_s: float) -> None:
        if self._armed and axis == self._axis:
            self._watch(time_s)
        if axis in self._index_counts:
            self._watch_index(axis, time_s)

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
        gap_us = max(self._setting("MINGAP_US"), 2 * self._setting("WIDTH_US"))
        if (time_s - self._last_pulse_s) * 1e6 < gap_us or self._suppresses():
            self._suppressed += 1
        else:
            self._pulse(count, time_s)
        self._watch(time_s)

    def _pulse(self, count: int, time_s: float) -> None:
        pulse = Pulse(self._emitted, count, round((time_s - self._powered_s) * 1e6))
        self._ring.append(pulse)
        self._emitted += 1
        self._last_pulse_s = time_s
        self._exposures += self._trigger(time_s)
        self._report(pulse, time_s)
        if self._emitted >= self._setting("MAX"):
            self._disarm()

    def _report(self, pulse: Pulse, time_s: float) -> None:
        record = {"N": pulse.number, "ENC": pulse.count, "T_US": pulse.time_us}
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

    def _count_at(self, axis: Axis, time_s: float) -> int:
        return self._on_scale(axis, time_s) + self._counted_off[axis]

    def _on_scale(self, axis: Axis, time_s: float) -> int:
        virtual = self._stage.axes[axis]
        return virtual.limits.counts(virtual.profile.position_at(time_s))


def _integer(values: dict[str, str], name: str) -> int:
    """Return a value in its range. Raises CommandRefused."""
    value, (least, most) = values.get(name, ""), RANGES[name]
    if not value.removeprefix("-").isdecimal() or not least <= int(value) <= most:
        raise CommandRefused(f"no number {name} between {least} and {most}")
    return int(value)


Verb = Callable[[VirtualPulseBox, dict[str, str], float], dict[str, str]]
VERBS: dict[str, Verb] = {
    "HELLO": VirtualPulseBox._hello,
    "REF": VirtualPulseBox._reference,
    "CFG": VirtualPulseBox._configure,
    "ARM": VirtualPulseBox._arm,
    "DISARM": VirtualPulseBox._disarm_verb,
    "GET": VirtualPulseBox._get,
    "DUMP": VirtualPulseBox._dump,
    "HB": VirtualPulseBox._heart_beats,
    "FIRE": VirtualPulseBox._fire,
}
