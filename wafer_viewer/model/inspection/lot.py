"""Statistics over several inspections: defects of a wafer in one form, and the results computed from them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import Any, ClassVar, Literal

from wafer_viewer.model.acquisition.sample import Alignment, Notch, Sample
from wafer_viewer.model.errors import MeasureError, WaferViewerError
from wafer_viewer.model.inspection.defect import Defect, Inspection
from wafer_viewer.model.inspection.die_grid import DieGrid, DieStatus
from wafer_viewer.model.inspection.klarf import Klarf, KlarfDefect
from wafer_viewer.model.region import Point
from wafer_viewer.model.spec import Count, Fraction, NonNegative, Spec

SAME_PITCH = 5e-3
"""Relative pitch difference above which dies are of different products."""
UM2_PER_MM2 = 1e6
_NOTCHES: dict[str, Notch] = {"DOWN": "down", "LEFT": "left", "UP": "up", "RIGHT": "right"}


class WaferDefect(Spec, frozen=True, kw_only=True):
    """A defect of one inspection, from an own file or a KLARF.

    kind: title of its class; (x_um, y_um): centre, in the coordinates of the wafer's lattice; die: "col,row", empty
    outside of dies; length_um, width_um, angle_deg: of its outline, the length anticlockwise from x; resolved: False if
    its size is not known; u_um: standard uncertainty (k = 1) of its centre by the edges of its outline.
    """

    error: ClassVar[type[WaferViewerError]] = MeasureError
    number: int
    kind: str
    x_um: float
    y_um: float
    die: str = ""
    length_um: NonNegative = 0.0
    width_um: NonNegative = 0.0
    angle_deg: float = 0.0
    resolved: bool = True
    u_um: NonNegative = 0.0


class WaferDefects(Spec, frozen=True, kw_only=True):
    """Defects of one inspected wafer, without nuisances, and its dies.

    name: of the file; center: of the wafer, None if not known; inspected_mm2: 0 if not known; max_per_die: largest
    number of defects of a good die, None without a limit.
    """

    error: ClassVar[type[WaferViewerError]] = MeasureError
    name: str
    lot: str = ""
    wafer: str = ""
    product: str = ""
    notch: Notch = "none"
    center: Point | None = None
    grid: DieGrid | None = None
    dies: tuple[DieStatus, ...] = ()
    defects: tuple[WaferDefect, ...] = ()
    inspected_mm2: NonNegative = 0.0
    max_per_die: int | None = None
    simulated: bool = False
    notes: tuple[str, ...] = ()

    @property
    def title(self) -> str:
        """Wafer with its lot, else the name of the file."""
        return " ".join(filter(None, (self.lot, self.wafer))) if self.wafer else self.name

    @property
    def inspected_dies(self) -> tuple[DieStatus, ...]:
        """Dies that were scanned and inspected completely."""
        return tuple(die for die in self.dies if die.state == "whole" and die.defects is not None)

    @classmethod
    def of(
        cls, inspection: Inspection, name: str, sample: Sample = Sample(), alignment: Alignment | None = None
    ) -> WaferDefects:
        """Return the defects of an own inspection in stage um, without nuisances and unmeasured areas."""
        titles = inspection.recipe.class_table
        counted = (defect for defect in inspection.found if defect.judgement != "nuisance")
        x_um, y_um = alignment.to_stage(0.0, 0.0) if alignment is not None else (0.0, 0.0)
        return cls(
            name=name,
            lot=sample.lot,
            wafer=sample.wafer_id,
            product=inspection.product or sample.product,
            notch=sample.notch,
            center=Point(x_um=x_um, y_um=y_um) if alignment is not None else None,
            grid=inspection.grid,
            dies=inspection.dies,
            defects=tuple(_of_own(defect, titles[defect.seen_as].title) for defect in counted),
            inspected_mm2=inspection.inspected_mm2,
            max_per_die=inspection.recipe.limits.max_per_die,
            simulated=inspection.simulated,
            notes=inspection.notes,
        )

    @classmethod
    def of_klarf(cls, klarf: Klarf, name: str) -> WaferDefects:
        """Return the defects of a KLARF in um from the wafer's centre; the dies of its test plan were inspected.

        Its rough bins are not interpreted. Without an inspected area, that of the dies at their pitch is taken.
        """
        grid = klarf.grid
        on = Counter((defect.col, defect.row) for defect in klarf.defects)
        states = ((col, row, on[col, row]) for col, row in klarf.dies)
        dies = tuple(
            DieStatus(name=grid.name(col, row), col=col, row=row, state="whole", measured_fraction=1.0, defects=n)
            for col, row, n in states
        )
        by_pitch = len(dies) * klarf.pitch_x_um * klarf.pitch_y_um
        area = () if klarf.inspected_um2 else (f"{name} states no inspected area: that of its dies is taken.",)
        center = Point(x_um=0.0, y_um=0.0) if klarf.center_x_um or klarf.center_y_um else None
        return cls(
            name=name,
            lot=klarf.lot,
            wafer=klarf.wafer,
            product=klarf.device,
            notch=_NOTCHES.get(klarf.notch.upper(), "none"),
            center=center,
            grid=grid,
            dies=dies,
            defects=tuple(_of_klarf(defect, grid) for defect in klarf.defects),
            inspected_mm2=(klarf.inspected_um2 or by_pitch) / UM2_PER_MM2,
            simulated=klarf.simulated,
            notes=(*klarf.notes, *(area if dies else ())),
        )


def _of_own(defect: Defect, title: str) -> WaferDefect:
    return WaferDefect(
        number=defect.number,
        kind=title,
        x_um=defect.center.x_um,
        y_um=defect.center.y_um,
        die=defect.die,
        length_um=defect.major.value_um,
        width_um=defect.minor.value_um,
        angle_deg=defect.angle_deg,
        resolved=defect.size_resolved,
        u_um=(defect.major.u or 0.0) / 2,  # of the mean of two edges, where that of their difference is twice as large
    )


def _of_klarf(defect: KlarfDefect, grid: DieGrid) -> WaferDefect:
    x_um, y_um = grid.to_stage(defect.col, defect.row, defect.u_um, defect.v_um)
    width, height = defect.width_um or defect.size_um, defect.height_um or defect.size_um
    return WaferDefect(
        number=defect.number,
        kind=defect.class_name or f"Class {defect.class_number}",
        x_um=float(x_um),
        y_um=float(y_um),
        die=grid.name(defect.col, defect.row),
        length_um=max(width, height),
        width_um=min(width, height),
        angle_deg=0.0 if width >= height else 90.0,
        resolved=bool(width and height),
    )


# -------------------------------------------------------------------------------------------------------------- results


class StatisticsRow(Spec, frozen=True, kw_only=True):
    """A line of the table of a lot: table that it belongs to, item, quantity, value and limits in a unit.

    value, low and high are None where they are not known; remark: what is to be said of it.
    """

    table: str
    item: str
    quantity: str
    value: float | None = None
    low: float | None = None
    high: float | None = None
    unit: str = ""
    remark: str = ""


class Proportion(Spec, frozen=True, kw_only=True):
    """A number of dies out of all, with the 95 % confidence limits of its share; without dies they are 0 and 1."""

    error: ClassVar[type[WaferViewerError]] = MeasureError
    n: int
    total: int
    low: Fraction
    high: Fraction

    @property
    def value(self) -> float | None:
        """The share; None without dies."""
        return self.n / self.total if self.total else None


ParetoBy = Literal["class", "size", "die"]
PARETO_BY: tuple[ParetoBy, ...] = ("class", "size", "die")


class ParetoBar(Spec, frozen=True, kw_only=True):
    """A class, size class or die: number of defects, share of all, and share of all up to it."""

    by: ParetoBy
    name: str
    count: Count
    share: Fraction
    cumulated: Fraction


class WaferDensity(Spec, frozen=True, kw_only=True):
    """Defect density of a wafer, the control limits for its area, and its good dies.

    per_mm2, low_per_mm2, high_per_mm2: None without an inspected area; outside: side on which it is out of control.
    """

    error: ClassVar[type[WaferViewerError]] = MeasureError
    name: str
    title: str
    defects: int
    inspected_mm2: NonNegative
    per_mm2: NonNegative | None = None
    low_per_mm2: NonNegative | None = None
    high_per_mm2: NonNegative | None = None
    outside: Literal["", "above", "below"] = ""
    good: Proportion | None = None


class KillRatio(Spec, frozen=True, kw_only=True):
    """Share of the dies that a class of defects kills: 1 - yield of dies with it / yield of dies without it.

    failing_with, failing_without: tested dies that failed, with and without a defect of the class; low, high: 95 %
    confidence limits, None where there is none; loss: share of all tested dies that the class kills.
    """

    error: ClassVar[type[WaferViewerError]] = MeasureError
    kind: str
    failing_with: Proportion
    failing_without: Proportion
    ratio: float | None
    low: float | None = None
    high: float | None = None
    loss: float | None = None


SignatureKind = Literal["cluster", "scratch", "ring", "edge", "center"]


class DefectSignature(Spec, frozen=True, kw_only=True):
    """Defects of a wafer that lie together as they do not by chance.

    numbers: of the defects; center: of a group, or of the wafer for a ring; length_um, width_um, angle_deg: extent of a
    group along its longest axis and across, or outer diameter and width of a ring; expected: number of defects in the
    ring if they lie at random; by_chance: probability of a signature as clear anywhere on the wafer; wafer: its title.
    """

    error: ClassVar[type[WaferViewerError]] = MeasureError
    kind: SignatureKind
    numbers: tuple[int, ...]
    center: Point
    length_um: NonNegative
    width_um: NonNegative
    angle_deg: float = 0.0
    expected: NonNegative | None = None
    by_chance: Fraction
    wafer: str = ""


class LotStatistics(Spec, frozen=True, kw_only=True):
    """Statistics of the inspections of several wafers.

    per_mm2: mean density, from which the control limits follow; dispersion: variance of the numbers of defects over
    that of Poisson, with the probability that chance makes it as large; good: good dies of all wafers; good_by: the
    source of what is good; kill_ratios: empty without test results; signatures: of each wafer, and of all on one.
    """

    error: ClassVar[type[WaferViewerError]] = MeasureError
    wafers: tuple[WaferDensity, ...]
    pareto: tuple[ParetoBar, ...] = ()
    per_mm2: NonNegative | None = None
    dispersion: NonNegative | None = None
    dispersion_by_chance: Fraction | None = None
    good: Proportion | None = None
    good_by: str = ""
    kill_ratios: tuple[KillRatio, ...] = ()
    signatures: tuple[DefectSignature, ...] = ()
    simulated: bool = False
    notes: tuple[str, ...] = ()

    @property
    def outside(self) -> tuple[WaferDensity, ...]:
        """Wafers whose density is out of control."""
        return tuple(wafer for wafer in self.wafers if wafer.outside)

    def bars(self, by: ParetoBy) -> tuple[ParetoBar, ...]:
        """Return the Pareto chart by class, size or die."""
        return tuple(bar for bar in self.pareto if bar.by == by)

    @property
    def rows(self) -> tuple[StatisticsRow, ...]:
        """All numbers, as lines of one table."""
        return (
            *self._density_rows(),
            *self._yield_rows(),
            *self._pareto_rows(),
            *self._kill_rows(),
            *self._signature_rows(),
        )

    def _signature_rows(self) -> Iterator[StatisticsRow]:
        for one in self.signatures:
            extent = f"{one.length_um:.4g} x {one.width_um:.4g} um at x {one.center.x_um:.1f}, y {one.center.y_um:.1f}"
            expected = "" if one.expected is None else f", {one.expected:.3g} expected"
            remark = f"by chance {one.by_chance:.2g}; {extent}{expected}"
            yield StatisticsRow(
                table="signatures", item=one.wafer, quantity=one.kind, value=len(one.numbers), remark=remark
            )

    def _density_rows(self) -> Iterator[StatisticsRow]:
        for wafer in self.wafers:
            limits: dict[str, Any] = {"low": wafer.low_per_mm2, "high": wafer.high_per_mm2}
            remark = f"{wafer.outside} the control limits" if wafer.outside else ""
            area = f"{wafer.defects} on {wafer.inspected_mm2:.4g} mm2"
            density: dict[str, Any] = {
                "value": wafer.per_mm2,
                "unit": "1/mm2",
                "remark": "; ".join(filter(None, (area, remark))),
            }
            yield StatisticsRow(table="density", item=wafer.title, quantity="defects per mm2", **density, **limits)
        yield StatisticsRow(table="density", item="lot", quantity="mean", value=self.per_mm2, unit="1/mm2")
        if self.dispersion is not None:
            chance = f"by chance {self.dispersion_by_chance:.2g}"
            spread: dict[str, Any] = {
                "quantity": "variance over that of Poisson",
                "value": self.dispersion,
                "remark": chance,
            }
            yield StatisticsRow(table="density", item="lot", **spread)

    def _yield_rows(self) -> Iterator[StatisticsRow]:
        for title, good in (*((wafer.title, wafer.good) for wafer in self.wafers), ("lot", self.good)):
            if good is not None:
                yield _share_row("yield", title, "good dies", good)

    def _pareto_rows(self) -> Iterator[StatisticsRow]:
        for bar in self.pareto:
            remark = f"{bar.share:.1%} of all, {bar.cumulated:.1%} up to it"
            yield StatisticsRow(
                table=f"pareto by {bar.by}", item=bar.name, quantity="defects", value=bar.count, remark=remark
            )

    def _kill_rows(self) -> Iterator[StatisticsRow]:
        for kill in self.kill_ratios:
            loss = "" if kill.loss is None else f"kills {kill.loss:.2%} of the tested dies"
            limits: dict[str, Any] = {"value": kill.ratio, "low": kill.low, "high": kill.high, "remark": loss}
            yield StatisticsRow(table="kill ratio", item=kill.kind, quantity="kill ratio", **limits)
            yield _share_row("kill ratio", kill.kind, "failing dies with it", kill.failing_with)
            yield _share_row("kill ratio", kill.kind, "failing dies without it", kill.failing_without)


def _share_row(table: str, item: str, quantity: str, share: Proportion) -> StatisticsRow:
    limits: dict[str, Any] = {"value": share.value, "low": share.low, "high": share.high}
    return StatisticsRow(table=table, item=item, quantity=quantity, remark=f"{share.n} of {share.total} dies", **limits)


# --------------------------------------------------------------------------------------------------------------- adders


class CommonDefect(Spec, frozen=True, kw_only=True):
    """A defect that both inspections found: its numbers in both, and the second place minus the first, um."""

    first: int
    second: int
    dx_um: float
    dy_um: float


class WaferComparison(Spec, frozen=True, kw_only=True):
    """Defects of two inspections of one wafer: common, added and removed ones, by their numbers.

    first, second: names of the files. removed, not_inspected_after: numbers of the first inspection; added,
    not_inspected_before: of the second. Defects on dies that the other did not inspect are neither added nor removed.
    offset: median of the places of common defects, second minus first, None without any. by_chance: largest expected
    number of common defects that are coincidence. dies: correspondence of places.
    """

    error: ClassVar[type[WaferViewerError]] = MeasureError
    first: str
    second: str
    common: tuple[CommonDefect, ...] = ()
    added: tuple[int, ...] = ()
    removed: tuple[int, ...] = ()
    not_inspected_before: tuple[int, ...] = ()
    not_inspected_after: tuple[int, ...] = ()
    offset_x_um: float | None = None
    offset_y_um: float | None = None
    by_chance: NonNegative | None = None
    dies: str = ""
    listed: tuple[StatisticsRow, ...] = ()
    simulated: bool = False
    notes: tuple[str, ...] = ()

    @property
    def rows(self) -> tuple[StatisticsRow, ...]:
        """Numbers of defects, and each defect with its class and place."""
        return (*self._counts(), *self.listed)

    def _counts(self) -> Iterator[StatisticsRow]:
        counted = {name: len(getattr(self, name)) for name in ("common", "added", "removed")}
        counted["not inspected before"] = len(self.not_inspected_before)
        counted["not inspected after"] = len(self.not_inspected_after)
        for name, n in counted.items():
            yield StatisticsRow(table="adders", item=name, quantity="defects", value=n)
        yield StatisticsRow(table="adders", item="common by chance", quantity="expected defects", value=self.by_chance)
        for axis, offset in (("x", self.offset_x_um), ("y", self.offset_y_um)):
            yield StatisticsRow(
                table="adders", item="common", quantity=f"median offset {axis}", value=offset, unit="um"
            )
