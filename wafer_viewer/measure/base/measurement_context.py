"""Context of a measurement: surface, layer, calibration, common facts, and its uncertainty budget."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from wafer_viewer.measure.base.correlated_errors import Scatter
from wafer_viewer.measure.base.height_samples import Floats, Layer, layer_of, level_note
from wafer_viewer.measure.base.levelled_surface import levelling_of
from wafer_viewer.model.measurement.tool_options import Conditions
from wafer_viewer.model.quantity import Contribution, Distribution, Length, Quantity, Unit, UStatus
from wafer_viewer.model.surface.frame_health import interpolation_u_um
from wafer_viewer.model.surface.height_map import Mosaic, Provenance

ARGMAX_INTERPOLATION = 1 / math.sqrt(6)
"""Standard uncertainty of a step, in z steps, when both faces are rounded to frames (two uniform roundings)."""
INTERPOLATION_SHARE = 0.005
"""Standard uncertainty of a step, in z steps, for interpolated peaks where the depth of field is unknown."""
ALIKE_BETWEEN_FRAMES = 0.95
"""Share of the variance of the error between frames that heights at the same place between them have in common.

Level faces of one field, seen by rays, agree better: tests/bench/gauge_step.py.
"""
NOT_IN_BUDGET = (
    "Not in the budget: repeat scans, drift during the scan, z offsets between fields, linearity and Abbe offset of "
    "the z axis, temperature other than 20 °C."
)
NOISE, Z_SCALE, LINEARITY, LEVELLING = "noise and form of the faces", "z scale", "z linearity", "levelling"
DRIFT, POSES, INTERPOLATION = "drift during the scan", "poses of the fields", "interpolation between frames"
Z_JITTER, FLICKER = "z jitter of the frames", "flicker of the light"
GAPS = "frames missing or left out"
PIXEL_SCALE, WINDOW = "pixel scale", "resolution of the focus window"
WINDOW_BASE_PX2 = 1.5
"""Variance of the average that a focus measure takes besides its window, px2: errors of caps whose radius is known."""
REPEATABILITY, TEMPERATURE, ABBE = "repeatability", "temperature", "Abbe offset"
FLATNESS = "flatness deviation"
OF_FRAMES = (INTERPOLATION, Z_JITTER, FLICKER, GAPS)
LINES = (NOISE, Z_SCALE, LINEARITY, FLATNESS, LEVELLING, DRIFT, POSES, *OF_FRAMES, REPEATABILITY, TEMPERATURE, ABBE)
"""All lines of a step's budget, in reporting order."""
LESS_WITH_REPEATS = (NOISE, DRIFT, POSES, *OF_FRAMES, REPEATABILITY)
"""Lines reduced by averaging several scans; the others are common to all scans."""
REFERENCE_C = 20.0
"""Reference temperature of lengths (ISO 1)."""
DISTRIBUTIONS: dict[str, Distribution] = {INTERPOLATION: "triangular"}
"""Distributions of lines that are not normal: both ends of a height difference lie anywhere between two frames."""
Lines = Mapping[str, float | Scatter]
"""Budget lines: standard uncertainty (k = 1) by source, with degrees of freedom where scatter gave it."""


@dataclass(frozen=True, slots=True)
class Budget:
    """Standard uncertainties (k = 1) in um by source, and the lines that were not evaluated."""

    lines: Lines
    not_evaluated: tuple[str, ...]


def step_budget(
    height_um: float, of_points: Mapping[str, float | Scatter | None], conditions: Conditions, provenance: Provenance
) -> Budget:
    """Return the budget of a height; of_points: lines evaluated from its points, None where they cannot be."""
    known = {**from_conditions(height_um, conditions, provenance), **of_points}
    given = {name: known.get(name) for name in LINES if name in known}
    return Budget(
        {name: u for name, u in given.items() if u is not None},
        tuple(name for name, u in given.items() if u is None),
    )


