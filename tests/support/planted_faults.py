"""Faults planted at random into scans on the hybrid rig, and whether each of them was found."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from unittest.mock import patch

import numpy as np

from tests.acquire.ledger import Ledger
from tests.support.hybrid_rig import MachineCodeBox
from wafer_viewer.acquire import scan_runner
from wafer_viewer.acquire.pass_runner import PassResult
from wafer_viewer.model.acquisition.devices import Position
from wafer_viewer.model.acquisition.plan import ScanPlan
from wafer_viewer.model.errors import RigError
from wafer_viewer.rigs.virtual.rig import VirtualRig

KINDS = (
    "slip of 1 or 2 counts",
    "slip of 3 to 60 counts",
    "loose contact of a scale",
    "restart of the box",
    "lost trigger edge",
    "extra trigger edge",
    "extra exposure",
    "serial lines lost or damaged",
)
SHARES = (0.1, 0.1, 0.1, 0.04, 0.2, 0.13, 0.13, 0.2)
EXPOSING_US = 16_800.0
"""So long after a pulse the camera is ready again, and the next pulse is not yet due."""


@dataclass
class Attempt:
    """A pass: the faults planted in it, and its outcome."""

    n_frames: int
    pulses: int = 0
    planted: list[str] = field(default_factory=list)
    result: PassResult | None = None
    error: str = ""
    wire_repairs: int = 0

    def doubted(self) -> bool:
        return self.result is None or bool(self.result.doubts)

    def found(self, kind: str) -> bool:
        """Whether the fault is named: by a doubt of its whole pass, or by what the pass tells of its frames."""
        if self.doubted():
            return True
        pairing = self.result.pairing
        if kind.startswith("slip"):
            return self.result.slip != 0
        if kind == "lost trigger edge":
            return len(pairing.holes) >= self.planted.count(kind)
        if kind.startswith("extra"):
            return pairing.extra_edges + pairing.strays > 0
        return kind.startswith("serial") and self.wire_repairs > 0


class Planter:
    """Plants faults on a hybrid rig while its stage moves, from `apart` pulses after the one before."""

    def __init__(self, rig: VirtualRig, n_faults: int, apart: tuple[int, int], seed: int) -> None:
        self.rig, self.box, self.apart = rig, rig._firmware, apart
        assert isinstance(self.box, MachineCodeBox)
        self.rng = np.random.default_rng(seed)
        self.kinds = list(self.rng.choice(KINDS, n_faults, p=SHARES))
        self.attempts: list[Attempt] = []
        self.at = int(self.rng.integers(*apart))
        self.box.on_pulse = self.on_pulse
        self.wire = Wire(rig, self.rng)

    def on_pulse(self, number: int, time_s: float) -> None:
        if not self.attempts or not self.rig.stage.moving():
            return
        attempt = self.attempts[-1]
        attempt.pulses += 1
        if self.kinds and number >= self.at and attempt.pulses < attempt.n_frames - 2:
            kind = self.kinds.pop()
            self.plant(kind, number, time_s)
            attempt.planted.append(kind)
            self.at = number + int(self.rng.integers(*self.apart))

    def plant(self, kind: str, number: int, time_s: float) -> None:
        draw = self.rng.integers
        if kind.startswith("slip"):
            low, high = (1, 3) if "1 or 2" in kind else (3, 61)
            self.box.slip(int(draw(low, high)), reported=False)
        elif kind.startswith("loose"):
            self.box.loosen(int(draw(2, 61)))
        elif kind.startswith("restart"):
            self.rig.clock.at(time_s, lambda _: self.box.reboot())
        elif kind.startswith("lost"):
            self.box.lost_pulses.add(number)
        elif kind.startswith("extra"):
            after_us = EXPOSING_US if "exposure" in kind else self.rng.uniform(200.0, 16_000.0)
            self.rig.clock.at(time_s + after_us * 1e-6, self.rig._disturbed)
        else:
            self.wire.to_disturb += int(draw(1, 4))

    def run_pass(self, *arguments) -> PassResult:
        """In place of run_pass, which it records."""
        attempt = Attempt(arguments[1].train.n_frames)
        self.attempts.append(attempt)
        repairs = self.wire.repairs()
        try:
            attempt.result = real_run_pass(*arguments)
        except RigError as fault:
            attempt.error = str(fault)
            raise
        finally:
            attempt.wire_repairs = self.wire.repairs() - repairs
        return attempt.result


class Wire:
    """The serial line of a rig: loses or damages the next lines, and counts what was asked for again."""

    def __init__(self, rig: VirtualRig, rng: np.random.Generator) -> None:
        self.rig, self.rng = rig, rng
        self.to_disturb = self.dumps = 0
        rig._port._disturbed = self.disturbed

    def disturbed(self, data: bytes) -> bytes:
        self.dumps += b" DUMP " in data
        return b"".join(map(self.fate, data.splitlines(keepends=True)))

    def fate(self, line: bytes) -> bytes:
        if not self.to_disturb:
            return line
        self.to_disturb -= 1
        at = int(self.rng.integers(2 * len(line)))
        if at >= len(line):
            return b""
        return line[:at] + bytes([line[at] ^ (1 << int(self.rng.integers(8)))]) + line[at + 1 :]

    def repairs(self) -> int:
        return self.rig.box.retries + self.dumps


real_run_pass = scan_runner.run_pass


@dataclass
class FaultRecord:
    """Outcome of a scan with planted faults.

    wrong_slots: frames in a wrong slot; off: frames whose true z is half a count or more from their label; refused:
    sentences with which scans ended, to be continued.
    """

    ledger: Ledger
    attempts: list[Attempt]
    refused: list[str]
    wrong_slots: int
    off: int

    def counts(self, of: Callable[[Attempt, str], bool]) -> Counter[str]:
        return Counter(kind for one in self.attempts for kind in one.planted if of(one, kind))

    def table(self) -> list[tuple[str, int, int, int, int, int]]:
        """Kind, planted, found, repaired within the pass, pass taken again, scan ended to be continued."""
        planted, found = self.counts(lambda *_: True), self.counts(Attempt.found)
        again = self.counts(lambda one, _: one.doubted() and not one.error)
        refused = self.counts(lambda one, _: bool(one.error))
        mended = self.counts(lambda one, kind: one.found(kind) and not one.doubted())
        return [(k, planted[k], found[k], mended[k], again[k], refused[k]) for k in KINDS]


def scan_with_faults(
    rig: VirtualRig, plan: ScanPlan, control, place, n_faults: int, apart: tuple[int, int] = (20, 90), seed: int = 0
) -> FaultRecord:
    """Scan with planted faults, continuing as an operator would, until every slot has its frame."""
    planter, ledger, refused = Planter(rig, n_faults, apart, seed), Ledger(), []
    with patch.object(scan_runner, "run_pass", planter.run_pass):
        while len(ledger.kept) < plan.n_frames and len(refused) < 50:
            try:
                scan_runner.run_scan(plan, rig, ledger, control(), skip=set(ledger.kept))
            except RigError as fault:
                refused.append(str(fault))
    errors = [z_error_counts(rig, place, frame) for frame in ledger.kept.values()]
    wrong = [
        abs(frame.z_um - plan.sweep.z_um(plan.field(shot.field), shot.k)) > plan.sweep.z_step_um / 2
        or error > plan.sweep.z_step_um * rig.limits.z.counts_per_um / 2
        for (shot, frame), error in zip(ledger.kept.items(), errors, strict=True)
    ]
    return FaultRecord(ledger, planter.attempts, refused, sum(wrong), sum(error >= 0.5 for error in errors))


def z_error_counts(rig: VirtualRig, place, frame) -> float:
    """Difference between the labelled and the true scale position of a frame, in counts of the scale."""
    label = Position(frame.x_um, frame.y_um, frame.z_um)
    return abs(place(frame.image)[0][2] - rig.stage.truth_of(label).z_um) * rig.limits.z.counts_per_um
