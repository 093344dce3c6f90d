"""Division of a scan into passes: the continuous motions of each strategy, in order.

A pass is a lightweight form of a leg, sufficient to price it and to create the leg of the chosen strategy.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Literal

from wafer_viewer.model.acquisition.plan import AXES, Axis, Field, FocusSweep, Leg, PulseTrain, Shot
from wafer_viewer.model.acquisition.rig_limits import RigLimits

SMEAR_PX = 0.5
"""Largest motion of a line pass during an exposure, in pixels."""
AXIAL_SMEAR = 0.1
"""Largest motion of a z pass during an exposure, as a fraction of its step."""
PERIOD_SPARE = 1.02
"""Pulse period over the camera's shortest period, because no axis runs quite uniformly."""

Line = Literal["x", "y"]
Point = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Task:
    """Fields, sweep and exposures to scan, and the rig's limits; the z step is a whole number of scale counts."""

    fields: tuple[Field, ...]
    sweep: FocusSweep
    exposures_us: tuple[float, ...]
    limits: RigLimits

    def lit_s(self, exposure: int) -> float:
        """Return the time that light falls on the sensor: the exposure, or the strobe flash if shorter."""
        strobe_us = self.limits.strobe_us or self.exposures_us[exposure]
        return min(strobe_us, self.exposures_us[exposure]) * 1e-6

    def period_s(self, exposure: int) -> float:
        """Return the shortest pulse period that the camera can follow."""
        return self.limits.camera.period_s(self.exposures_us[exposure]) * PERIOD_SPARE


@dataclass(frozen=True, slots=True)
class Pass:
    """One continuous motion along `axis`: the frames ks of every field, in that order. Speed 0 is stop and shoot.

    start_um: position (x, y, z) of the first pulse; exposures: taken in turn on consecutive pulses.
    """

    axis: Axis
    direction: Literal[-1, 1]
    start_um: Point
    pitch_counts: int
    speed_um_s: float
    fields: tuple[Field, ...]
    ks: Sequence[int]
    exposures: Sequence[int]

    @property
    def n_frames(self) -> int:
        """Number of pulses."""
        return len(self.fields) * len(self.ks) * len(self.exposures)

    def end_um(self, limits: RigLimits) -> Point:
        """Return the position of the last pulse."""
        length_um = limits.axis(self.axis).position_um(self.pitch_counts * (self.n_frames - 1))
        return _along(self.start_um, self.axis, self.direction * length_um)

    def leg(self, limits: RigLimits) -> Leg:
        """Return the leg for execution by a rig."""
        x_um, y_um, z_um = self.start_um
        train = PulseTrain(
            axis=self.axis,
            first_count=limits.axis(self.axis).counts(self.start_um[AXES.index(self.axis)]),
            counts_per_frame=self.pitch_counts,
            n_frames=self.n_frames,
            direction=self.direction,
        )
        shots = tuple(Shot(f.number, k, e) for f in self.fields for k in self.ks for e in self.exposures)
        return Leg(train=train, shots=shots, x_um=x_um, y_um=y_um, z_um=z_um, speed_um_s=self.speed_um_s)


def z_passes(task: Task, *, snake: bool) -> Iterable[Pass]:
    """Yield one z pass per field and exposure, fields in a snake; upward, or alternately up and down."""
    up = True
    for field in snake_order(task.fields):
        for exposure in range(len(task.exposures_us)):
            yield _z_pass(task, field, (exposure,), _axial_speed_um_s(task, (exposure,)), up=up)
            up = up != snake


def alternating_passes(task: Task) -> Iterable[Pass]:
    """Yield one z pass per field with the exposures in turn, alternately up and down; fields in a snake."""
    exposures = range(len(task.exposures_us))
    speed_um_s = _axial_speed_um_s(task, exposures)
    for i, field in enumerate(snake_order(task.fields)):
        yield _z_pass(task, field, exposures, speed_um_s, up=i % 2 == 0)