def from_conditions(height_um: float, conditions: Conditions, provenance: Provenance) -> dict[str, float | None]:
    """Return the lines known before the measurement, None where unknown; given values override the calibration."""
    calibration = provenance.calibration
    linearity_um, abbe_um = conditions.z_linearity_um, conditions.abbe_um
    if calibration is not None:
        linearity_um = calibration.u_z_linearity_um if linearity_um is None else linearity_um
        abbe_um = calibration.u_abbe_um if abbe_um is None else abbe_um
    flatness_um = None if calibration is None else calibration.u_flatness_um
    return {
        Z_SCALE: None if calibration is None else calibration.u_z_scale * abs(height_um),
        LINEARITY: linearity_um,
        DRIFT: conditions.drift_um,
        **frame_lines_um(provenance),
        REPEATABILITY: conditions.repeatability_um,
        TEMPERATURE: _temperature_um(height_um, conditions),
        ABBE: abbe_um,
        **({} if flatness_um is None else {FLATNESS: flatness_um}),
    }


def between_frames_um(provenance: Provenance, *sums: tuple[Floats, Floats]) -> float | None:
    """Return the standard uncertainty of a sum of heights of one field due to peak interpolation between frames.

    sums: weights [n] and heights [n] of each face. The error of a height depends on its place between two frames, and
    most of it is the same for all heights at the same place: it cancels in a step of whole frames, and over a face that
    spans them. None where places between frames are not known.
    """
    step_um = provenance.even_step_um
    if step_um == 0 or provenance.recipe.peak == "argmax":
        return None
    each = np.array([weight @ np.exp(2j * np.pi / step_um * z_um) for weight, z_um in sums])
    alike, alone = np.abs(each.sum()) ** 2, np.sum(np.abs(each) ** 2)
    share = math.sqrt(ALIKE_BETWEEN_FRAMES * alike + (1 - ALIKE_BETWEEN_FRAMES) * alone)
    return share * interpolation_um(provenance) / math.sqrt(2)


def interpolation_um(provenance: Provenance) -> float:
    """Standard uncertainty of a height difference due to peak interpolation between frames."""
    recipe, step_um, told_um = provenance.recipe, provenance.z_step_um, provenance.frame_health.u_between_um
    if recipe.peak == "argmax":
        return ARGMAX_INTERPOLATION * step_um
    if told_um:
        return math.sqrt(2) * told_um
    if isinstance(recipe.focus_width_um, str):
        return INTERPOLATION_SHARE * step_um
    return math.sqrt(2) * interpolation_u_um(recipe.peak, step_um, recipe.focus_width_um)


def frame_lines_um(provenance: Provenance) -> dict[str, float]:
    """Return the lines of a height difference that its frames cause; faults of the frames only if they show."""
    health = provenance.frame_health
    seen = {Z_JITTER: health.u_jitter_um, FLICKER: health.u_flicker_um, GAPS: health.u_gap_um}
    faults = {name: math.sqrt(2) * u_um for name, u_um in seen.items() if u_um > 0}
    return {INTERPOLATION: interpolation_um(provenance), **faults}


def _temperature_um(height_um: float, conditions: Conditions) -> float | None:
    """Return the standard uncertainty due to temperature: the full expansion, as heights are not corrected."""
    if conditions.temperature_c is None:
        return None
    off_k = math.hypot(conditions.temperature_c - REFERENCE_C, conditions.u_temperature_c)
    return abs(height_um) * conditions.expansion_per_k * off_k


def contribution(name: str, u: float | Scatter) -> Contribution:
    """Return a line of a budget; a scatter was evaluated from readings (type A), a plain number otherwise (type B)."""
    distribution = DISTRIBUTIONS.get(name, "normal")
    if not isinstance(u, Scatter):
        return Contribution(name=name, distribution=distribution, u_um=u)
    freedom = None if math.isinf(u.freedom) else u.freedom
    return Contribution(name=name, evaluation="A", distribution=distribution, freedom=freedom, u_um=u.u)


def times(u: float | Scatter, factor: float) -> float | Scatter:
    """Return the standard uncertainty of a multiple."""
    return u.times(factor) if isinstance(u, Scatter) else abs(factor) * u


def combined(lines: Iterable[float | Scatter]) -> float:
    """Return the root sum of squares of standard uncertainties."""
    return Scatter.joined(*lines).u


