"""Checks against certified gauge blocks, their run chart, and repeatability studies.

x is the measured value, the mean of the repeats; the reference is the certified step between two blocks. The error
is x minus the reference. En assesses the U claimed for x, the verdict assesses the error.
"""

from __future__ import annotations

import datetime
import math
from typing import Annotated, ClassVar, Literal

from wafer_viewer.model.acquisition.calibration import Calibration
from wafer_viewer.model.errors import MeasureError, WaferViewerError
from wafer_viewer.model.measurement.measurements import MeasurementResult
from wafer_viewer.model.measurement.result_rows import UNLISTED, Label
from wafer_viewer.model.quantity import COVERAGE_FACTOR, Contribution, Length, Unit, Word
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import Count, Fraction, NonNegative, Positive, Setting, Spec, Within

Grade = Literal["K", "0", "1", "2"]
VARIATION_UM: dict[Grade, float] = {"K": 0.05, "0": 0.10, "1": 0.16, "2": 0.30}
"""Largest variation in length of a gauge block of up to 10 mm, ISO 3650."""
LONGEST_UM = 10_000.0
"""Longest block to which these variations apply, um."""
WITHOUT = "without it there is nothing to check against"
Role = Literal["scale", "measurement", "reference"]
"""Scope of a budget line: U of x alone; U of x and of the error; or U of the reference."""


class GaugeBlock(Spec, frozen=True, kw_only=True):
    """One block of a certificate: its certified length with U (k = 2)."""

    error: ClassVar[type[WaferViewerError]] = MeasureError
    serial_number: str
    nominal_um: Positive
    value_um: Positive
    expanded_um: Positive | None = None


class Certificate(Spec, frozen=True, kw_only=True):
    """Calibration certificate of a step, given directly or as the difference of two blocks, at 20 C.

    expanded_um: U (k = 2); required for a check. grade or variation_um: variation in length of a block over its face.
    expansion_per_k: of the steel of the blocks, from ISO 3650. note: free text, for example that it is an example.
    """

    error: ClassVar[type[WaferViewerError]] = MeasureError
    number: str
    laboratory: str
    issued: datetime.date
    expires: datetime.date
    unit: str = "um"
    nominal_um: Positive | None = None
    value_um: Positive | None = None
    expanded_um: Positive | None = None
    serial_numbers: tuple[str, ...] = ()
    blocks: tuple[GaugeBlock, ...] = ()
    grade: Grade | None = None
    variation_um: NonNegative | None = None
    expansion_per_k: NonNegative = 11.5e-6
    u_expansion_per_k: NonNegative = 0.6e-6
    temperature_c: float = 20.0
    note: str = ""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.unit != "um":
            self._wrong(f"is in {self.unit!r} and its lengths are read in um: convert them and say unit = 'um'")
        if self.temperature_c != 20:
            self.refuse("temperature_c", "20, at which lengths are certified (ISO 1)")
        if self.expires <= self.issued:
            self._wrong(f"expires on {self.expires} and was issued on {self.issued}: one of the days is wrong")
        if self.blocks:
            self._require_two_blocks()
        else:
            self._require_a_step()

    @property
    def step(self) -> Length:
        """Certified step with its U."""
        value_um, expanded_um = self.value_um or 0.0, self.expanded_um
        if self.blocks:
            first, second = self.blocks
            value_um = abs(first.value_um - second.value_um)
            expanded_um = math.hypot(first.expanded_um or 0.0, second.expanded_um or 0.0)
        return Length(value_um=value_um, expanded_um=expanded_um, status="evaluated")

    @property
    def step_nominal_um(self) -> float:
        """Nominal height of the step, um."""
        if self.blocks:
            return abs(self.blocks[0].nominal_um - self.blocks[1].nominal_um)
        return self.nominal_um or 0.0

    @property
    def serials(self) -> tuple[str, ...]:
        """Serial numbers of the blocks, in order."""
        return tuple(sorted(block.serial_number for block in self.blocks) or sorted(self.serial_numbers))

    @property
    def variation(self) -> float | None:
        """Permitted variation in length of each block over its face, um; None if neither it nor a grade is known."""
        if self.variation_um is not None or self.grade is None:
            return self.variation_um
        return VARIATION_UM[self.grade]

    def _require_two_blocks(self) -> None:
        if len(self.blocks) != 2:
            self._wrong(f"names {len(self.blocks)} blocks and a step lies between two")
        for block in self.blocks:
            if block.expanded_um is None:
                self._wrong(f"gives no U (expanded_um, k = 2) of block {block.serial_number}: {WITHOUT}")
        if self.value_um is not None or self.expanded_um is not None or self.serial_numbers or self.nominal_um:
            self._wrong("gives both a step and two blocks: leave one of them out")
        if self.blocks[0].nominal_um == self.blocks[1].nominal_um:
            self._wrong(f"names two blocks of {self.blocks[0].nominal_um:g} um, which make no step")
        if self.grade and self.variation_um is None and max(b.nominal_um for b in self.blocks) > LONGEST_UM:
            self._wrong("is of blocks over 10 mm: give their variation_um, because the grade alone does not limit it")

    def _require_a_step(self) -> None:
        if self.value_um is None or self.nominal_um is None:
            self._wrong("gives no step: it needs nominal_um, value_um and expanded_um, or two blocks")
        if self.expanded_um is None:
            self._wrong(f"gives no U (expanded_um, k = 2): {WITHOUT}")
        if not any(self.serial_numbers):
            self._wrong("gives no serial_numbers: name the blocks that it certifies")

    def _wrong(self, how: str) -> None:
        raise self.error(f"Certificate {self.number!r} {how}.")


