"""The firmware in the place of the virtual pulse box: its core counts the virtual stage and triggers the camera."""

from __future__ import annotations

import ctypes
import math

from wafer_viewer.rigs.virtual.pulse_box_firmware import BOOT_S, HEARTBEAT_S

AXES = ("x", "y", "z")
Trigger = ctypes.CFUNCTYPE(None)
Send = ctypes.CFUNCTYPE(None, ctypes.c_uint8, ctypes.POINTER(ctypes.c_char), ctypes.c_uint16)


class FirmwareBox:
    """Fulfils the part of VirtualPulseBox with the library made of the firmware's core."""

    def __init__(self, library, clock, stage, trigger, suppresses):
        self.core = ctypes.CDLL(str(library))
        self.core.library_next.restype = ctypes.c_bool
        self.core.library_move.argtypes = [ctypes.c_uint8, ctypes.c_long, ctypes.c_long]
        self.clock, self.stage, self.on_trigger = clock, stage, trigger
        self.send = lambda data, time_s: None
        self.out, self.now_s, self.ready_s, self.boot = b"", 0.0, -math.inf, 0
        self.watched, self.moved, self.direction, self.slips = None, 2, 1, []
        self.callbacks = Trigger(self.trigger), Send(self.collect)
        self.core.library_connect(*self.callbacks)
        self.power_up()
        stage.on_motion(lambda axis, time_s: self.follow(time_s))

    def connect(self, send):
        self.send = send

    def power_up(self):
        self.boot += 1
        self.powered_s = self.clock.now_s()
        self.lost = dict.fromkeys(AXES, 0)
        """Counts of each scale that the core did not see."""
        self.at = {axis: self.stage.axes[axis].limits.counts(self.um(axis, self.powered_s)) for axis in AXES}
        self.core.library_start(self.boot, (ctypes.c_long * 3)(*self.at.values()))

    def reboot(self):
        self.ready_s = self.clock.now_s() + BOOT_S
        self.power_up()

    def slip(self, counts, *, reported):
        self.slips.append((counts, reported))

    def carry_out_slips(self):
        """Lose counts: pairs of edges at once, which the core reports, or edges that it never sees."""
        axis = AXES[self.moved]
        for counts, reported in self.slips:
            if reported:
                self.shift(self.moved, self.at[axis] + 2 * math.ceil(counts / 2) * self.direction, stride=2)
            else:
                self.lost[axis] += counts * self.direction
        self.slips.clear()

    def see_exposure(self):
        self.core.box_exposure()

    def receive(self, data, time_s):
        if time_s < self.ready_s:
            return b""
        self.go_to(time_s)
        for byte in data:
            self.core.box_receive(0, byte)
        self.carry_out_slips()
        self.core.library_report()
        answers, self.out = self.out, b""
        self.watch(time_s)
        self.clock.at(time_s + HEARTBEAT_S + 0.01, self.follow)
        return answers

    def follow(self, time_s):
        """Bring the core to a time and send what it reports."""
        self.go_to(time_s)
        self.deliver(time_s)
        self.watch(time_s)

    def deliver(self, time_s):
        self.core.library_report()
        if self.out:
            self.send(self.out, time_s)
            self.out = b""

    def go_to(self, time_s):
        """Bring time and scales to a time; an axis in motion shows the last count that it passed."""
        self.now_s = time_s
        self.core.library_time(round((time_s - self.powered_s) * 1e6) & 0xFFFFFFFF)
        for number, axis in enumerate(AXES):
            one = self.stage.axes[axis]
            counts = self.um(axis, time_s) * one.limits.counts_per_um
            if not one.moving(time_s):
                to = one.limits.counts(self.um(axis, time_s))
            elif one.profile.direction > 0:
                to = max(self.at[axis], math.floor(counts + 1e-6))
            else:
                to = min(self.at[axis], math.ceil(counts - 1e-6))
            self.shift(number, to)

    def shift(self, number, to, stride=1):
        axis = AXES[number]
        self.at[axis] = to
        self.core.library_move(number, to - self.lost[axis], stride)

    def watch(self, time_s):
        """Schedule the next pulse at the crossing of its count."""
        if self.watched is not None:
            self.watched.cancel()
        number, direction, at = ctypes.c_uint8(), ctypes.c_int8(), ctypes.c_long()
        if not self.core.library_next(ctypes.byref(number), ctypes.byref(direction), ctypes.byref(at)):
            return
        self.moved, self.direction = number.value, direction.value
        axis = self.stage.axes[AXES[number.value]]
        to = at.value + self.lost[AXES[number.value]]
        crossing_s = axis.profile.crossing_s(axis.limits.position_um(to), direction.value, time_s)
        if crossing_s is not None:
            self.watched = self.clock.at(crossing_s, lambda t: self.cross(number.value, to, t))

    def cross(self, number, to, time_s):
        self.now_s = time_s
        self.core.library_time(round((time_s - self.powered_s) * 1e6) & 0xFFFFFFFF)
        self.shift(number, to)
        self.carry_out_slips()
        self.deliver(time_s)
        self.watch(time_s)

    def trigger(self):
        if self.on_trigger(self.now_s):
            self.core.box_exposure()

    def collect(self, link, data, length):
        self.out += data[:length]

    def um(self, axis, time_s):
        return self.stage.axes[axis].profile.position_at(time_s)