@dataclass(frozen=True, slots=True)
class MeasurementContext:
    """A surface, the height layer to measure, and whether the calibration is valid."""

    surface: Mosaic
    layer: Layer
    calibrated: bool

    @classmethod
    def of(cls, surface: Mosaic, layer: Layer | None, calibration_valid: bool) -> Self:
        """Return the context for the given layer, or by default the one that the surface's recipe measures on."""
        provenance = surface.provenance
        calibrated = calibration_valid and provenance.calibration is not None
        return cls(surface, layer_of(provenance.recipe, layer), calibrated)

    def result_fields(self, name: str, level: int = 0, *notes: str) -> dict[str, Any]:
        """Return the fields common to all results."""
        return {
            "name": name,
            "surface": self.layer,
            "levelling": levelling_of(self.surface),
            "simulated": self.surface.provenance.simulated,
            "notes": (*notes, *level_note(self.surface, level)),
        }

    def length(self, value_um: float, lines: Lines | None) -> Length:
        """Return a length with its budget; lines None: no defensible budget exists."""
        if self.calibrated and lines is not None:
            return Length.evaluated(value_um, tuple(contribution(*line) for line in lines.items()))
        return Length(value_um=value_um, status=self._no_budget())

    def quantity(self, value: float, unit: Unit, lines: Lines | None) -> Quantity:
        """Return a quantity that is not a length; its budget lines are in its own unit."""
        if self.calibrated and lines is not None:
            budget = tuple(contribution(*line).general for line in lines.items())
            return Quantity.evaluated(value, unit, budget)
        return Quantity(value=value, unit=unit, status=self._no_budget())

    def not_in_budget(self, *more: str, own: bool = False) -> tuple[str, ...]:
        """Return notes on contributions missing from budgets; none where there are no budgets.

        own: the result lists its missing contributions itself.
        """
        if not self.calibrated:
            return ()
        levelled = levelling_of(self.surface).by != "stage"
        zero = ("Not in the budget: how sure the zero is that heights are read from.",) if levelled else ()
        return (*zero, *more, *(() if own else (NOT_IN_BUDGET,)))

    @property
    def u_z_scale(self) -> float:
        """Relative standard uncertainty of the z scale (k = 1)."""
        calibration = self.surface.provenance.calibration
        return 0.0 if calibration is None else calibration.u_z_scale

    @property
    def u_pixel_scale(self) -> float:
        """Relative standard uncertainty of the lateral scale (k = 1)."""
        calibration = self.surface.provenance.calibration
        return 0.0 if calibration is None else calibration.u_pixel_um / calibration.pixel_um

    def lateral_lines(self, length_um: float) -> dict[str, float]:
        """Return the budget lines in um that every lateral length has: pixel scale and, if measured, mapping."""
        lines = {PIXEL_SCALE: self.u_pixel_scale * abs(length_um)}
        return lines if self.u_mapping_um is None else {**lines, "x-y mapping deviation": self.u_mapping_um}

    @property
    def u_mapping_um(self) -> float | None:
        """Standard uncertainty of a lateral length from the x-y mapping deviation (k = 1); None if not measured."""
        calibration = self.surface.provenance.calibration
        return None if calibration is None else calibration.u_mapping_um

    def sag_um(self, curvature: float) -> float:
        """Return by how much the focus window lowers a top of a curvature 1 / R, in um; 0 for an unknown window.

        Heights are not corrected for it: it is taken as a standard uncertainty.
        """
        window = self.surface.provenance.recipe.window
        if isinstance(window, str):
            return 0.0
        return ((window**2 - 1) / 6 + WINDOW_BASE_PX2) * self.surface.pixel_um**2 * abs(curvature)

    @property
    def window_reach_px(self) -> int:
        """Distance from a pixel to the farthest one in its focus window, in px; 0 for an unknown window.

        The window is a box applied twice.
        """
        window = self.surface.provenance.recipe.window
        return 0 if isinstance(window, str) else window - 1

    def frame_lines(self, factor: float = 1.0) -> dict[str, float]:
        """Return the budget lines of `factor` times a height difference that the frames of its stack cause."""
        return {name: factor * u_um for name, u_um in frame_lines_um(self.surface.provenance).items()}

    def _no_budget(self) -> UStatus:
        return "not evaluated" if self.calibrated else "uncalibrated"