class GaugeTerms(Spec, frozen=True, kw_only=True):
    """Conditions of a check: largest permitted error, temperature of the blocks, tolerance of the product.

    interval_days: days until the next check is due; least_repeats: fewer scans get no verdict. None: not given, and
    whatever depends on it is not evaluated.
    """

    error: ClassVar[type[WaferViewerError]] = MeasureError
    limit_um: Annotated[Positive | None, Setting("Limit, ± µm", "Largest error allowed, on either side")] = None
    temperature_c: Annotated[
        Annotated[float, Within(0, 50)] | None, Setting("Blocks, °C", "Temperature of the blocks")
    ] = None
    u_temperature_c: Annotated[NonNegative, Label("Uncertainty of temperature")] = 0.5
    tolerance_um: Annotated[Positive | None, Setting("Tolerance, µm", "Upper limit less lower of the product")] = None
    interval_days: Annotated[int, Within(1, 3660), Setting("Next in, days", "Days until the next check is due")] = 30
    least_repeats: Annotated[Count, Setting("Least scans", "Scans of the blocks that a verdict takes")] = 1


class GaugeRepeat(Spec, frozen=True, kw_only=True):
    """The step measured in one scan of the blocks.

    surface: mark of the frames that the surface was made from; show: 0 for the stitched surface, else the number of a
    field; not_evaluated: contributions missing from the budget of this step.
    """

    error: ClassVar[type[WaferViewerError]] = MeasureError
    dataset: str
    taken: str = ""
    surface: str = ""
    show: int = 0
    upper: Region
    lower: Region
    height: Length
    definition: str = ""
    not_evaluated: tuple[str, ...] = ()
    calibration: Calibration | None = None
    simulated: bool = False

    def is_scan_of(self, other: GaugeRepeat) -> bool:
        """Return whether both were measured in the same scan, which is not a repeat."""
        named = bool(self.taken) and (self.dataset, self.taken) == (other.dataset, other.taken)
        return named or (bool(self.surface) and self.surface == other.surface)


class GaugeLine(Contribution, frozen=True, kw_only=True):
    """One line of a check's budget: a standard uncertainty (k = 1) in um and its scope."""

    of: Role


class GaugeCheck(MeasurementResult, frozen=True, kw_only=True, tag="gauge_check"):
    """A step measured against certified gauge blocks: error with U, En, and verdict by guard band.

    height: x, the mean of the repeats; its U contains nothing from the certificate. reference: the certified step at
    the temperature of the blocks; its U contains that of the certificate and the variation in length. deviation: x
    minus reference; its U (of the comparison) excludes the z scale, because the check is meant to detect a scale error
    (ISO 14253-5). s_um, range_um: of the repeats. signed_by and at are empty until the check is signed.
    """

    input_fields: ClassVar[tuple[str, ...]] = ("upper", "lower")
    main_fields: ClassVar[tuple[str, ...]] = ("deviation",)
    certificate: Certificate
    terms: GaugeTerms = GaugeTerms()
    repeats: tuple[GaugeRepeat, ...]
    upper: Region
    lower: Region
    height: Length
    reference: Annotated[Length, Label("Certificate at this temperature")]
    deviation: Annotated[Length, Label("Error", signed=True)]
    s_um: Annotated[NonNegative | None, Label("s")] = None
    range_um: NonNegative | None = None
    en: Annotated[float | None, Label("En")] = None
    verdict: Annotated[Word, UNLISTED]
    why: Annotated[str, UNLISTED]
    en_why: Annotated[str, Label("What En says")] = ""
    budget: Annotated[tuple[GaugeLine, ...], UNLISTED] = ()
    not_evaluated: Annotated[tuple[str, ...], UNLISTED] = ()
    signed_by: str = ""
    at: Annotated[str, Label("Signed at")] = ""

    @property
    def n(self) -> int:
        """Number of repeats."""
        return len(self.repeats)


