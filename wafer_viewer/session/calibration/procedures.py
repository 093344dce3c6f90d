"""Calibration procedures on the rig; each ends in a result that is applied only when somebody accepts it."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.acquire.commanded_frames import TakeFrame, frames_at_places
from wafer_viewer.calibrate.image_geometry import LEAST_STEPS, Estimate, PixelScale, StageLine, pixel_scale
from wafer_viewer.calibrate.trigger_delay import FocusSweepCurve, SweepPair, curve_shift_um, delay_error, sharpness
from wafer_viewer.model.acquisition.calibration import PIXEL_STEP_FRACTION, Calibration
from wafer_viewer.model.acquisition.characteristics import CalibrationResult, Characteristic
from wafer_viewer.model.acquisition.devices import Rig
from wafer_viewer.model.acquisition.focus_stack import FieldStack, Image
from wafer_viewer.model.acquisition.plan import Axis, Field
from wafer_viewer.model.acquisition.procedure import ProcedureControl, ProcedureStep
from wafer_viewer.model.errors import RigError
from wafer_viewer.session.calibration.frames import (
    CalibrationSite,
    FocusedSite,
    Sweep,
    focus_at,
    focused_site,
    take_sweep,
)

ISO_600, ISO_700 = "ISO 25178-600:2019", "ISO 25178-700:2022"
FOCUS_SHARE = 0.1
"""Fraction of the work until the first focus."""
HALF_RANGE = 2.0
"""Half of the z range of a sweep, in depths of field."""
DELAY_STEP = 0.125
"""Distance of the frames of a sweep for the trigger delay, in depths of field: the sharpness of the finest texture is
interpolated between them."""
HEIGHT_STEP = 0.125
"""Distance of the frames of a sweep for heights, in depths of field."""
INTERPOLATION_SHARE = 0.001
"""Standard uncertainty of half a shift, as a fraction of the distance of the frames: the largest residual of simulated
sweeps without noise."""
INTERLEAVED = (2, 12)
"""Passes that share the frames of a slow and of a fast sweep; the speed grows with them."""
Complexes = NDArray[np.complex128]
FocalPlane = Callable[[complex], float]


@dataclass(frozen=True, slots=True, kw_only=True)
class PixelProcedure:
    """Pixel size and rotation of the camera from frames along lines of known stage moves.

    n_lines: lines along each axis, spread_um from the first to the last; length_um: of a line, in moves of
    step_fraction of the field; u_stage_fraction: relative standard uncertainty of the scales of the stage.
    """

    in_force: Calibration
    site: CalibrationSite = CalibrationSite()
    n_lines: int = 4
    length_um: float = 5_000.0
    step_fraction: float = PIXEL_STEP_FRACTION
    spread_um: float = 10_000.0
    u_stage_fraction: float = 1e-5

    @property
    def title(self) -> str:
        """Title in the list of running work."""
        return "Calibrate the pixel size"

    def run(self, rig: Rig, control: ProcedureControl) -> CalibrationResult:
        """Find the plane of focus, follow the lines, and fit pixel size and rotation."""
        control.report(ProcedureStep(0.0, "Find the focus"))
        start = focused_site(rig, self.site, control.should_stop)
        lines = self._lines(rig, start)
        with frames_at_places(rig, start.exposure_us, control.should_stop) as take:
            focal_plane = self._focal_plane(rig, take, start, lines)
            followed: list[StageLine] = []
            for number, line in enumerate(lines):
                share = FOCUS_SHARE + (1 - FOCUS_SHARE) * number / len(lines)
                followed.append(self._follow(take, line, focal_plane, control, share))
        found = pixel_scale(followed[: self.n_lines], followed[self.n_lines :], self.u_stage_fraction)
        control.report(ProcedureStep(1.0))
        return self._result(found)

    def _lines(self, rig: Rig, start: FocusedSite) -> list[Complexes]:
        """Return the positions of all lines, x + i y in um, those along x first. Raises RigError beyond the stage."""
        across = (np.arange(self.n_lines) / max(self.n_lines - 1, 1) - 0.5) * self.spread_um
        step_x, step_y = (self.step_fraction * um for um in (rig.limits.field_width_um, rig.limits.field_height_um))
        centre = complex(start.x_um, start.y_um)
        lines = [centre + _places(self.length_um, step_x) + 1j * y for y in across]
        lines += [centre + x + 1j * _places(self.length_um, step_y) for x in across]
        every: Any = np.concatenate(lines)
        reached: tuple[tuple[Axis, Any], ...] = (("x", every.real), ("y", every.imag))
        for axis, positions in reached:
            for end_um in (float(positions.min()), float(positions.max())):
                rig.limits.axis(axis).require_reachable(axis, end_um)
        return lines

    def _focal_plane(self, rig: Rig, take: TakeFrame, start: FocusedSite, lines: Sequence[Complexes]) -> FocalPlane:
        """Return the focus over the places of the lines: a plane through the focus at the ends of the outer lines."""
        outer = (lines[0], lines[self.n_lines - 1], lines[self.n_lines], lines[-1])
        corners = np.array([end for line in outer for end in (line[0], line[-1])]) - complex(start.x_um, start.y_um)
        focus_um = [
            focus_at(rig, take, start.x_um + at.real, start.y_um + at.imag, start.z_um, self.site.z_range_um)
            for at in corners
        ]
        design = np.stack([np.ones(len(corners)), corners.real, corners.imag], axis=1)
        plane, *_ = np.linalg.lstsq(design, np.array(focus_um), rcond=None)
        return lambda at: float(plane @ (1.0, at.real - start.x_um, at.imag - start.y_um))

    def _follow(
        self, take: TakeFrame, line: Complexes, focal_plane: FocalPlane, control: ProcedureControl, share: float
    ) -> StageLine:
        from wafer_viewer.calibrate.image_geometry import displacement_px

        moved_um, displaced_px = np.diff(line), np.full(len(line) - 1, np.nan, np.complex128)
        turned = self.in_force.pixel_um * np.exp(1j * self.in_force.camera_rotation_rad)
        before: Image | None = None
        for n, at in enumerate(line):
            image = take(at.real, at.imag, focal_plane(at))
            if before is not None:
                found = displacement_px(before, image, complex(moved_um[n - 1] / turned))
                displaced_px[n - 1] = np.nan if found is None else found
            before = image
            control.report(ProcedureStep(share, "Follow the lines", None))
        return StageLine(moved_um, displaced_px)

    def _result(self, found: PixelScale) -> CalibrationResult:
        before = self.in_force
        rotation = found.rotation_rad
        lines = (
            characteristic("pixel size", found.pixel_um, "um", ISO_600, before.pixel_um),
            characteristic("pixel size along x", found.pixel_x_um, "um"),
            characteristic("pixel size along y", found.pixel_y_um, "um"),
            characteristic("camera rotation", rotation, "mrad", "", before.camera_rotation_rad * 1e3, 1e3),
            characteristic("squareness of camera and stage", found.shear_rad, "mrad", ISO_600, None, 1e3),
        )
        notes = [
            f"{found.n_steps} moves along {2 * self.n_lines} lines; the stage is {found.stage_error_um:.3g} um off "
            "them (root mean square along an axis).",
            f"The scale is that of the stage: its u of {self.u_stage_fraction:.2g} is in U.",
        ]
        if found.n_rejected:
            notes.append(f"{found.n_rejected} moves were left out: the frames could not be matched.")
        return CalibrationResult(
            kind="pixel",
            characteristics=lines,
            sets={
                "pixel_um": found.pixel_um.value,
                "u_pixel_um": found.pixel_um.u,
                "camera_rotation_rad": rotation.value,
                "u_camera_rotation_rad": rotation.u,
            },
            notes=tuple(notes),
        )


def _places(length_um: float, step_um: float) -> NDArray[np.float64]:
    """Return places along a line about 0, a step apart."""
    n_steps = max(LEAST_STEPS, math.ceil(length_um / step_um))
    return np.asarray((np.arange(n_steps + 1) - n_steps / 2) * step_um, np.float64)


@dataclass(frozen=True, slots=True, kw_only=True)
class DelayProcedure:
    """Delay from the pulse to the exposure from sweeps of one field upward and downward at two speeds."""

    in_force: Calibration
    site: CalibrationSite = CalibrationSite()
    repeats: int = 4

    @property
    def title(self) -> str:
        """Title in the list of running work."""
        return "Calibrate the trigger delay"

    def run(self, rig: Rig, control: ProcedureControl) -> CalibrationResult:
        """Take the sweeps, compare each pair, and fit the delay."""
        control.report(ProcedureStep(0.0, "Find the focus"))
        site = focused_site(rig, self.site, control.should_stop)
        pairs: list[SweepPair] = []
        for repeat in range(self.repeats):
            for interleaved in INTERLEAVED:
                share = FOCUS_SHARE + (1 - FOCUS_SHARE) * len(pairs) / (self.repeats * len(INTERLEAVED))
                control.report(ProcedureStep(share, f"Sweep up and down, {repeat + 1} of {self.repeats}"))
                pairs.append(self._pair(rig, site, interleaved, control))
        error = delay_error(pairs, INTERPOLATION_SHARE * DELAY_STEP * rig.limits.depth_of_field_um)
        delay = Estimate(self.in_force.trigger_delay_us + error.delay_us.value, error.delay_us.u)
        if delay.value < 0:
            raise RigError(
                f"The delay would be {delay.value:.1f} us: an exposure cannot begin before its pulse. Check that the "
                "field stands still and is in focus."
            )
        control.report(ProcedureStep(1.0))
        return CalibrationResult(
            kind="delay",
            characteristics=(
                characteristic("trigger delay", delay, "us", "", self.in_force.trigger_delay_us),
                characteristic("play of the z axis", error.play_um, "um"),
            ),
            sets={"trigger_delay_us": delay.value, "u_trigger_delay_us": delay.u},
            notes=(f"Speeds of {', '.join(f'{v:.0f}' for v in sorted({p.speed_um_s for p in pairs}))} um/s.",),
        )

    def _pair(self, rig: Rig, site: FocusedSite, interleaved: int, control: ProcedureControl) -> SweepPair:
        half_um, step_um = (n * rig.limits.depth_of_field_um for n in (HALF_RANGE, DELAY_STEP))
        room = site.z_um - half_um, site.z_um + half_um
        curves: list[FocusSweepCurve] = []
        speed_um_s = 0.0
        for direction in (1, -1):
            sweep, speed_um_s = take_sweep(
                rig, site, room, step_um, self.in_force.trigger_delay_us, control.should_stop, direction, interleaved
            )
            curves.append(FocusSweepCurve(sweep.z_um, np.array([sharpness(image) for image in sweep.images])))
        return SweepPair(speed_um_s, curve_shift_um(*curves) / 2)


@dataclass(frozen=True, slots=True, kw_only=True)
class NoiseProcedure:
    """Measurement noise from repeated scans of one field."""

    in_force: Calibration
    site: CalibrationSite = CalibrationSite()
    repeats: int = 6

    @property
    def title(self) -> str:
        """Title in the list of running work."""
        return "Measure the noise of the heights"

    def run(self, rig: Rig, control: ProcedureControl) -> CalibrationResult:
        """Scan a field several times and compare the heights."""
        from wafer_viewer.calibrate.topography import measurement_noise_um

        control.report(ProcedureStep(0.0, "Find the focus"))
        site = focused_site(rig, self.site, control.should_stop)
        maps: list[Any] = []
        for repeat in range(self.repeats):
            control.report(ProcedureStep(FOCUS_SHARE + (1 - FOCUS_SHARE) * repeat / self.repeats, "Scan the field"))
            maps.append(heights_at(rig, site, self.in_force, control))
        noise = measurement_noise_um(maps)
        control.report(ProcedureStep(1.0))
        return CalibrationResult(
            kind="noise",
            characteristics=(characteristic("measurement noise", noise, "um", ISO_700),),
            notes=(f"Root mean square of a single scan, from {self.repeats} scans of one field by their differences.",),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class FlatnessProcedure:
    """Flatness deviation from the mean of the heights at several places of a flat."""

    in_force: Calibration
    site: CalibrationSite = CalibrationSite()
    n_side: int = 3

    @property
    def title(self) -> str:
        """Title in the list of running work."""
        return "Measure the flatness deviation"

    def run(self, rig: Rig, control: ProcedureControl) -> CalibrationResult:
        """Scan a square of places side by side and average their heights."""
        from wafer_viewer.calibrate.topography import flatness_deviation_um

        control.report(ProcedureStep(0.0, "Find the focus"))
        first = focused_site(rig, self.site, control.should_stop)
        offsets = np.arange(self.n_side) - (self.n_side - 1) / 2
        maps: list[Any] = []
        for number, (right, up) in enumerate((a, b) for a in offsets for b in offsets):
            share = FOCUS_SHARE + (1 - FOCUS_SHARE) * number / self.n_side**2
            control.report(ProcedureStep(share, f"Scan place {number + 1} of {self.n_side**2}"))
            place = CalibrationSite(
                x_um=first.x_um + float(right) * rig.limits.field_width_um,
                y_um=first.y_um + float(up) * rig.limits.field_height_um,
                z_um=first.z_um,
                z_range_um=self.site.z_range_um,
                exposure_us=first.exposure_us,
            )
            maps.append(heights_at(rig, focused_site(rig, place, control.should_stop), self.in_force, control))
        flatness = flatness_deviation_um(maps)
        control.report(ProcedureStep(1.0))
        return CalibrationResult(
            kind="flatness",
            characteristics=(characteristic("flatness deviation", flatness, "um", ISO_700),),
            sets={"u_flatness_um": math.hypot(flatness.value / math.sqrt(12), flatness.u)},
            notes=(f"Range of the mean of {len(maps)} fields, levelled and averaged over blocks.",),
        )


def heights_at(
    rig: Rig,
    site: FocusedSite,
    in_force: Calibration,
    control: ProcedureControl,
    half_range_um: float | None = None,
    step: float = HEIGHT_STEP,
) -> Any:
    """Return the measured heights of a field in um, float32 [row, col].

    half_range_um: half of the z range, two depths of field by default; step: distance of the frames, in depths of
    field.
    """
    from wafer_viewer.reconstruct.field_pipeline import reconstruct

    depth_um = rig.limits.depth_of_field_um
    half_um, step_um = half_range_um or HALF_RANGE * depth_um, step * depth_um
    room = site.z_um - half_um, site.z_um + half_um
    sweep, _ = take_sweep(rig, site, room, step_um, in_force.trigger_delay_us, control.should_stop)
    return reconstruct(_stack(sweep, site, in_force)).z_raw_um


def _stack(sweep: Sweep, site: FocusedSite, in_force: Calibration) -> FieldStack:
    field = Field(number=1, row=0, col=0, x_um=site.x_um, y_um=site.y_um, z_start_um=float(sweep.z_um[0]))
    z_um = sweep.z_um * in_force.z_scale
    present = np.ones(len(z_um), np.bool_)
    images: Any = np.stack(sweep.images)
    return FieldStack(field, images, z_um, present, in_force.pixel_um, calibration=in_force)


def characteristic(
    name: str, found: Estimate, unit: str, standard: str = "", before: float | None = None, factor: float = 1.0
) -> Characteristic:
    """Return a characteristic with U (k = 2), in the unit that is `factor` times that of the estimate."""
    return Characteristic(
        name=name,
        value=found.value * factor,
        unit=unit,
        expanded=2 * found.u * factor,
        standard=standard,
        before=before,
    )
