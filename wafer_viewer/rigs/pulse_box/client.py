"""The pulse box as the scan sees it: WPC/1 spoken over a serial port, with no pulse record lost on the way."""

from __future__ import annotations

from wafer_viewer.model.acquisition.devices import Clock, Pulse, PulseSummary, SerialPort
from wafer_viewer.model.acquisition.plan import Axis, PulseTrain
from wafer_viewer.model.errors import RigError, WireError
from wafer_viewer.rigs.pulse_box.wpc_protocol import VERSION, Line, WireClient

PULSE_WIDTH_US = 50
MIN_GAP_US = 1000
"""Pulses nearer than this are suppressed by the box: no camera here follows a kilohertz."""
HEARTBEAT_S = 2.0
"""How long the box goes on without hearing from us."""
BEAT_S = HEARTBEAT_S / 10
DUMP_TRIES = 8


class PulseBoxClient:
    """Fulfils the role PulseBox on anything that speaks WPC/1."""

    def __init__(self, port: SerialPort, clock: Clock) -> None:
        self._wire = WireClient(port, clock)
        self._clock = clock
        self._records: dict[int, Pulse] = {}
        self._given = 0
        self._run = 0
        self._armed = False
        self._axis: Axis = "z"
        self._zero: dict[Axis, int] = {"x": 0, "y": 0, "z": 0}
        """What the box counts where each axis is at count 0."""
        self._beaten_s = clock.now_s()
        self._boot: int | None = None
        self._boot = self._hello()

    @property
    def retries(self) -> int:
        """How many commands had to be sent again, for the maintainer's log."""
        return self._wire.retries

    def arm(self, train: PulseTrain, *, on_command: bool = False) -> None:
        """Be ready for one pass; pulses of an earlier run are forgotten. Raises RigError on refusal."""
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
        """The count of an axis now, as the box has it: that of a pulse on command, for which no camera may wait."""
        self.arm(PulseTrain(axis=axis, first_count=0, counts_per_frame=1, n_frames=1, direction=1), on_command=True)
        self.fire()
        self.disarm()
        (pulse,) = self.pulses()
        return pulse.count

    def correct_count(self, axis: Axis, off: int) -> None:
        """Leave out, from here on, the counts that the box has too many on an axis: the way to mend a slip."""
        self._zero[axis] += off

    def fire(self) -> None:
        """Send one pulse of the armed run now."""
        self._ask("FIRE")

    def pulses(self) -> list[Pulse]:
        """The pulses sent since the last call, in order; beats the heart of the box as well.

        Records lost on the wire are asked for again. Raises RigError when the box disarmed itself or was started anew.
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
        """End the run; `pulses` still gives what was not fetched. Raises RigError when the box was started anew."""
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
        """Let the port go."""
        self._wire.close()

    def _hello(self) -> int:
        answer = self._ask("HELLO")
        if answer.values.get("VERSION") != VERSION:
            raise RigError(f"The pulse box speaks {answer.values.get('VERSION')}, not {VERSION}: update its firmware.")
        return answer.number("BOOT")

    def _beat(self) -> int:
        """Tell the box that we live; returns how many pulses it has sent."""
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
        """Ask again for the records that got lost on the wire."""
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