def alternation_obstacle(task: Task) -> str | None:
    """Return the reason why exposures cannot be taken in turn, or None."""
    n, counts = len(task.exposures_us), task.limits.z.counts(task.sweep.z_step_um)
    if not task.limits.camera.exposure_sequence:
        return "the camera cannot change its exposure from frame to frame."
    if counts % n:
        nearest = sorted({n * max(1, counts // n + more) for more in (0, 1)})
        steps = " or ".join(f"{task.limits.z.position_um(near):g} um" for near in nearest)
        return (
            f"the z step of {task.sweep.z_step_um:g} um is {counts} counts of the z scale, no multiple of the {n} "
            f"exposures: choose {steps}."
        )
    return None


def shoot_passes(task: Task) -> Iterable[Pass]:
    """Yield one upward stop-and-shoot pass per field and exposure."""
    for field in snake_order(task.fields):
        for exposure in range(len(task.exposures_us)):
            yield _z_pass(task, field, (exposure,), speed_um_s=0.0, up=True)


def line_passes(task: Task, line: Line) -> Iterable[Pass]:
    """Yield one pass per z, line of fields and exposure, in alternating directions; lines and levels in a snake."""
    lines = lines_of(task.fields, line)
    forward = True
    for k in range(task.sweep.n_frames):
        for fields in lines if k % 2 == 0 else lines[::-1]:
            for exposure in range(len(task.exposures_us)):
                yield _line_pass(task, fields, line, k, exposure, forward=forward)
                forward = not forward


def snake_order(fields: Iterable[Field]) -> list[Field]:
    """Return the fields row by row, every second row reversed."""
    order: list[Field] = []
    for i, row in enumerate(lines_of(fields, "x")):
        order += row if i % 2 == 0 else row[::-1]
    return order


def lines_of(fields: Iterable[Field], line: Line) -> list[list[Field]]:
    """Return the rows (line x) or columns (line y) of fields, each by rising coordinate."""
    across, along = ("row", "col") if line == "x" else ("col", "row")
    ordered = sorted(fields, key=lambda f: (getattr(f, across), getattr(f, along)))
    lines = [list(group) for _, group in groupby(ordered, key=lambda f: getattr(f, across))]
    return [sorted(fields, key=lambda f: getattr(f, f"{line}_um")) for fields in lines]


def line_obstacle(task: Task, line: Line) -> str | None:
    """Return the reason why line passes are impossible, or None."""
    if any(field.n_frames is not None for field in task.fields):
        return "fields with a z window of their own are not taken one z at a time."
    for fields in lines_of(task.fields, line):
        wrong = _uneven_pitch(task, fields, line) or _uneven_line(task, fields, line)
        if wrong is not None:
            return wrong
    return None


def _z_pass(task: Task, field: Field, exposures: Sequence[int], speed_um_s: float, *, up: bool) -> Pass:
    """Return a pass in which every exposure has the z step; a slot has the same z upward and downward."""
    z, frames = task.limits.z, range(task.sweep.frames_of(field))
    pitch_counts = z.counts(task.sweep.z_step_um) // len(exposures)
    lowest_um = z.position_um(z.counts(field.z_start_um))
    range_um = task.sweep.z_step_um * (len(frames) - 1)
    top_um = lowest_um + range_um + z.position_um(pitch_counts * (len(exposures) - 1))
    start_um = lowest_um if up else top_um
    return Pass(
        axis="z",
        direction=1 if up else -1,
        start_um=(field.x_um, field.y_um, start_um),
        pitch_counts=pitch_counts,
        speed_um_s=speed_um_s,
        fields=(field,),
        ks=frames if up else frames[::-1],
        exposures=exposures if up else exposures[::-1],
    )


def _line_pass(task: Task, fields: list[Field], line: Line, k: int, exposure: int, *, forward: bool) -> Pass:
    axis, pitch_counts = task.limits.axis(line), _pitch_counts(task, fields, line)
    first, length_um = fields[0], axis.position_um(pitch_counts * (len(fields) - 1))
    start = (first.x_um, first.y_um, task.sweep.z_um(first, k))
    return Pass(
        axis=line,
        direction=1 if forward else -1,
        start_um=start if forward else _along(start, line, length_um),
        pitch_counts=pitch_counts,
        speed_um_s=_lateral_speed_um_s(task, line, pitch_counts, exposure),
        fields=tuple(fields if forward else fields[::-1]),
        ks=(k,),
        exposures=(exposure,),
    )


def _axial_speed_um_s(task: Task, exposures: Sequence[int]) -> float:
    by_camera = task.sweep.z_step_um / len(exposures) / max(map(task.period_s, exposures))
    by_smear = AXIAL_SMEAR * task.sweep.z_step_um / max(map(task.lit_s, exposures))
    return min(by_camera, by_smear, task.limits.pass_speed_um_s("z"))


def _lateral_speed_um_s(task: Task, line: Line, pitch_counts: int, exposure: int) -> float:
    axis = task.limits.axis(line)
    by_camera = axis.position_um(pitch_counts) / task.period_s(exposure)
    by_smear = SMEAR_PX * task.limits.pixel_um / task.lit_s(exposure)
    return min(by_camera, by_smear, task.limits.pass_speed_um_s(line))


def _pitch_counts(task: Task, fields: list[Field], line: Line) -> int:
    if len(fields) == 1:
        return 1
    length_um = getattr(fields[-1], f"{line}_um") - getattr(fields[0], f"{line}_um")
    return max(1, task.limits.axis(line).counts(length_um / (len(fields) - 1)))


def _uneven_pitch(task: Task, fields: list[Field], line: Line) -> str | None:
    pitch_um, limit_um = task.limits.axis(line).position_um(_pitch_counts(task, fields, line)), task.limits.pixel_um
    start_um = getattr(fields[0], f"{line}_um")
    for i, field in enumerate(fields):
        off_um = getattr(field, f"{line}_um") - start_um - i * pitch_um
        if abs(off_um) > limit_um:
            return (
                f"field {field.number} would be taken {off_um:.2f} um off its place by a line pass of one pitch, "
                f"{pitch_um:g} um, and it may be off by a pixel, {limit_um:g} um."
            )
    return None


def _uneven_line(task: Task, fields: list[Field], line: Line) -> str | None:
    across, first = "y" if line == "x" else "x", fields[0]
    limits_um = {f"{across}_um": task.limits.pixel_um, "z_start_um": 1 / task.limits.z.counts_per_um}
    for name, limit_um in limits_um.items():
        for field in fields[1:]:
            off_um = getattr(field, name) - getattr(first, name)
            if abs(off_um) > limit_um:
                return (
                    f"field {field.number} is {off_um:.2f} um off field {first.number} in {name.removesuffix('_um')}, "
                    f"and the fields of a line pass may differ by {limit_um:g} um."
                )
    return None


def _along(point: Point, axis: Axis, by_um: float) -> Point:
    x, y, z = (p + by_um * (a == axis) for p, a in zip(point, AXES, strict=True))
    return x, y, z
