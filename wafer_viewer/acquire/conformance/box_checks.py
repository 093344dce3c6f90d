"""Checks of the pulse box: identity, refusals, counts at rest, pulses on command, and pulses of a moving scale."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

from wafer_viewer.acquire.conformance.bench import (
    N_PULSES,
    PULSE_PERIOD_S,
    CheckOutcome,
    CheckRun,
    ConformanceBench,
    ConformanceCheck,
    DeviceRole,
    TravelWindow,
    figure,
    outcome,
)
from wafer_viewer.acquire.pass_runner import COUNT_TOLERANCE
from wafer_viewer.model.acquisition.devices import Pulse, PulseSummary
from wafer_viewer.model.acquisition.plan import AXES, Axis, PulseTrain
from wafer_viewer.model.errors import PulseBoxRestarted, RigError, RigTimeout

N_HELLO = 5
"""Greetings of the box."""
N_FIRED = 20
"""Pulses on command."""
REST_S, LOOKS = 1.0, 10
"""Time at rest in s over which counts are watched, and number of looks."""
DEAF_US = 100.0
"""Least gap between pulses in us for which the box's timeout is short: the time in which half of its ring fills."""
SILENCE_S = 2.5
"""Time without heartbeat in s: longer than the longest timeout, 2 s."""
SLOW_FRACTION = 0.1
"""Speed of slow passes as a fraction of the fastest."""
SUPPRESSED_GAP = 1.5
"""Least gap in periods of the pulses, so that every second one comes too soon."""
N_CROSSED = 16
"""Pulses of the train that is crossed back and forth."""


def identity(bench: ConformanceBench) -> CheckOutcome:
    """Greet the box several times."""
    said = [bench.rig.box.hello() for _ in range(N_HELLO)]
    first = said[0]
    figures = (
        figure("records", first.ring, "1"),
        figure("count rate", first.count_rate_hz, "counts/s"),
        figure("shortest pulse", first.width_us[0], "us"),
        figure("boot number", first.boot, "1"),
    )
    boots = sorted({one.boot for one in said})
    return outcome(
        figures,
        f"The boot number changed between {boots[0]} and {boots[-1]} while nobody switched it." if boots[1:] else "",
        "The box has no room for a record." if first.ring < 1 else "",
        "The box says that it follows no count rate." if first.count_rate_hz < 1 else "",
    )


def refuses_without_reference(bench: ConformanceBench) -> CheckOutcome:
    """Try to arm the box for every axis that was not referenced since its start."""
    box = bench.rig.box
    lost: list[Axis] = [axis for axis in AXES if not box.referenced(axis)]
    if not lost:
        return CheckOutcome(
            skipped="Every axis was referenced since the box started: switch the box off and on, and run it again."
        )
    armed: list[str] = []
    for axis in lost:
        train = PulseTrain(axis=axis, first_count=0, counts_per_frame=1, n_frames=1, direction=1)
        if not _refused(lambda train=train: box.arm(train, on_command=True)):
            armed.append(axis)
            box.disarm()
    return outcome(
        (figure("axes tried", len(lost), "1"),),
        f"The box was armed for the {' and '.join(armed)} axis, which was not referenced since it started: its counts "
        "mean nothing there."
        if armed
        else "",
    )


def counts_at_rest(bench: ConformanceBench) -> CheckOutcome:
    """Set the counts and watch them while the stage stands."""
    rig, worst = bench.rig, dict[Axis, int]()
    bench.reference()
    set_to = {axis: rig.limits.axis(axis).counts(bench.position_um(axis)) for axis in AXES}
    for _ in range(LOOKS):
        bench.require_running()
        rig.clock.sleep(REST_S / LOOKS)
        for axis in AXES:
            worst[axis] = max(worst.get(axis, 0), abs(rig.box.count(axis) - set_to[axis]))
    off = [axis for axis in AXES if worst[axis] > COUNT_TOLERANCE]
    lost = [axis for axis in AXES if not rig.box.referenced(axis)]
    return outcome(
        (figure(f"{axis} off by", worst[axis], "counts") for axis in AXES),
        f"The count of the {' and '.join(off)} axis moves while the stage stands, by {max(worst.values())} counts: "
        "check its scale and its cable for noise."
        if off
        else "",
        f"The box does not report the {' and '.join(lost)} axis as referenced after REF." if lost else "",
    )


