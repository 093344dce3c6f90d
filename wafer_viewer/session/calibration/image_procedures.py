"""Calibrations of the image on the rig: flat field, x-y mapping deviation, and width of the response to a step."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.acquire.commanded_frames import TakeFrame, frames_at_places
from wafer_viewer.acquire.motion import device_errors, move
from wafer_viewer.acquire.pass_runner import rig_at_rest
from wafer_viewer.model.acquisition.calibration import Calibration
from wafer_viewer.model.acquisition.characteristics import CalibrationResult
from wafer_viewer.model.acquisition.devices import Rig
from wafer_viewer.model.acquisition.procedure import ProcedureControl, ProcedureStep
from wafer_viewer.model.errors import RigError
from wafer_viewer.session.calibration.frames import CalibrationSite, FocusedSite, exposed_site, focus_at, focused_site
from wafer_viewer.session.calibration.procedures import (
    FOCUS_SHARE,
    ISO_600,
    ISO_700,
    Complexes,
    characteristic,
    heights_at,
)

LEAST_RATIO = 2.0
"""Smallest ratio of the two exposures of a flat field."""
EDGE_STEP = 0.25
"""Distance of the frames of a sweep over a step, in depths of field."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FlatFieldProcedure:
    """Flat field and dark level from frames out of focus at several places of a flat, at two exposures."""

    in_force: Calibration
    site: CalibrationSite = CalibrationSite()
    n_side: int = 4
    frames: int = 4
    defocus: float = 12.0
    dark_counts: float | None = None

    @property
    def title(self) -> str:
        """Title in the list of running work."""
        return "Measure the flat field"

    def run(self, rig: Rig, control: ProcedureControl) -> CalibrationResult:
        """Take the frames at both exposures, average them over the places, and return to the focus."""
        from wafer_viewer.calibrate.flat_field import FlatFrames, flat_field

        control.report(ProcedureStep(0.0, "Find the focus"))
        start = focused_site(rig, self.site, control.should_stop)
        exposures = FlatFrames(start.exposure_us, rig.limits.camera.exposure_min_us)
        if exposures.bright_us < LEAST_RATIO * exposures.short_us and self.dark_counts is None:
            raise RigError(
                f"The exposure of {exposures.bright_us:g} us is hardly longer than the shortest of the camera, "
                f"{exposures.short_us:g} us: reduce the light, or give the dark level as measured with the light "
                "covered."
            )
        z_um = self._defocused_um(rig, start.z_um)
        bright = self._tour(rig, replace(start, z_um=z_um), control, FOCUS_SHARE)
        short = bright
        if self.dark_counts is None:
            site = replace(start, z_um=z_um, exposure_us=exposures.short_us)
            short = self._tour(rig, site, control, (1 + FOCUS_SHARE) / 2)
        with rig_at_rest(rig), device_errors("stage"):
            move(rig, {"x": start.x_um, "y": start.y_um, "z": start.z_um}, control.should_stop)
        found = flat_field((rig.limits.camera.rows, rig.limits.camera.cols), bright, short, exposures, self.dark_counts)
        control.report(ProcedureStep(1.0))
        by = (
            f"The dark level is that of an exposure of zero, by frames of {exposures.bright_us:.0f} and "
            f"{exposures.short_us:.0f} us: exposures that are longer than they say are not in U."
            if self.dark_counts is None
            else "The dark level was given, as measured with the light covered."
        )
        return CalibrationResult(
            kind="flat-field",
            characteristics=(
                characteristic("shading of the image", found.shading, "%", factor=100.0),
                characteristic("dark level", found.dark_counts, "counts"),
            ),
            sets={"flat_field": found.flat_field.digest},
            flat_field=found.flat_field,
            notes=(
                f"Range of the sensitivity over its mean, averaged over a tenth of the image; from {self.n_side**2} "
                f"places {_off(z_um, start)}.",
                by,
            ),
        )

    def _defocused_um(self, rig: Rig, focus_um: float) -> float:
        """Return a z above the focus, or below it where the axis ends. Raises RigError where it reaches neither."""
        away_um = self.defocus * rig.limits.depth_of_field_um
        axis = rig.limits.z
        for z_um in (focus_um + away_um, focus_um - away_um):
            if axis.low_um <= z_um <= axis.high_um:
                return z_um
        raise RigError(
            f"The z axis cannot go {away_um:.0f} um out of focus: its range is {axis.low_um:g} to {axis.high_um:g} um. "
            "Give a smaller defocus."
        )

    def _tour(self, rig: Rig, site: FocusedSite, control: ProcedureControl, begun: float) -> list[NDArray[np.float64]]:
        """Return the block means of all places at one exposure."""
        from wafer_viewer.calibrate.flat_field import block_means

        steps = np.arange(self.n_side) - (self.n_side - 1) / 2
        means: list[NDArray[np.float64]] = []
        with frames_at_places(rig, site.exposure_us, control.should_stop) as take:
            for up in steps:
                for right in steps:
                    share = begun + (1 - FOCUS_SHARE) / 2 * len(means) / self.n_side**2
                    control.report(ProcedureStep(share, f"Frames of {site.exposure_us:.0f} us"))
                    x_um = site.x_um + float(right) * rig.limits.field_width_um
                    y_um = site.y_um + float(up) * rig.limits.field_height_um
                    total: Any = sum(take(x_um, y_um, site.z_um).astype(np.float64) for _ in range(self.frames))
                    means.append(block_means(total / self.frames))
        return means


def _off(z_um: float, start: FocusedSite) -> str:
    side = "above" if z_um > start.z_um else "below"
    return f"{abs(z_um - start.z_um):.0f} um {side} the focus"


