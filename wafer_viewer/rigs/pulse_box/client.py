"""Pulse box client for the scan: WPC/1 over a serial port, without loss of pulse records."""

from __future__ import annotations

from wafer_viewer.model.acquisition.devices import Clock, Pulse, PulseSummary, SerialPort
from wafer_viewer.model.acquisition.plan import Axis, PulseTrain
from wafer_viewer.model.errors import RigError, WireError
from wafer_viewer.rigs.pulse_box.wpc_protocol import VERSION, Line, WireClient

PULSE_WIDTH_US = 50
MIN_GAP_US = 1000
"""Least time between pulses in us; the box suppresses nearer ones, as no camera here reaches 1 kHz."""
HEARTBEAT_S = 2.0
"""Heartbeat timeout of the box in s."""
BEAT_S = HEARTBEAT_S / 10
DUMP_TRIES = 8


class PulseBoxClient:
    """Implementation of PulseBox on any device that speaks WPC/1."""

    def __init__(self, port: SerialPort, clock: Clock) -> None:
        self._wire = WireClient(port, clock)
        self._clock = clock
        self._records: dict[int, Pulse] = {}
        self._given = 0
        self._run = 0
        self._armed = False
        self._axis: Axis = "z"
        self._zero: dict[Axis, int] = {"x": 0, "y": 0, "z": 0}
        """Count of the box at count 0 of each axis."""
        self._beaten_s = clock.now_s()
        self._boot: int | None = None
        self._boot = self._hello()

    @property
    def retries(self) -> int:
        """Number of repeated commands, for the maintainer's log."""
        return self._wire.retries

    def arm(self, train: PulseTrain, *, on_command: bool = False) -> None:
        """Arm the box for one pass; pulses of an earlier run are discarded. Raises RigError on refusal."""
        self._axis, zero = train.axis, self._zero[train.axis]
        self._ask(
            "CFG",
            AX=train.axis.upper(),
            DIV=train.counts_per_frame,
            WIDTH_US=PULSE_WIDTH_US,
            DIR=train.direction,
            START=train.first_count + zero,
            STOP=train.last_count + zero,
            MAX=train.n_frames,
            MINGAP_US=MIN_GAP_US,
            SOURCE="COMMAND" if on_command else "SCALE",
        )
        self._beat()
        self._run += 1
        self._ask("ARM", RUN=self._run)
        self._wire.events()
        self._records, self._given, self._armed = {}, 0, True

    def count(self, axis: Axis) -> int:
        """Return the box's current count of an axis, from a pulse on command; no camera may be waiting."""
        self.arm(PulseTrain(axis=axis, first_count=0, counts_per_frame=1, n_frames=1, direction=1), on_command=True)
        self.fire()
        self.disarm()
        (pulse,) = self.pulses()
        return pulse.count

    def correct_count(self, axis: Axis, off: int) -> None:
        """Subtract excess counts of the box on an axis from now on, to correct a slip."""
        self._zero[axis] += off

    def fire(self) -> None:
        """Send one pulse of the armed run now."""
        self._ask("FIRE")

    def pulses(self) -> list[Pulse]:
        """Return the pulses sent since the last call, in order; also sends the heartbeat.

        Records lost on the wire are requested again. Raises RigError when the box disarmed itself or restarted.
        """
        self._take_events()
        if self._armed and self._clock.now_s() - self._beaten_s >= BEAT_S:
            self._fetch(self._beat())
        self._fetch(max(self._records, default=-1) + 1)
        fresh: list[Pulse] = []
        while (pulse := self._records.get(self._given)) is not None:
            fresh.append(pulse)
            self._given += 1
        return fresh

    def disarm(self) -> PulseSummary:
        """End the run; `pulses` still returns records not fetched yet. Raises RigError if the box restarted."""
        self._armed = False
        answer = self._ask("DISARM")
        summary = PulseSummary(
            emitted=answer.number("EMITTED"),
            suppressed=answer.number("SUPPRESSED"),
            quadrature_errors=answer.number("QERR"),
            exposures=answer.number("EXPOSURES"),
        )
        self._take_events()
        self._fetch(summary.emitted)
        return summary

    def halt(self) -> None:
        """Stop pulses at once."""
        self._armed = False
        self._wire.halt()

    def close(self) -> None:
        """Close the port."""
        self._wire.close()

    def _hello(self) -> int:
        answer = self._ask("HELLO")
        if answer.values.get("VERSION") != VERSION:
            raise RigError(f"The pulse box speaks {answer.values.get('VERSION')}, not {VERSION}: update its firmware.")
        return answer.number("BOOT")

    def _beat(self) -> int:
        """Send the heartbeat; return the number of pulses sent by the box."""
        answer = self._ask("HB", MS=round(HEARTBEAT_S * 1000))
        self._beaten_s = self._clock.now_s()
        return answer.number("EMITTED")

    def _ask(self, verb: str, **values: int | str) -> Line:
        answer = self._wire.ask(verb, **values)
        boot = answer.number("BOOT")
        if self._boot is not None and boot != self._boot:
            was, self._boot, self._armed = self._boot, boot, False
            raise RigError(
                f"The pulse box restarted during a pass (boot {boot}, before {was}): this pass is lost; "
                "check its power and continue the scan."
            )
        if answer.verb != "OK":
            raise RigError(f"The pulse box refused {verb}: {_why(answer)}.")
        return answer

    def _take_events(self) -> None:
        for event in self._wire.events():
            if event.verb == "P":
                pulse = _pulse(event, self._zero[self._axis])
                self._records[pulse.number] = pulse
            elif event.verb == "F":
                self._armed = False
                raise RigError(f"The pulse box disarmed itself: {_why(event)}; continue the scan when that is fixed.")

    def _fetch(self, emitted: int) -> None:
        """Request the records that were lost on the wire."""
        for _ in range(DUMP_TRIES):
            lost = [n for n in range(self._given, emitted) if n not in self._records]
            if not lost:
                return
            self._ask("DUMP", FROM=lost[0], TO=lost[-1])
            self._take_events()
        raise WireError(f"The pulse box's records up to {emitted} did not come in {DUMP_TRIES} tries: check its cable.")


def _why(line: Line) -> str:
    return line.values.get("WHY", "no reason given").replace("_", " ")


def _pulse(event: Line, zero: int) -> Pulse:
    return Pulse(event.number("N"), event.number("ENC") - zero, event.number("T_US"), event.number("FLAGS"))