class GaugeRecord(Spec, frozen=True, kw_only=True):
    """One line of ``gauge-checks.jsonl``: a signed check with all its numbers."""

    error: ClassVar[type[WaferViewerError]] = MeasureError
    check: GaugeCheck
    rig: str = ""
    result: str = ""
    software_version: str = ""


class ScaleCorrection(Spec, frozen=True, kw_only=True):
    """A proposed z scale with which the mean of the repeats equals the certified value.

    factor: certified over measured. changes_um: resulting change of the checked step. advice: a sentence on whether the
    correction is worthwhile.
    """

    error: ClassVar[type[WaferViewerError]] = MeasureError
    calibration: Calibration
    factor: Positive
    changes_um: float
    advice: str


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


K_OF_TRIALS = {2: 0.8862, 3: 0.5908, 4: 0.4857, 5: 0.4299}
"""1 / d2 by number of trials: factor from their mean range to their standard deviation."""
Effect = Literal["part", "appraiser", "part x appraiser", "repeatability"]
EFFECTS: tuple[Effect, ...] = ("part", "appraiser", "part x appraiser", "repeatability")


class AnovaRow(Spec, frozen=True, kw_only=True):
    """A line of the analysis of variance: degrees of freedom, sum of squares, and the F test; no F without a test."""

    error: ClassVar[type[WaferViewerError]] = MeasureError
    effect: Effect
    freedom: int
    sum_of_squares: NonNegative
    f: NonNegative | None = None
    p: Fraction | None = None

    @property
    def mean_square(self) -> float:
        """Sum of squares over its degrees of freedom; 0 without any."""
        return self.sum_of_squares / self.freedom if self.freedom else 0.0


class Interval(Spec, frozen=True, kw_only=True):
    """Two-sided 95 % confidence limits of a standard deviation."""

    error: ClassVar[type[WaferViewerError]] = MeasureError
    low: NonNegative
    high: NonNegative


GaugeWord = Literal["acceptable", "acceptable for some uses", "not acceptable"]
GOOD, MARGINAL, LEAST_CATEGORIES = 0.10, 0.30, 5
"""AIAG limits: %GRR of an acceptable and of a marginal gauge, and the least number of distinct categories."""
Q_MP = 0.30
"""VDA 5: largest ratio of twice the expanded uncertainty of the measuring process to the tolerance."""


class GaugeRR(Spec, frozen=True, kw_only=True):
    """A gauge R&R study after AIAG's MSA; all deviations are standard deviations in the unit of the values.

    `repeatability`: equipment variation; `reproducibility`: appraiser variation, including the interaction of
    appraisers and parts, `interaction_variation`, None with one appraiser; `gauge_rr`: both combined; `part_variation`;
    `total_variation`: all combined. `interaction_p`: p value of the interaction (ANOVA only); only an insignificant
    interaction is pooled into repeatability, and its variation is 0 then. Both are None where there is no interaction
    to test. anova: the table, and `repeatability_limits`, `gauge_rr_limits` and `part_limits` by it: None by range.
    """

    error: ClassVar[type[WaferViewerError]] = MeasureError
    method: Method
    parts: int
    appraisers: int
    trials: int
    repeatability: NonNegative
    reproducibility: NonNegative | None
    gauge_rr: NonNegative
    part_variation: NonNegative
    total_variation: NonNegative
    interaction_variation: NonNegative | None = None
    interaction_p: Fraction | None = None
    repeatability_limits: Interval | None = None
    gauge_rr_limits: Interval | None = None
    part_limits: Interval | None = None
    anova: tuple[AnovaRow, ...] = ()
    tolerance: Positive | None = None
    notes: tuple[str, ...] = ()

    @property
    def deviations(self) -> tuple[tuple[str, float, Interval | None], ...]:
        """Title, standard deviation and limits of all that was evaluated."""
        each = (
            ("Repeatability, EV", self.repeatability, self.repeatability_limits),
            ("Reproducibility, AV", self.reproducibility, None),
            ("of it parts with appraisers, INT", self.interaction_variation, None),
            ("Gauge R&R", self.gauge_rr, self.gauge_rr_limits),
            ("Part variation, PV", self.part_variation, self.part_limits),
            ("Total variation, TV", self.total_variation, None),
        )
        return tuple((title, s, limits) for title, s, limits in each if s is not None)

    @property
    def share_of_variation(self) -> float:
        """Gauge R&R as a fraction of the total variation (%GRR / 100); NaN if nothing varies."""
        return self.gauge_rr / self.total_variation if self.total_variation else float("nan")

    @property
    def share_of_tolerance(self) -> float | None:
        """Six standard deviations of the gauge as a fraction of the tolerance; None without a tolerance."""
        return 6 * self.gauge_rr / self.tolerance if self.tolerance else None

    @property
    def q_mp(self) -> float | None:
        """Twice the expanded uncertainty by gauge R&R alone, k = 2, as a fraction of the tolerance (VDA 5)."""
        return 2 * COVERAGE_FACTOR * self.gauge_rr / self.tolerance if self.tolerance else None

    @property
    def distinct_categories(self) -> int:
        """Number of distinct categories (ndc) that the gauge can resolve among these parts; 0 if none."""
        return int(1.41 * self.part_variation / self.gauge_rr) if self.gauge_rr else 0

    @property
    def word(self) -> GaugeWord | None:
        """Verdict by AIAG's limits on the shares of variation and tolerance and on ndc; None if nothing varies."""
        if not self.total_variation:
            return None
        worst = max(self.share_of_variation, self.share_of_tolerance or 0.0)
        if worst <= GOOD and self.distinct_categories >= LEAST_CATEGORIES:
            return "acceptable"
        return "acceptable for some uses" if worst <= MARGINAL else "not acceptable"

    @property
    def why(self) -> str:
        """Sentence with the numbers that the verdict goes by."""
        if self.word is None:
            return "All values are the same: there is nothing to compare."
        of_tolerance, q_mp = self.share_of_tolerance, self.q_mp
        n = self.distinct_categories
        text = f"Gauge R&R is {_percent(self.share_of_variation)} of the total variation"
        if of_tolerance is not None:
            text += f" and {_percent(of_tolerance)} of the tolerance (six deviations)"
        text += f"; {n} distinct categor{'y' if n == 1 else 'ies'}."
        if q_mp is None:
            return text
        fit = "fit" if q_mp <= Q_MP else "not fit"
        return f"{text} VDA 5: Q_MP {_percent(q_mp)}, {fit} for this tolerance (30 %), by gauge R&R alone."


