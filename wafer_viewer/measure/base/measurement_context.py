"""Context of a measurement: surface, layer, calibration, and the facts common to all results."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

from wafer_viewer.measure.base.height_samples import Layer, layer_of, level_note
from wafer_viewer.measure.base.levelled_surface import levelling_of
from wafer_viewer.measure.base.uncertainty_budget import NOT_IN_BUDGET, interpolation_um
from wafer_viewer.model.quantity import BudgetLine, Contribution, Length, Quantity, Unit, UStatus
from wafer_viewer.model.surface.height_map import Mosaic

Lines = dict[str, float]
"""Budget lines: standard uncertainty (k = 1) by source."""


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

    def told(self, name: str, level: int = 0, *notes: str) -> dict[str, Any]:
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
            return Length.evaluated(value_um, tuple(Contribution(name=n, u_um=u) for n, u in lines.items()))
        return Length(value_um=value_um, status=self._no_budget())

    def quantity(self, value: float, unit: Unit, lines: Lines | None) -> Quantity:
        """Return a quantity that is not a length; its budget lines are in its own unit."""
        if self.calibrated and lines is not None:
            return Quantity.evaluated(value, unit, tuple(BudgetLine(name=n, u=u) for n, u in lines.items()))
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

    @property
    def u_interpolation_um(self) -> float:
        """Standard uncertainty of a height difference due to peak interpolation between frames (k = 1)."""
        return interpolation_um(self.surface.provenance)

    def _no_budget(self) -> UStatus:
        return "not evaluated" if self.calibrated else "uncalibrated"
