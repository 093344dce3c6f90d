"""Studies of repeatability and reproducibility: what was measured again and again, and what is found by it."""

from __future__ import annotations

from typing import ClassVar, Literal

from wafer_viewer.model.errors import MeasureError, WaferViewerError
from wafer_viewer.model.quantity import Unit
from wafer_viewer.model.spec import NonNegative, Positive, Spec

Method = Literal["range", "anova"]


class Study(Spec, frozen=True, kw_only=True):
    """One feature measured again and again: `values` [part][appraiser][trial] in `unit`, trials in order of time.

    tolerance: of the feature, upper limit less lower. simulated: whether any of the scans is.
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
        """How often everyone measured every part."""
        return len(self.values[0][0])


class Repeats(Spec, frozen=True, kw_only=True):
    """How well a measurement repeats: the standard deviation of one, pooled over cells of like repeats.

    degrees_of_freedom: of the deviation; `u_of_mean` is the standard uncertainty of the mean of n.
    """

    error: ClassVar[type[WaferViewerError]] = MeasureError
    s: NonNegative
    degrees_of_freedom: int
    unit: Unit

    def u_of_mean(self, n: int) -> float:
        """Standard uncertainty (k = 1) of the mean of n measurements."""
        return self.s / n**0.5


class GaugeRR(Spec, frozen=True, kw_only=True):
    """A gauge R&R study by AIAG's MSA; deviations are standard deviations in the unit of the values.

    `repeatability` (equipment variation), `reproducibility` (appraiser variation, with what appraisers and parts do
    together), `gauge_rr` both, `part_variation`, `total_variation` all. `interaction` is the p value of appraisers
    against parts (by ANOVA alone); up to `pooled_over` of it counts as real and is not pooled into repeatability.
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
        """Gauge R&R as a share of the total variation (%GRR / 100); NaN where nothing varies."""
        return self.gauge_rr / self.total_variation if self.total_variation else float("nan")

    @property
    def share_of_tolerance(self) -> float | None:
        """Six deviations of the gauge as a share of the tolerance; None without one."""
        return 6 * self.gauge_rr / self.tolerance if self.tolerance else None

    @property
    def distinct_categories(self) -> int:
        """ndc: into how many classes the gauge can part these parts; 0 where it finds none."""
        return int(1.41 * self.part_variation / self.gauge_rr) if self.gauge_rr else 0