@dataclass(frozen=True, slots=True, kw_only=True)
class MappingProcedure:
    """x-y mapping deviation from patches of texture that the stage moves to a grid of places in the field."""

    in_force: Calibration
    site: CalibrationSite = CalibrationSite()
    n_cols: int = 7
    n_rows: int = 5
    repeats: int = 5
    spread_um: float = 10_000.0

    @property
    def title(self) -> str:
        """Title in the list of running work."""
        return "Measure the x-y mapping deviation"

    def run(self, rig: Rig, control: ProcedureControl) -> CalibrationResult:
        """Move each patch over the field, and compare its places with those of the stage."""
        from wafer_viewer.calibrate.image_geometry import grid_px, mapping_deviation, patch_px

        shape = rig.limits.camera.rows, rig.limits.camera.cols
        grid = grid_px(shape, self.n_rows, self.n_cols)
        control.report(ProcedureStep(0.0, "Find the focus"))
        start = focused_site(rig, self.site, control.should_stop)
        sample_um = grid * self.in_force.pixel_um * np.exp(1j * self.in_force.camera_rotation_rad)
        found: list[Complexes] = []
        with frames_at_places(rig, start.exposure_us, control.should_stop) as take:
            for number, centre in enumerate(self._centres(start)):
                control.report(self._step(number, 0.0))
                z_um = focus_at(rig, take, centre.real, centre.imag, start.z_um, self.site.z_range_um)
                found.append(self._positions(take, (centre, z_um), grid, sample_um, number, control))
        deviation = mapping_deviation(sample_um, found)
        control.report(ProcedureStep(1.0))
        largest = deviation.largest_um
        covered = (np.abs(grid.real).max() * 2 + patch_px(shape)) / shape[1]
        n_found = sum(int(np.isfinite(one).sum()) for one in found)
        return CalibrationResult(
            kind="mapping",
            characteristics=(characteristic("largest x-y mapping deviation", largest, "um", ISO_700),),
            sets={"u_mapping_um": math.sqrt(2) * math.hypot(largest.value / math.sqrt(3), largest.u)},
            notes=(
                "Against the scales of the stage, not against a certified grid, after pixel size and rotation: the "
                "standard of ISO 25178-700 is such a grid.",
                f"{n_found} places of {len(found)} patches of {patch_px(shape)} pixels, over {covered:.0%} of the "
                "width of the field.",
            ),
        )

    def _centres(self, start: FocusedSite) -> Complexes:
        """Return the positions of the stage for each patch, x + i y in um, on a diagonal through the start."""
        along = np.arange(self.repeats) / max(self.repeats - 1, 1) - 0.5
        return complex(start.x_um, start.y_um) + along * self.spread_um * np.exp(0.25j * np.pi)

    def _step(self, number: int, part: float) -> ProcedureStep:
        share = FOCUS_SHARE + (1 - FOCUS_SHARE) * (number + part) / self.repeats
        return ProcedureStep(share, f"Move patch {number + 1} of {self.repeats}")

    def _positions(
        self,
        take: TakeFrame,
        at: tuple[complex, float],
        grid: Complexes,
        sample_um: Complexes,
        number: int,
        control: ProcedureControl,
    ) -> Complexes:
        """Return the positions of one patch in the image, in pixels, NaN where it is not found."""
        from wafer_viewer.calibrate.image_geometry import patch_position_px

        centre, z_um = at
        reference = take(centre.real, centre.imag, z_um)
        found = np.full(len(grid), np.nan, np.complex128)
        for n, (place, moved) in enumerate(zip(grid.tolist(), sample_um.tolist(), strict=True)):
            image = take(centre.real - moved.real, centre.imag - moved.imag, z_um)
            position = patch_position_px(reference, image, place)
            found[n] = np.nan if position is None else position
            control.report(self._step(number, (n + 1) / (len(grid) + 1)))
        return found


@dataclass(frozen=True, slots=True, kw_only=True)
class ResolutionProcedure:
    """Width of the response to a step from the heights across a straight steep edge."""

    in_force: Calibration
    site: CalibrationSite = CalibrationSite()
    span_um: float | None = None

    @property
    def title(self) -> str:
        """Title in the list of running work."""
        return "Measure the response to a step"

    def run(self, rig: Rig, control: ProcedureControl) -> CalibrationResult:
        """Scan the field over the range of the search for the focus, and evaluate the edge."""
        from wafer_viewer.calibrate.topography import edge_response

        control.report(ProcedureStep(0.0, "Find the exposure"))
        site = exposed_site(rig, self.site, control.should_stop)
        control.report(ProcedureStep(FOCUS_SHARE, "Scan the field"))
        half_um = self.site.z_range_um / 2
        z_um = heights_at(rig, site, self.in_force, control, half_um, EDGE_STEP)
        found = edge_response(self._middle(z_um), self.in_force.pixel_um)
        control.report(ProcedureStep(1.0))
        return CalibrationResult(
            kind="resolution",
            characteristics=(characteristic("width of the response to a step", found.width_um, "um"),),
            notes=(
                f"Distance across an edge of {found.step_um:.1f} um, {round(found.angle_deg) % 180} degrees to the "
                "columns of the camera, between heights within a tenth of each level; mean of "
                f"{found.n_pieces} profiles.",
                f"For information. It is not the topographic spatial resolution of {ISO_600}, which needs a certified "
                "star-shaped groove (type ASG).",
            ),
        )

    def _middle(self, z_um: Any) -> Any:
        """Return the square about the middle of the field that is evaluated."""
        if self.span_um is None:
            return z_um
        half = max(1, round(self.span_um / self.in_force.pixel_um / 2))
        row, col = (n // 2 for n in z_um.shape)
        return z_um[max(0, row - half) : row + half, max(0, col - half) : col + half]