def fires_once(bench: ConformanceBench) -> CheckOutcome:
    """Give pulses on command, and one too many."""
    box = bench.rig.box
    bench.arm_on_command("z", N_FIRED)
    count, pulses = box.count("z"), list[Pulse]()
    for _ in range(N_FIRED):
        box.fire()
        pulses += box.pulses()
    refused = _refused(box.fire)
    summary = box.disarm()
    pulses += box.pulses()
    off = max((abs(pulse.count - count) for pulse in pulses), default=0)
    return outcome(
        (figure("FIRE commands", N_FIRED, "1"), figure("pulses", summary.emitted, "1")),
        _numbered(pulses, summary, N_FIRED),
        f"A pulse has a count {off} counts from that of the axis at rest." if off > COUNT_TOLERANCE else "",
        "" if refused else "FIRE was carried out after the last pulse of the run, when the box is not armed.",
    )


def refuses_while_armed(bench: ConformanceBench) -> CheckOutcome:
    """Try to reference and to arm a box that is armed."""
    box = bench.rig.box
    bench.arm_on_command("z", N_FIRED)
    count = box.count("z")
    referenced = not _refused(lambda: box.reference("z", count))
    rearmed = not _refused(lambda: bench.arm_on_command("z", N_FIRED))
    box.disarm()
    return outcome(
        (figure("commands to refuse", 2, "1"),),
        "The armed box accepted REF: a count could be set in the middle of a pass." if referenced else "",
        "The armed box accepted another run." if rearmed else "",
    )


def heartbeat(bench: ConformanceBench) -> CheckOutcome:
    """Arm the box and fall silent."""
    rig = bench.rig
    bench.arm_on_command("z", N_FIRED, min_gap_us=DEAF_US)
    rig.clock.sleep(SILENCE_S)
    try:
        rig.box.pulses()
        told = ""
    except (RigTimeout, PulseBoxRestarted):
        raise
    except RigError as fault:
        told = str(fault)
    fired = not _refused(rig.box.fire)
    rig.box.halt()
    return outcome(
        (figure("silence", SILENCE_S, "s"),),
        f"The box ignored the heartbeat: it was still armed after {SILENCE_S:g} s without one and carried out FIRE, so "
        "that pulses go on when this computer dies."
        if fired
        else "",
        "" if told or fired else "The box disarmed itself without a report.",
    )


def pulses_at(fraction: float, bench: ConformanceBench) -> CheckOutcome:
    """Run passes in both directions on every axis at a fraction of its fastest speed."""
    figures, faults = [], list[str]()
    for axis, window in bench.windows.items():
        speed, worst_us = fraction * window.speed_um_s, 0.0
        for direction in (1, -1):
            train = train_in(window, speed, direction)
            pulses, summary = run_train(bench, window, train, speed)
            found = faults_of(pulses, summary, train)
            faults += [f"{axis} axis, {'up' if direction > 0 else 'down'}, at {speed:.0f} um/s: {found}"] * bool(found)
            worst_us = max(worst_us, _unevenness_us(pulses, window, train, speed))
        figures += [
            figure(f"{axis} speed", speed, "um/s"),
            figure(f"{axis} pulses, each way", N_PULSES, "1"),
            figure(f"{axis} interval off by", worst_us, "us"),
        ]
    return outcome(figures, *faults)


def slow_pulses(bench: ConformanceBench) -> CheckOutcome:
    """Run slow passes."""
    return pulses_at(SLOW_FRACTION, bench)


def fast_pulses(bench: ConformanceBench) -> CheckOutcome:
    """Run passes at the fastest speed."""
    return pulses_at(1.0, bench)


def up_and_down(bench: ConformanceBench) -> CheckOutcome:
    """Take the same counts up and down, then cross a train back and forth before it is complete."""
    window = bench.windows["z"]
    speed = SLOW_FRACTION * window.speed_um_s
    up = train_in(window, speed, 1, N_CROSSED)
    down = PulseTrain(
        axis="z", first_count=up.last_count, counts_per_frame=up.counts_per_frame, n_frames=N_CROSSED, direction=-1
    )
    pairs = [run_train(bench, window, train, speed) for train in (up, down)]
    faults = [faults_of(pulses, summary, train) for (pulses, summary), train in zip(pairs, (up, down), strict=True)]
    crossed, summary = _crossed(bench, window, up, speed)
    return outcome(
        (
            figure("pulses up", len(pairs[0][0]), "1"),
            figure("pulses down", len(pairs[1][0]), "1"),
            figure("pulses, crossed three times", len(crossed), "1"),
        ),
        *faults,
        _repeated(crossed) or faults_of(crossed, summary, up),
    )


