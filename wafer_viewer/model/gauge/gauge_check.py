"""Checks against certified gauge blocks: the certificate, each repeat, what came out, and the record that is signed.

x is what was measured, the mean of the repeats; the reference is the certified step between two blocks. The error is
x less the reference. En judges the U that is claimed for x, the verdict judges the error.
"""

from __future__ import annotations

import datetime
import math
from typing import Annotated, ClassVar, Literal

from wafer_viewer.model.acquisition.calibration import Calibration
from wafer_viewer.model.decision_rule import Word
from wafer_viewer.model.errors import MeasureError, WaferViewerError
from wafer_viewer.model.measurement.measurement import MeasurementResult
from wafer_viewer.model.quantity import Length, Quantity
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import NonNegative, Positive, Spec, Within

Grade = Literal["K", "0", "1", "2"]
VARIATION_UM: dict[Grade, float] = {"K": 0.05, "0": 0.10, "1": 0.16, "2": 0.30}
"""Largest variation in length of a gauge block of up to 10 mm, ISO 3650."""
LONGEST_UM = 10_000.0
"""Of the blocks that the variations above are of."""
WITHOUT = "without it there is nothing to check against"
Role = Literal["scale", "measurement", "reference"]
"""What a line of the budget belongs to: to U of x alone, to U of x and of the error, or to U of the reference."""


class GaugeBlock(Spec, frozen=True, kw_only=True):
    """One block of a certificate: its certified length with U (k = 2)."""

    error: ClassVar[type[WaferViewerError]] = MeasureError
    serial_number: str
    nominal_um: Positive
    value_um: Positive
    expanded_um: Positive | None = None


class Certificate(Spec, frozen=True, kw_only=True):
    """What a laboratory certifies of a step: the step itself, or two blocks of which it is the difference; at 20 C.

    expanded_um: U (k = 2); there is no check without it. grade or variation_um: how far a block's length may vary over
    its face. expansion_per_k: of the blocks' steel as ISO 3650 has it. note: for people, as that it is an example.
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
        """The certified step with its U."""
        value_um, expanded_um = self.value_um or 0.0, self.expanded_um
        if self.blocks:
            first, second = self.blocks
            value_um = abs(first.value_um - second.value_um)
            expanded_um = math.hypot(first.expanded_um or 0.0, second.expanded_um or 0.0)
        return Length(value_um=value_um, expanded_um=expanded_um, status="evaluated")

    @property
    def step_nominal_um(self) -> float:
        """What the step is called."""
        if self.blocks:
            return abs(self.blocks[0].nominal_um - self.blocks[1].nominal_um)
        return self.nominal_um or 0.0

    @property
    def serials(self) -> tuple[str, ...]:
        """The serial numbers of the blocks, in order."""
        return tuple(sorted(block.serial_number for block in self.blocks) or sorted(self.serial_numbers))

    @property
    def variation(self) -> float | None:
        """How far the length of each block may vary over its face, um; None where neither it nor a grade is known."""
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
            self._wrong("is of blocks over 10 mm: give their variation_um, because the grade alone does not say it")

    def _require_a_step(self) -> None:
        if self.value_um is None or self.nominal_um is None:
            self._wrong("gives no step: it needs nominal_um, value_um and expanded_um, or two blocks")
        if self.expanded_um is None:
            self._wrong(f"gives no U (expanded_um, k = 2): {WITHOUT}")
        if not any(self.serial_numbers):
            self._wrong("gives no serial_numbers: what blocks it is of must be told")

    def _wrong(self, how: str) -> None:
        raise self.error(f"Certificate {self.number!r} {how}.")


class GaugeTerms(Spec, frozen=True, kw_only=True):
    """What a check is made under: the largest error allowed, the blocks' temperature, the product's tolerance.

    interval_days: the next check is due after them. None: not said, and what needs it is not evaluated.
    """

    error: ClassVar[type[WaferViewerError]] = MeasureError
    limit_um: Positive | None = None
    temperature_c: Annotated[float, Within(0, 50)] | None = None
    u_temperature_c: NonNegative = 0.5
    tolerance_um: Positive | None = None
    interval_days: Annotated[int, Within(1, 3660)] = 30


class GaugeRepeat(Spec, frozen=True, kw_only=True):
    """The step in one scan of the blocks; surface: the mark of the frames that its surface was made of.

    show: 0 the stitched surface, else the number of a field; not_evaluated: what the budget of this step leaves out.
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
        """Whether both were measured in one scan: that is no repeat."""
        named = bool(self.taken) and (self.dataset, self.taken) == (other.dataset, other.taken)
        return named or (bool(self.surface) and self.surface == other.surface)


class GaugeLine(Spec, frozen=True, kw_only=True):
    """One line of a check's budget: a standard uncertainty (k = 1) in um, and of what it is."""

    error: ClassVar[type[WaferViewerError]] = MeasureError
    name: str
    u_um: NonNegative
    of: Role


class GaugeCheck(MeasurementResult, frozen=True, kw_only=True, tag="gauge_check"):
    """A step against certified gauge blocks: the error with its U, En, and the verdict by the guard band.

    height: x, the mean of the repeats, with U of x, which has nothing of the certificate in it. reference: the
    certified step at the blocks' temperature; its U holds the certificate's and the variation in length. error_of:
    x less reference; its U (of the comparison) has no z scale in it, for an error of the scale is what is looked for
    (ISO 14253-5). s_um and range_um: of the repeats. signed_by and at are empty until somebody signs.
    """

    certificate: Certificate
    terms: GaugeTerms = GaugeTerms()
    repeats: tuple[GaugeRepeat, ...]
    upper: Region
    lower: Region
    height: Length
    reference: Length
    deviation: Length
    s_um: NonNegative | None = None
    range_um: NonNegative | None = None
    en: float | None = None
    verdict: Word
    why: str
    en_why: str = ""
    budget: tuple[GaugeLine, ...] = ()
    not_evaluated: tuple[str, ...] = ()
    signed_by: str = ""
    at: str = ""

    @property
    def main(self) -> Quantity:
        """The error."""
        return self.deviation.quantity

    @property
    def n(self) -> int:
        """How many scans it is the mean of."""
        return len(self.repeats)


class GaugeRecord(Spec, frozen=True, kw_only=True):
    """One line of ``gauge-checks.jsonl``: a signed check with all its numbers."""

    error: ClassVar[type[WaferViewerError]] = MeasureError
    check: GaugeCheck
    rig: str = ""
    result: str = ""
    software_version: str = ""


class ScaleCorrection(Spec, frozen=True, kw_only=True):
    """What a check offers: the z scale set so that the mean of its repeats is what is certified.

    factor: certified over measured. changes_um: by how much the checked step would read otherwise. advice: whether it
    is worth it, a sentence.
    """

    error: ClassVar[type[WaferViewerError]] = MeasureError
    calibration: Calibration
    factor: Positive
    changes_um: float
    advice: str
