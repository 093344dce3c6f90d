"""Coarse look: finds the heights in focus of a few fields, tile by tile, more where they are uncertain.

A place is swept over the whole range of the plan in steps of about the depth of field. The first places are spread over
the fields; then, as long as it saves more time than it takes, those fields are looked at whose prediction is least
certain.

The sharpness of a tile is the mean square of its grey slope along a row, divided by its mean grey. Photon noise grows
as the grey itself, so without texture the sharpness does not depend on z, whatever the light does out of focus. Every
fourth row is read: a frame of 1440 x 1080 px takes a few ms, less than the period of a camera.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.acquire.focus.surface import CELL_COLS, CELL_ROWS, predicted_ranges
from wafer_viewer.acquire.planner import plan_scan
from wafer_viewer.acquire.scan_runner import run_scan
from wafer_viewer.model.acquisition.devices import PulseSummary, Rig
from wafer_viewer.model.acquisition.focus_stack import Frame, Image
from wafer_viewer.model.acquisition.plan import (
    MIN_FRAMES,
    CoarseLook,
    Field,
    FocusCell,
    FocusPlace,
    FocusSweep,
    Leg,
    ScanPlan,
    Shot,
)
from wafer_viewer.model.acquisition.procedure import ProcedureControl, ProcedureStep
from wafer_viewer.model.acquisition.rig_limits import RigLimits
from wafer_viewer.model.errors import MotionStopped, RigError

# ------------------------------------------------------------------------------------------------------- tile sharpness


@dataclass(frozen=True, slots=True)
class SharpnessParameters:
    """Size of a tile, and what counts as focus. Set by tests/bench/bench_follow_focus.py on seeds below 1000.

    Parameters
    ----------
    tile_px : int, px
        Side of a tile.
    tiles_across : int
        Number of tiles across a small frame, whose tiles are smaller.
    least_px : int, px
        Smallest side of a tile; of larger ones as many pixels are read, in rows at equal distances.
    contrast : float
        Sharpness of a tile in focus over that out of focus, its second lowest value over z.
    ignored : float
        Share of the tiles in focus at either end of the heights that is ignored as stray.
    least_tiles : int
        Smallest number of tiles in focus of a field that has a focus.
    """

    tile_px: int = 48
    tiles_across: int = 8
    least_px: int = 24
    contrast: float = 1.8
    ignored: float = 0.02
    least_tiles: int = 4


SHARPNESS = SharpnessParameters()


def sharpness(image: Image, parameters: SharpnessParameters = SHARPNESS) -> Floats:
    """Return the sharpness of the tiles of a frame.

    Parameters
    ----------
    image : uint8 or uint16 [row, col]
        Frame.
    parameters : SharpnessParameters
        Size of a tile.

    Returns
    -------
    float64 [tile row, tile col]
        Mean square slope over mean grey, in counts.
    """
    least, few = parameters.least_px, min(image.shape)
    side = min(parameters.tile_px, max(least, few // parameters.tiles_across), few)
    step = max(1, side**2 // least**2)
    n_rows, n_cols = image.shape[0] // side, image.shape[1] // side
    grey = image[: n_rows * side, : n_cols * side].reshape(n_rows, side, n_cols * side)[:, ::step].astype(np.float32)
    slope = np.zeros_like(grey)
    np.subtract(grey[:, :, 2:], grey[:, :, :-2], out=slope[:, :, 1:-1])
    shape = n_rows, grey.shape[1], n_cols, side
    energy = np.square(slope).reshape(shape).mean((1, 3), dtype=np.float64)
    return energy / (grey.reshape(shape).mean((1, 3), dtype=np.float64) + 1.0)


@dataclass(frozen=True, slots=True, eq=False)
class TilePeaks:
    """Focus of the tiles of a field [tile row, tile col].

    z_um: NaN where a tile has no focus; at_low, at_high: the sharpness is greatest at that end of the frames.
    """

    z_um: Floats
    at_low: NDArray[np.bool_]
    at_high: NDArray[np.bool_]

    @property
    def n_in_focus(self) -> int:
        """Number of tiles in focus."""
        return int(np.count_nonzero(np.isfinite(self.z_um)))


def tile_peaks(
    z_um: Floats, curves: Floats, parameters: SharpnessParameters = SHARPNESS, fall_um: float = np.inf
) -> TilePeaks:
    """Return the z of greatest sharpness of each tile, interpolated between frames.

    Parameters
    ----------
    z_um : float64 [k]
        Heights of the frames, in any order.
    curves : float64 [k, tile row, tile col]
        Their sharpness.
    parameters : SharpnessParameters
        What counts as focus.
    fall_um : float
        Distance from the focus at which the sharpness has fallen, on one side at least, by the contrast of a focus.
        Over a wall, where no surface is, it hardly does.

    Returns
    -------
    TilePeaks
        Focus of each tile. A tile that is sharpest in the first or last frame has the z of that frame.
    """
    order = np.argsort(z_um)
    z_um, levels = z_um[order], np.log(np.maximum(curves[order], 1e-9))
    top = levels.argmax(axis=0)
    highest = np.take_along_axis(levels, top[None], 0)[0]
    floor = np.partition(levels, min(1, len(levels) - 1), axis=0)[min(1, len(levels) - 1)]
    focused = highest - np.maximum(floor, _beside(z_um, levels, top, fall_um)) > np.log(parameters.contrast)
    inner = np.clip(top, 1, max(1, len(z_um) - 2))
    before, at, after = (
        np.take_along_axis(levels, np.clip(inner + i, 0, len(z_um) - 1)[None], 0)[0] for i in (-1, 0, 1)
    )
    bend = np.minimum(before - 2 * at + after, -1e-9)
    shift = np.where(top == inner, np.clip(0.5 * (before - after) / bend, -0.5, 0.5), 0.0)
    found = np.interp(top + shift, np.arange(len(z_um)), z_um)
    last = len(z_um) - 1
    return TilePeaks(np.where(focused, found, np.nan), focused & (top == 0), focused & (top == last))


def _beside(z_um: Floats, levels: Floats, top: NDArray[np.intp], fall_um: float) -> Floats:
    """Return the lower one of the levels fall_um under and over the top of each tile; -inf where both are outside."""
    at = np.full(top.shape, np.inf)
    for side_um in (z_um[top] - fall_um, z_um[top] + fall_um):
        inside = (side_um >= z_um[0]) & (side_um <= z_um[-1])
        k = np.abs(z_um[:, None, None] - np.where(inside, side_um, 0.0)).argmin(0)
        at = np.where(inside, np.minimum(at, np.take_along_axis(levels, k[None], 0)[0]), at)
    return np.where(np.isfinite(at), at, -np.inf)


def touched_ends(peaks: TilePeaks, parameters: SharpnessParameters = SHARPNESS) -> tuple[bool, bool]:
    """Return whether heights in focus reach the lowest and the highest frame, by more tiles than are ignored as stray.

    Without focus, it may lie beyond either end.

    Parameters
    ----------
    peaks : TilePeaks
        Focus of the tiles.
    parameters : SharpnessParameters
        Number of tiles that is ignored.

    Returns
    -------
    tuple of bool
        For the lowest and the highest frame.
    """
    stray = max(parameters.least_tiles - 1, parameters.ignored * peaks.n_in_focus)
    if peaks.n_in_focus < parameters.least_tiles:
        return True, True
    return int(peaks.at_low.sum()) > stray, int(peaks.at_high.sum()) > stray


# ---------------------------------------------------------------------------------------------------------- coarse look


Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class LookParameters:
    """Extent of a coarse look. Set by tests/bench/bench_follow_focus.py on seeds below 1000.

    Parameters
    ----------
    step_depths : float
        Step of its sweeps in depths of field.
    first_places : int
        Largest number of places before anything is known.
    share : float
        Largest share of the fields that is looked at.
    most_places : int
        Largest number of places.
    growth : float
        Places added in a round, as a share of those before.
    saved : float
        Share of the allowance for uncertainty that a further place is expected to save in the fields around it.
    u_depths : float
        Standard uncertainty of a height in focus in depths of field.
    fall_depths : float
        Distance from the focus, in depths of field, within which the sharpness of a tile has to fall.
    least_tiles : int
        Smallest number of tiles in focus of a part of a field.
    """

    step_depths: float = 1.0
    first_places: int = 9
    share: float = 0.4
    most_places: int = 200
    growth: float = 0.25
    saved: float = 0.5
    u_depths: float = 0.15
    fall_depths: float = 3.0
    least_tiles: int = 2


LOOK = LookParameters()


@dataclass(frozen=True, slots=True)
class LookForFocus:
    """Coarse look at some of `fields`; `sweep` is the whole range of the plan, `places` the fields to look at first.

    Without `places` the first fields are spread over all. `known`: an earlier look, whose places stay in the findings.
    """

    fields: tuple[Field, ...]
    sweep: FocusSweep
    exposure_us: float
    places: tuple[int, ...] = ()
    known: CoarseLook | None = None
    parameters: LookParameters = LOOK

    @property
    def title(self) -> str:
        """Title in the list of running work."""
        return "Look for the focus"

    def run(self, rig: Rig, control: ProcedureControl) -> CoarseLook:
        """Carry the look out and leave the rig at rest.

        Raises RigError if a device fails or no place has a focus, MotionStopped if stopped.
        """
        begun_s = rig.clock.now_s()
        wanted = [self.fields[i] for i in self._first()]
        found = list(self.known.places) if self.known is not None else []
        while wanted:
            found += self._look_at(rig, wanted, control, len(found))
            wanted = self._next(found, rig.limits)
        if not any(place.found for place in found):
            raise RigError(
                f"None of the {len(found)} places of the coarse look has a focus within the sweep: check the z range "
                "of the plan, the light and the exposure."
            )
        known_s = self.known.duration_s if self.known is not None else 0.0
        return CoarseLook(places=tuple(found), duration_s=known_s + rig.clock.now_s() - begun_s)

    def _first(self) -> list[int]:
        if self.places:
            return [i for i, field in enumerate(self.fields) if field.number in self.places]
        return spread(_centers(self.fields), first_places(len(self.fields), self.parameters))

    def _look_at(self, rig: Rig, fields: list[Field], control: ProcedureControl, done: int) -> list[FocusPlace]:
        plan = plan_scan(tuple(fields), self.coarse_sweep(rig.limits), (self.exposure_us,), rig.limits, "z_snake")
        fall_um = self.parameters.fall_depths * rig.limits.depth_of_field_um
        watch = _LookWatch(plan, control, done, fall_um)
        if run_scan(plan, rig, watch, watch).stopped:
            raise MotionStopped("The look for the focus was stopped.")
        u_um = self.parameters.u_depths * rig.limits.depth_of_field_um
        return [self._place(field, watch.peaks(field.number), rig.limits, u_um) for field in fields]

    def coarse_sweep(self, limits: RigLimits) -> FocusSweep:
        """Return the sweep of a place: whole counts of the scale, over the range of the plan."""
        step_um = max(self.parameters.step_depths * limits.depth_of_field_um, self.sweep.z_step_um)
        n_frames = max(MIN_FRAMES, 1 + math.floor(self.sweep.range_um / step_um))
        counts = max(1, math.floor(self.sweep.range_um / (n_frames - 1) * limits.z.counts_per_um + 1e-6))
        return FocusSweep(z_step_um=round(limits.z.position_um(counts), 9), n_frames=n_frames)

    def _place(self, field: Field, peaks: TilePeaks, limits: RigLimits, u_um: float) -> FocusPlace:
        cells = cells_of(field, peaks, limits, self.parameters) if peaks.n_in_focus >= SHARPNESS.least_tiles else ()
        return FocusPlace(field=field.number, x_um=field.x_um, y_um=field.y_um, cells=cells, u_um=u_um)

    def _next(self, found: list[FocusPlace], limits: RigLimits) -> list[Field]:
        """Return the fields to look at next; none once that costs more than it saves."""
        most = min(self.parameters.most_places, max(1, int(self.parameters.share * len(self.fields))))
        room = min(most - len(found), max(1, int(self.parameters.growth * len(found))))
        if room <= 0 or self.places or not any(place.found for place in found):
            return []
        frame_s = limits.camera.period_s(self.exposure_us) / self.sweep.z_step_um
        look_s = self._look_s(limits)
        chosen: list[Field] = []
        for field, saved_um in islice(most_uncertain(self.fields, found, self.sweep, limits, self.parameters), room):
            if saved_um * frame_s <= look_s:
                break
            chosen.append(field)
        return chosen

    def _look_s(self, limits: RigLimits) -> float:
        sweep = self.coarse_sweep(limits)
        return plan_scan(self.fields[:1], sweep, (self.exposure_us,), limits, "z_snake").predicted_s


def most_uncertain(
    fields: Sequence[Field],
    found: Sequence[FocusPlace],
    sweep: FocusSweep,
    limits: RigLimits,
    parameters: LookParameters = LOOK,
) -> Iterator[tuple[Field, float]]:
    """Yield the fields that were not looked at, the least certain first, with the length that a look is to save, um.

    The length is that of the allowance of all fields nearer to this one than to another place. A yielded field counts
    as a place for those after it.
    """
    centers = _centers(fields)
    ranges = predicted_ranges(found, centers[:, 0], centers[:, 1], (limits.field_width_um, limits.field_height_um))
    extra_um = np.minimum(2 * (ranges.u_low_um + ranges.u_high_um), sweep.range_um)
    gaps = _nearest(centers, np.array([(place.x_um, place.y_um) for place in found]))
    while gaps.max() > 0:
        place = int(np.argmax(extra_um * (gaps > 0)))
        away = np.hypot(*(centers - centers[place]).T)
        around = away < gaps
        yield fields[place], parameters.saved * float(extra_um[around].sum())
        gaps = np.minimum(gaps, away)
        extra_um = np.where(around, extra_um * (1 - parameters.saved), extra_um)


def more_places(
    fields: Sequence[Field],
    look: CoarseLook,
    sweep: FocusSweep,
    limits: RigLimits,
    parameters: LookParameters = LOOK,
) -> tuple[int, ...]:
    """Return the rising numbers of the fields to look at after a look, where the prediction is least certain.

    As many as a round adds, at least two; none once all were looked at.
    """
    most = max(2, math.ceil(parameters.growth * len(look.places)))
    uncertain = most_uncertain(fields, look.places, sweep, limits, parameters)
    return tuple(sorted(field.number for field, _ in islice(uncertain, most)))


def first_places(n_fields: int, parameters: LookParameters = LOOK) -> int:
    """Return the number of places of a coarse look before anything is known."""
    return min(n_fields, parameters.first_places, max(3, math.ceil(n_fields / 4)))


def spread(at_um: Floats, n_places: int) -> list[int]:
    """Return the indices of positions [n, 2] far from each other: the middle one first, then always the farthest."""
    chosen = [int(np.hypot(*(at_um - (at_um.min(0) + at_um.max(0)) / 2).T).argmin())]
    while len(chosen) < n_places:
        gaps = _nearest(at_um, at_um[chosen])
        if gaps.max() <= 0:
            break
        chosen.append(int(gaps.argmax()))
    return chosen


def cells_of(
    field: Field, peaks: TilePeaks, limits: RigLimits, parameters: LookParameters = LOOK
) -> tuple[FocusCell, ...]:
    """Return the parts of a field with the lowest and highest z in focus of their tiles; stray tiles are ignored."""
    rows, cols = peaks.z_um.shape
    low_um, high_um = _inner_range(peaks.z_um[np.isfinite(peaks.z_um)], SHARPNESS.ignored)
    cells: list[FocusCell] = []
    for some_rows in np.array_split(np.arange(rows), min(rows, CELL_ROWS)):
        for some_cols in np.array_split(np.arange(cols), min(cols, CELL_COLS)):
            z_um = peaks.z_um[np.ix_(some_rows, some_cols)]
            z_um = z_um[np.isfinite(z_um) & (peaks.z_um[np.ix_(some_rows, some_cols)] >= low_um)]
            z_um = z_um[z_um <= high_um]
            if len(z_um) >= min(parameters.least_tiles, len(some_rows) * len(some_cols)):
                x_um = field.x_um + ((some_cols.mean() + 0.5) / cols - 0.5) * limits.field_width_um
                y_um = field.y_um + (0.5 - (some_rows.mean() + 0.5) / rows) * limits.field_height_um
                cells.append(FocusCell(float(x_um), float(y_um), float(z_um.min()), float(z_um.max())))
    return tuple(cells)


def _inner_range(values: Floats, ignored: float) -> tuple[float, float]:
    """Return the range of values without a share at either end."""
    low, high = np.quantile(values, [ignored, 1 - ignored])
    return float(low), float(high)


def _centers(fields: Sequence[Field]) -> Floats:
    return np.array([(field.x_um, field.y_um) for field in fields])


def _nearest(at_um: Floats, places_um: Floats) -> Floats:
    """Return the distance of positions [n, 2] to the nearest place."""
    gaps = np.full(len(at_um), np.inf)
    for place in places_um:
        gaps = np.minimum(gaps, np.hypot(*(at_um - place).T))
    return gaps


class _LookWatch:
    """Sink and control of the scan of a round of places: keeps the sharpness of every frame."""

    def __init__(self, plan: ScanPlan, control: ProcedureControl, done: int, fall_um: float) -> None:
        self._plan, self._control, self._done, self._fall_um = plan, control, done, fall_um
        self._curves: dict[int, dict[int, tuple[float, Floats]]] = {}
        self._n_frames = 0

    def peaks(self, number: int) -> TilePeaks:
        """Return the focus of the tiles of a field. Raises RigError if too few of its frames arrived."""
        frames = self._curves.get(number, {}).values()
        if len(frames) < MIN_FRAMES:
            raise RigError(
                f"The look for the focus got {len(frames)} frames of field {number}: check the trigger of the camera."
            )
        z_um, curves = np.array([z for z, _ in frames]), np.stack([curve for _, curve in frames])
        return tile_peaks(z_um, curves, fall_um=self._fall_um)

    def frame(self, frame: Frame) -> None:
        """Keep the sharpness of a frame."""
        if frame.image is not None:
            self._curves.setdefault(frame.shot.field, {})[frame.shot.k] = frame.z_um, sharpness(frame.image)

    def pass_begun(self, number: int, leg: Leg) -> None:
        """Report the field that is looked at."""
        n_places = self._done + len(self._plan.fields)
        words = f"Looking at field {leg.shots[0].field}, {n_places} places so far"
        self._control.report(ProcedureStep(self._n_frames / self._plan.n_frames, words))

    def missed(self, shot: Shot, pulse_count: int, why: str) -> None:
        """Drop the frame of a slot that is doubtful."""
        self._curves.get(shot.field, {}).pop(shot.k, None)

    def repaired(self, shot: Shot) -> None:
        """Do nothing: the frame was kept when it came."""

    def pass_ended(self, number: int, summary: PulseSummary) -> None:
        """Do nothing: frames are judged once all places are taken."""

    def fault(self, what: str) -> None:
        """Report a fault as a step."""
        self._control.report(ProcedureStep(self._n_frames / self._plan.n_frames, what))

    def should_stop(self) -> bool:
        """Return whether the look has to end."""
        return self._control.should_stop()

    def should_pause(self) -> bool:
        """Return False: a look does not pause."""
        return False

    def wait_while_paused(self) -> None:
        """Do nothing."""

    def progress(self, plan: ScanPlan, frame: Frame) -> None:
        """Count a frame and report it with its image."""
        self._n_frames += 1
        image = None
        self._control.report(ProcedureStep(self._n_frames / plan.n_frames, f"Field {frame.shot.field}", image))