def least_gap(bench: ConformanceBench) -> CheckOutcome:
    """Ask for a gap between pulses that only every second one keeps."""
    window = bench.windows["z"]
    speed = SLOW_FRACTION * window.speed_um_s
    train = train_in(window, speed, 1)
    period_us = window.limits.position_um(train.counts_per_frame) / speed * 1e6
    pulses, summary = run_train(bench, window, train, speed, min_gap_us=SUPPRESSED_GAP * period_us)
    total = summary.emitted + summary.suppressed
    near = [b.time_us - a.time_us for a, b in pairwise(pulses) if b.time_us - a.time_us < SUPPRESSED_GAP * period_us]
    return outcome(
        (
            figure("least gap", SUPPRESSED_GAP * period_us, "us"),
            figure("emitted", summary.emitted, "1"),
            figure("suppressed", summary.suppressed, "1"),
        ),
        f"{summary.emitted} pulses and {summary.suppressed} suppressed ones are not the {N_PULSES} of the train."
        if total != N_PULSES
        else "",
        "No pulse was suppressed, although every second one came too soon." if summary.suppressed == 0 else "",
        f"{len(near)} pulses came sooner than the least gap, the soonest after {min(near)} us." if near else "",
    )


def train_in(window: TravelWindow, speed_um_s: float, direction: int, n: int = N_PULSES) -> PulseTrain:
    """Return a train in the middle of a range, with a pulse every PULSE_PERIOD_S at a speed."""
    limits = window.limits
    pitch = max(1, limits.counts(speed_um_s * PULSE_PERIOD_S))
    half_um = limits.position_um(pitch * (n - 1)) / 2
    first_um = window.at_um(0.5) - direction * half_um
    return PulseTrain(
        axis=window.axis,
        first_count=limits.counts(first_um),
        counts_per_frame=pitch,
        n_frames=n,
        direction=1 if direction > 0 else -1,
    )


def run_train(
    bench: ConformanceBench,
    window: TravelWindow,
    train: PulseTrain,
    speed_um_s: float,
    *,
    min_gap_us: float = 0.0,
) -> tuple[list[Pulse], PulseSummary]:
    """Move over a train from one end of its range to the other; return its pulses and the summary of the box."""
    up = train.direction > 0
    bench.go(window.axis, window.low_um if up else window.high_um)
    bench.reference()
    bench.rig.box.arm(train, min_gap_us=min_gap_us)
    pulses = bench.sweep(window.axis, window.high_um if up else window.low_um, speed_um_s)
    summary = bench.rig.box.disarm()
    return pulses + bench.rig.box.pulses(), summary


def faults_of(pulses: list[Pulse], summary: PulseSummary, train: PulseTrain) -> str:
    """Return the faults of the pulses of a pass as sentences; empty without any."""
    wanted = [train.first_count + train.direction * train.counts_per_frame * i for i in range(train.n_frames)]
    off = [(pulse.count, count) for pulse, count in zip(pulses, wanted, strict=False) if pulse.count != count]
    parts = (
        _numbered(pulses, summary, train.n_frames),
        f"a pulse came at count {off[0][0]} instead of {off[0][1]}, {len(off)} in all." if off else "",
        f"{summary.suppressed} pulses were suppressed." if summary.suppressed else "",
        f"the box reports {summary.quadrature_errors} quadrature errors." if summary.quadrature_errors else "",
    )
    return " ".join(part for part in parts if part)


def _numbered(pulses: list[Pulse], summary: PulseSummary, n: int) -> str:
    if summary.emitted != n:
        return f"{summary.emitted} pulses came instead of {n}."
    if [pulse.number for pulse in pulses] != list(range(n)):
        return f"{len(pulses)} records came for {n} pulses, or not in their order."
    return ""