def _percent(share: float) -> str:
    return f"{100 * share:.1f} %"


class ChartPoint(Spec, frozen=True, kw_only=True):
    """One signed check: time (ISO 8601), error with U, verdict and the chart rules that it violates."""

    error: ClassVar[type[WaferViewerError]] = MeasureError
    at: str
    value: Length
    verdict: Word
    signed_by: str = ""
    breaks: tuple[str, ...] = ()


class RunChart(Spec, frozen=True, kw_only=True):
    """Individuals chart of the errors of one pair of blocks, oldest first; lengths in um.

    s_um: from moving ranges (mean range / 1.128); low_um, high_um: control limits, mean -+ 3 s; all None with too few
    points. drift_um_per_day: with U. due: day of the next check, ISO 8601. warnings, notes: sentences.
    """

    error: ClassVar[type[WaferViewerError]] = MeasureError
    points: tuple[ChartPoint, ...]
    mean_um: float
    s_um: NonNegative | None = None
    low_um: float | None = None
    high_um: float | None = None
    limit_um: Positive | None = None
    drift_um_per_day: Length | None = None
    due: str = ""
    warnings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


class Capability(Spec, frozen=True, kw_only=True):
    """Cg and Cgk of the repeats of one pair of blocks; None with too few repeats. variant: the formulas used."""

    error: ClassVar[type[WaferViewerError]] = MeasureError
    n: int
    tolerance_um: Positive
    mean_um: float
    s_um: NonNegative | None
    cg: float | None
    cgk: float | None
    capable: bool | None
    why: str
    variant: str = ""


class ProcessCapability(Spec, frozen=True, kw_only=True):
    """Cp and Cpk of a process against its limits, with two-sided 95 % confidence limits.

    cp: None where a side is open. beyond: values outside the limits; expected_beyond: their share by a normal
    distribution. cpk_limits may be negative, as Cpk is where the mean lies beyond a limit.
    """

    error: ClassVar[type[WaferViewerError]] = MeasureError
    n: int
    mean: float
    s: Positive
    lower: float | None
    upper: float | None
    cp: Positive | None
    cp_limits: Interval | None
    cpk: float
    cpk_limits: tuple[float, float]
    beyond: int
    expected_beyond: Fraction

    @property
    def word(self) -> Literal["capable", "not shown", "not capable"]:
        """Verdict on Cpk against 1.33: by its confidence limits, "not shown" where they lie on both sides."""
        low, high = self.cpk_limits
        return "capable" if low >= CAPABLE else "not capable" if high < CAPABLE else "not shown"


CAPABLE = 1.33
"""Least Cpk of a capable process, and least Cg and Cgk of a capable gauge."""
