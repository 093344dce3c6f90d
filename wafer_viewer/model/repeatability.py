"""What a study of repeatability and reproducibility finds: how much of the spread is the gauge's."""

from __future__ import annotations

from typing import ClassVar, Literal

from wafer_viewer.model.errors import MeasureError, WaferViewerError
from wafer_viewer.model.spec import NonNegative, Positive, Spec

Method = Literal["range", "anova"]


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