def _crossed(
    bench: ConformanceBench, window: TravelWindow, train: PulseTrain, speed_um_s: float
) -> tuple[list[Pulse], PulseSummary]:
    """Cross half of a train, return to its beginning and cross all of it."""
    bench.go("z", window.low_um)
    bench.reference()
    bench.rig.box.arm(train)
    pulses: list[Pulse] = []
    for to_um in (window.at_um(0.5), window.low_um, window.high_um):
        pulses += bench.sweep("z", to_um, speed_um_s)
    summary = bench.rig.box.disarm()
    return pulses + bench.rig.box.pulses(), summary


def _repeated(pulses: list[Pulse]) -> str:
    counts = [pulse.count for pulse in pulses]
    again = sorted({count for count in counts if counts.count(count) > 1})
    return f"The count {again[0]} gave a pulse each time that it was crossed." if again else ""


def _unevenness_us(pulses: list[Pulse], window: TravelWindow, train: PulseTrain, speed_um_s: float) -> float:
    """Return the largest difference of an interval from the one that the speed gives."""
    wanted_us = window.limits.position_um(train.counts_per_frame) / speed_um_s * 1e6
    return max((abs(b.time_us - a.time_us - wanted_us) for a, b in pairwise(pulses)), default=0.0)


def _refused(command: Callable[[], object]) -> bool:
    """Carry out a command; return whether the box refused it. A box that is silent or restarts raises RigError."""
    try:
        command()
    except (RigTimeout, PulseBoxRestarted):
        raise
    except RigError:
        return True
    return False


ALONE: tuple[DeviceRole, ...] = ("pulse box",)
WITH_STAGE: tuple[DeviceRole, ...] = ("pulse box", "stage")


def _at_rest(
    name: str, title: str, demand: str, run: CheckRun, roles: tuple[DeviceRole, ...] = ALONE
) -> ConformanceCheck:
    return ConformanceCheck(name, title, "pulse box", roles, moves=False, demand=demand, run=run)


def _in_motion(name: str, title: str, demand: str, run: CheckRun) -> ConformanceCheck:
    return ConformanceCheck(name, title, "pulse box", WITH_STAGE, moves=True, demand=demand, run=run)


CHECKS = (
    _at_rest(
        "box_refuses_without_reference",
        "No run without reference",
        "ARM is refused for every axis whose count was not set since the box started.",
        refuses_without_reference,
    ),
    _at_rest(
        "box_identity",
        "Identity",
        f"HELLO is answered {N_HELLO} times with protocol WPC/2, name, capacity and the same boot number.",
        identity,
    ),
    _at_rest(
        "box_counts_at_rest",
        "Counts at rest",
        f"While the stage stands, each axis keeps the count it was set to for {REST_S:g} s, within {COUNT_TOLERANCE} "
        "counts.",
        counts_at_rest,
        WITH_STAGE,
    ),
    _at_rest(
        "box_fires_once",
        "Pulses on command",
        f"{N_FIRED} FIRE give {N_FIRED} pulses, each once, in order, at the count of the axis; one more is refused.",
        fires_once,
    ),
    _at_rest(
        "box_refuses_while_armed",
        "Refusals of an armed box",
        "An armed box refuses REF and a second run.",
        refuses_while_armed,
    ),
    _at_rest(
        "box_heartbeat",
        "Heartbeat",
        f"An armed box without heartbeat for {SILENCE_S:g} s has disarmed itself, says so, and refuses FIRE.",
        heartbeat,
    ),
    _in_motion(
        "box_pulses_slow",
        "Pulses of a slow pass",
        f"A pass of {N_PULSES} pulses at a tenth of the fastest speed gives each of them once, in order, at its exact "
        "count. This holds on every axis and in both directions, without quadrature errors.",
        slow_pulses,
    ),
    _in_motion(
        "box_pulses_fast",
        "Pulses of a fast pass",
        f"The same for {N_PULSES} pulses at the fastest speed that limits, count rate and range allow.",
        fast_pulses,
    ),
    _in_motion(
        "box_up_and_down",
        "Pairs of passes up and down",
        f"{N_CROSSED} counts give a pulse each on the way up and on the way down. A train that is crossed back and "
        "forth gives each pulse once.",
        up_and_down,
    ),
    _in_motion(
        "box_least_gap",
        "Suppressed pulses",
        "Pulses that come sooner than the least gap are suppressed and counted. With a gap of 1.5 periods, emitted and "
        "suppressed ones add up to the train.",
        least_gap,
    ),
)
"""Demands on the pulse box."""
