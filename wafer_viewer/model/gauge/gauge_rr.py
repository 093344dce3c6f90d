"""Repeatability and reproducibility studies: repeated measurements and their evaluation."""

from __future__ import annotations

from typing import ClassVar, Literal

from wafer_viewer.model.errors import MeasureError, WaferViewerError
from wafer_viewer.model.quantity import Unit
from wafer_viewer.model.spec import NonNegative, Positive, Spec

Method = Literal["range", "anova"]


class Study(Spec, frozen=True, kw_only=True):
    """Repeated measurements of one feature: `values` [part][appraiser][trial] in `unit`, trials in order of time.

    tolerance: upper minus lower limit of the feature. simulated: True if any of the scans is simulated.
    """

    error: ClassVar[type[WaferViewerError]] = MeasureError
    feature: str
    unit: Unit
    parts: tuple[str, ...]
    appraisers: tuple[str, ...]
    values: tuple[tuple[tuple[float, ...], ...], ...]
    tolerance: Positive | None = None
    simulated: bool = False

    @property
    def trials(self) -> int:
        """Number of trials per part and appraiser."""
        return len(self.values[0][0])


class Repeats(Spec, frozen=True, kw_only=True):
    """Repeatability of a measurement: standard deviation of a single one, pooled over cells of repeats.

    degrees_of_freedom: of that deviation; `u_of_mean` gives the standard uncertainty of the mean of n.
    """

    error: ClassVar[type[WaferViewerError]] = MeasureError
    s: NonNegative
    degrees_of_freedom: int
    unit: Unit

    def u_of_mean(self, n: int) -> float:
        """Return the standard uncertainty (k = 1) of the mean of n measurements."""
        return self.s / n**0.5


class GaugeRR(Spec, frozen=True, kw_only=True):
    """A gauge R&R study after AIAG's MSA; all deviations are standard deviations in the unit of the values.

    `repeatability`: equipment variation; `reproducibility`: appraiser variation, including the interaction of
    appraisers and parts; `gauge_rr`: both combined; `part_variation`; `total_variation`: all combined. `interaction`: p
    value of the interaction of appraisers and parts (ANOVA only); only an insignificant interaction is pooled into
    repeatability.
    """

    error: ClassVar[type[WaferViewerError]] = MeasureError
    method: Method
    parts: int
    appraisers: int
    trials: int
    repeatability: NonNegative
    reproducibility: NonNegative
    gauge_rr: NonNegative
    part_variation: NonNegative
    total_variation: NonNegative
    interaction: float | None = None
    tolerance: Positive | None = None
    notes: tuple[str, ...] = ()

    @property
    def share_of_variation(self) -> float:
        """Gauge R&R as a fraction of the total variation (%GRR / 100); NaN if nothing varies."""
        return self.gauge_rr / self.total_variation if self.total_variation else float("nan")

    @property
    def share_of_tolerance(self) -> float | None:
        """Six standard deviations of the gauge as a fraction of the tolerance; None without a tolerance."""
        return 6 * self.gauge_rr / self.tolerance if self.tolerance else None

    @property
    def distinct_categories(self) -> int:
        """Number of distinct categories (ndc) that the gauge can resolve among these parts; 0 if none."""
        return int(1.41 * self.part_variation / self.gauge_rr) if self.gauge_rr else 0
