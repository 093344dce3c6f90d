"""Report on several inspections as one page, and its numbers as tables for people and programs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from wafer_viewer.draw.charts.defect_charts import pareto_svg
from wafer_viewer.draw.charts.lot_charts import CLASS_NAMES, density_chart_svg, stack_map_svg
from wafer_viewer.draw.number_format import plural
from wafer_viewer.model.inspection.lot import PARETO_BY, LotStatistics, StatisticsRow, WaferComparison, WaferDefects
from wafer_viewer.model.report import Figure, Report, ReportSection, Table
from wafer_viewer.model.spec import replace
from wafer_viewer.store.records.conformance_reports import write_report

HEADS = ("Item", "Quantity", "Value", "Limits", "Unit", "Remark")
_RIGHT = "w nnw "
"""Columns of numbers and of texts without breaks."""
MOST_ROWS = 40
"""Maximum number of rows of a table; CSV and JSON have all."""


def write_lot_report(statistics: LotStatistics, stack: WaferDefects, path: Path) -> Path:
    """Write the page of a lot as HTML or PDF. Raises DatasetError for another ending, or if it fails."""
    write_report(lot_page(statistics, stack), path)
    return path


def lot_page(statistics: LotStatistics, stack: WaferDefects) -> Report:
    """Return the page: control chart, yield, Pareto charts, kill ratios and the stack."""
    n_defects = sum(wafer.defects for wafer in statistics.wafers)
    return Report(
        title=f"Defects of {plural(len(statistics.wafers), 'wafer')}",
        below=f"{plural(n_defects, 'defect')}; {_out_of_control(statistics)}",
        simulated=statistics.simulated,
        facts=(("Good dies", statistics.good_by),) if statistics.good_by else (),
        sections=(
            _section("Density", "density", statistics.rows, _chart(statistics)),
            _section("Yield", "yield", statistics.rows, empty="No yield: its limits or test results are not given."),
            *(
                _section(f"Pareto by {by}", f"pareto by {by}", statistics.rows, _pareto(statistics, k))
                for k, by in enumerate(PARETO_BY)
            ),
            _section("Kill ratio", "kill ratio", statistics.rows, empty="No kill ratio: there are no test results."),
            _section("Signatures", "signatures", statistics.rows, empty="No signature that chance does not explain."),
            ReportSection("Stack", figures=tuple(_stack(stack)), empty="There are no dies to stack."),
            ReportSection("Notes", sentences=(*statistics.notes, *stack.notes), empty="None."),
        ),
    )


def write_adders_report(found: WaferComparison, second: WaferDefects, path: Path) -> Path:
    """Write the page of two inspections as HTML or PDF. Raises DatasetError for another ending, or if it fails."""
    write_report(adders_page(found, second), path)
    return path


def adders_page(found: WaferComparison, second: WaferDefects) -> Report:
    """Return the page: numbers, added defects on a map, and the lists."""
    added = replace(second, defects=tuple(defect for defect in second.defects if defect.number in {*found.added}))
    svg = stack_map_svg(added)
    figures = iter((Figure("", "Added defects.", svg=svg),) if svg else ())
    lists = dict.fromkeys(row.table for row in found.listed)
    return Report(
        title=f"Adders from {found.first} to {found.second}",
        below=f"{len(found.added)} added, {len(found.removed)} removed, {len(found.common)} common",
        simulated=found.simulated,
        facts=(("Compared by", found.dies),),
        sections=(
            _section("Defects", "adders", found.rows, figures),
            *(_section(name.capitalize(), name, found.listed) for name in lists),
            ReportSection("Notes", sentences=found.notes, empty="None."),
        ),
    )


def _out_of_control(statistics: LotStatistics) -> str:
    outside = [f"{wafer.title} ({wafer.outside})" for wafer in statistics.outside]
    return f"out of control: {'; '.join(outside)}" if outside else "no wafer is out of control"


def _section(
    title: str, table: str, rows: Sequence[StatisticsRow], figures: Iterator[Figure] = iter(()), empty: str = "None."
) -> ReportSection:
    """Return a section with the rows of one table, and how many are left out."""
    own = [row for row in rows if row.table == table]
    left_out = (f"{len(own) - MOST_ROWS} more rows are in the CSV and the JSON.",) if len(own) > MOST_ROWS else ()
    drawn = tuple(figures) if own else ()
    return ReportSection(title, table=_table(own[:MOST_ROWS]), figures=drawn, sentences=left_out, empty=empty)


def _table(rows: Sequence[StatisticsRow]) -> Table:
    """Return the columns in which any row has a text."""
    cells = [tuple(text.replace(" um", "\u202fµm").replace("mm2", "mm²") for text in row_cells(row)) for row in rows]
    used = [k for k in range(len(HEADS)) if any(row[k] for row in cells)]
    right = "".join(_RIGHT[k] for k in used)
    return Table(tuple(HEADS[k] for k in used), tuple(tuple(row[k] for k in used) for row in cells), right)


def row_cells(row: StatisticsRow) -> tuple[str, ...]:
    """Return item, quantity, value, limits, unit and remark of a row as text."""
    value, low, high = ("" if number is None else f"{number:.4g}" for number in (row.value, row.low, row.high))
    limits = f"{low or '-'} to {high or '-'}" if low or high else ""
    return row.item, row.quantity, value, limits, row.unit, row.remark


def _chart(statistics: LotStatistics) -> Iterator[Figure]:
    if statistics.per_mm2 is not None:
        caption = "Defects per mm² of each wafer in the order given; dashed: control limits by Poisson; line: mean."
        yield Figure("", caption, svg=density_chart_svg(statistics.wafers, statistics.per_mm2))


def _pareto(statistics: LotStatistics, k: int) -> Iterator[Figure]:
    by = PARETO_BY[k]
    if by == "class" and (bars := statistics.bars(by)):
        svg = pareto_svg(CLASS_NAMES.get(bar.name, bar.name) for bar in bars for _ in range(bar.count))
        yield Figure("", "Defects by class; at the right the share of all up to each.", svg=svg)


def _stack(stack: WaferDefects) -> Iterator[Figure]:
    if svg := stack_map_svg(stack):
        yield Figure("", "Defects of all wafers at their places on the dies of the first.", svg=svg)
