"""Pulse box client for the scan: WPC/2 over a serial port, without loss of pulse records."""

from __future__ import annotations

from wafer_viewer.model.acquisition.devices import BoxIdentity, Clock, Pulse, PulseSummary, SerialPort
from wafer_viewer.model.acquisition.plan import Axis, PulseTrain
from wafer_viewer.model.errors import PulseBoxDisarmed, PulseBoxRestarted, RigError, RigTimeout, WireError
from wafer_viewer.rigs.pulse_box.wpc_protocol import PATIENCE_S, VERSION, Line, WireClient

PULSE_WIDTH_US = 50
"""Preferred width of a pulse in us; the box may need a longer or a shorter one."""
HEARTBEAT_S = 2.0
"""Longest heartbeat timeout of the box in s."""
BEATS = 10
"""Heartbeats within one timeout."""
BOOT_PATIENCE_S = 3.0
"""Time in s that a box may take to answer after its port was opened or its power returned: common boards reset then."""
DUMP_RECORDS = 32
"""Largest number of records requested at once: their transfer takes no longer than the wait for an answer."""
DUMP_TRIES = 8
"""Requests for lost records in a row that may bring none."""


class PulseBoxClient:
    """Implementation of PulseBox on any device that speaks WPC/2.

    Records are fetched while the box runs, so a pass may have more pulses than the ring of the box. The heartbeat
    timeout is chosen such that the box disarms itself before a record can leave the ring unread.
    """

    def __init__(self, port: SerialPort, clock: Clock) -> None:
        self._wire = WireClient(port, clock)
        self._clock = clock
        self._records: dict[int, Pulse] = {}
        self._given = 0
        self._run = 0
        self._n_pulses = 0
        self._armed = False
        self._heartbeat_s = HEARTBEAT_S
        self._beaten_s = clock.now_s()
        self._boot: int | None = None
        self.identity = self.hello()

    @property
    def retries(self) -> int:
        """Number of repeated commands, for the maintainer's log."""
        return self._wire.retries

    def hello(self) -> BoxIdentity:
        """Ask the box for its name, its capacity and the number of its starts."""
        return _identity(self._hello())

    def referenced(self, axis: Axis) -> bool:
        """Return whether the count of an axis was set since the box started."""
        return bool(self._ask("GET", AX=axis.upper()).number("REF"))

    def reference(self, axis: Axis, count: int) -> None:
        """Set the box's count of an axis at rest. Raises RigError while the box is armed."""
        self._ask("REF", AX=axis.upper(), COUNT=count)

    def reference_by_index(self, axis: Axis, count: int) -> None:
        """Let the box set its count of an axis when the axis next meets its index mark; arming is refused before.

        Raises RigError while the box is armed, and if its firmware knows no index marks.
        """
        if not self.identity.has_index:
            raise RigError(
                f"The pulse box ({self.identity.name}) has no inputs for index marks: update its firmware, or leave "
                "index_um out of the rig's file."
            )
        self._ask("REF", AX=axis.upper(), COUNT=count, MODE="INDEX")

    def latched(self, axis: Axis) -> int | None:
        """Return the count at which the index mark set a new one since the last reference; None if it has not yet."""
        answer = self._ask("GET", AX=axis.upper())
        return answer.number("LATCHED") if "LATCHED" in answer.values else None

    def arm(self, train: PulseTrain, *, min_gap_us: float = 0.0, on_command: bool = False) -> None:
        """Arm the box for one pass; pulses of an earlier run are discarded. Raises RigError on refusal."""
        shortest_us, longest_us = self.identity.width_us
        self._ask(
            "CFG",
            AX=train.axis.upper(),
            DIV=train.counts_per_frame,
            WIDTH_US=min(max(PULSE_WIDTH_US, shortest_us), longest_us),
            DIR=train.direction,
            START=train.first_count,
            STOP=train.last_count,
            MAX=train.n_frames,
            MINGAP_US=int(min_gap_us),
            SOURCE="COMMAND" if on_command else "SCALE",
        )
        # Half a ring may fill within a timeout, the other half until the records of the first are all fetched.
        half_ring_s = self.identity.ring / 2 * min_gap_us * 1e-6
        self._heartbeat_s = min(HEARTBEAT_S, half_ring_s or HEARTBEAT_S)
        self._beat()
        self._n_pulses = train.n_frames
        self._run += 1
        self._ask("ARM", RUN=self._run)
        self._wire.events()
        self._records, self._given, self._armed = {}, 0, True

    def count(self, axis: Axis) -> int:
        """Return the box's current count of an axis."""
        return self._ask("GET", AX=axis.upper()).number("COUNT")

    def fire(self) -> None:
        """Send one pulse of the armed run now."""
        self._ask("FIRE")

    def pulses(self) -> list[Pulse]:
        """Return the pulses sent since the last call, in order; also sends the heartbeat.

        Records lost on the wire are requested again. Raises RigError when the box disarmed itself.
        """
        self._take_events()
        if self._armed and self._clock.now_s() - self._beaten_s >= self._heartbeat_s / BEATS:
            self._fetch(self._beat(self._n_pulses))
        self._fetch(max(self._records, default=-1) + 1)
        fresh: list[Pulse] = []
        while (pulse := self._records.pop(self._given, None)) is not None:
            fresh.append(pulse)
            self._given += 1
        return fresh

    def disarm(self) -> PulseSummary:
        """End the run; `pulses` still returns records not fetched yet."""
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

    def _hello(self) -> Line:
        answer = self._checked("HELLO", self._wire.ask("HELLO", patience_s=BOOT_PATIENCE_S))
        if answer.values.get("VERSION") != VERSION:
            raise RigError(f"The pulse box speaks {answer.values.get('VERSION')}, not {VERSION}: update its firmware.")
        return answer

    def _beat(self, n_pulses: int = 0) -> int:
        """Send the heartbeat; return the number of pulses sent by the box.

        Raises RigError if the box is not armed any more before it sent `n_pulses`: its report was lost on the wire.
        """
        answer = self._ask("HB", MS=round(self._heartbeat_s * 1000))
        self._beaten_s, emitted = self._clock.now_s(), answer.number("EMITTED")
        if emitted < n_pulses and not answer.number("ARMED"):
            self._armed = False
            raise RigError(
                "The pulse box disarmed itself before its last pulse: check its cable and continue the scan."
            )
        return emitted

    def _ask(self, verb: str, **values: int | str) -> Line:
        """Send a command and return its answer; a box that is silent may have restarted, which HELLO finds out."""
        try:
            answer = self._wire.ask(verb, patience_s=PATIENCE_S, **values)
        except RigTimeout:
            self._hello()
            raise
        return self._checked(verb, answer)

    def _checked(self, verb: str, answer: Line) -> Line:
        """Return an answer. Raises PulseBoxRestarted or, if the box refused the command, RigError.

        A refusal by a box that disarmed itself before is raised as that.
        """
        boot, before = answer.number("BOOT"), self._boot
        self._boot = boot
        if before not in (None, boot):
            self._armed = False
            raise PulseBoxRestarted(f"The pulse box restarted (boot {boot}, before {before}): check its power.")
        if answer.verb != "OK":
            if self._armed:
                self._take_events()
            raise RigError(f"The pulse box refused {verb}: {_why(answer)}.")
        return answer

    def _take_events(self) -> None:
        for event in self._wire.events():
            if event.verb == "P":
                pulse = Pulse(event.number("N"), event.number("ENC"), event.number("T_US"))
                if pulse.number >= self._given:
                    self._records[pulse.number] = pulse
            elif event.verb == "F":
                self._armed = False
                raise PulseBoxDisarmed(
                    f"The pulse box disarmed itself: {_why(event)}; continue the scan when that is fixed."
                )

    def _fetch(self, emitted: int) -> None:
        """Request the records that were lost on the wire."""
        n_lost, tries = emitted, 0
        while lost := [n for n in range(self._given, emitted) if n not in self._records]:
            tries = 0 if len(lost) < n_lost else tries + 1
            if tries > DUMP_TRIES:
                raise WireError(
                    f"The pulse box's records up to {emitted} did not come in {DUMP_TRIES} tries: check its cable."
                )
            n_lost = len(lost)
            self._ask("DUMP", FROM=lost[0], TO=min(lost[-1], lost[0] + DUMP_RECORDS - 1))
            self._take_events()


def _identity(hello: Line) -> BoxIdentity:
    return BoxIdentity(
        name=hello.values.get("NAME", "").replace("_", " "),
        ring=hello.number("RING"),
        count_rate_hz=hello.number("RATE"),
        width_us=(hello.number("WIDTH_MIN"), hello.number("WIDTH_MAX")),
        has_index=hello.values.get("INDEX") == "1",
        boot=hello.number("BOOT"),
    )


def _why(line: Line) -> str:
    return line.values.get("WHY", "no reason given").replace("_", " ")
