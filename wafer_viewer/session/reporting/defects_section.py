"""Defects section of a report: scope of the inspection, dies, classes, and the largest defects with pictures."""

from __future__ import annotations

from collections.abc import Iterator

from wafer_viewer.draw.charts.defect_map import defect_map_svg, kinds_text
from wafer_viewer.draw.charts.pareto import pareto_svg
from wafer_viewer.draw.number_format import number
from wafer_viewer.model.inspection.defect import Defect, Inspection
from wafer_viewer.model.inspection.defect_verdict import verdict_of
from wafer_viewer.model.report import PART_TITLES, Figure, Holds, Pairs, ReportSection, Table
from wafer_viewer.session.measurement.measurement_numbers import quantity_text
from wafer_viewer.session.reporting.die_stack_section import repeated, stacked
from wafer_viewer.session.reporting.pictures import place_picture
from wafer_viewer.session.reporting.report_data import Material

MOST_ROWS, MOST_PICTURES = 40, 12
"""Maximum numbers of rows and pictures.

The report gives the number of omitted ones, which the CSV and KLARF contain.
"""
REFERENCES = {"dies": "the median of its dies", "golden": "a stored golden die", "form": "the fitted form"}
HEADS = ("No.", "Class", "Die", "Height, k = 2", "Length", "x, y of the stage, µm", "Judgement")


def defects(material: Material) -> ReportSection:
    """Return the section with counts by class and die, and a table of the largest defects."""
    title, found = PART_TITLES["defects"], material.inspection
    if found is None:
        return ReportSection(title, empty="No defects were looked for.")
    largest = sorted(found.found, key=lambda defect: -defect.area.value)
    return ReportSection(
        title,
        pairs=_inspected(found),
        table=Table(HEADS, tuple(_row(defect) for defect in largest[:MOST_ROWS]), "nwwnnw"),
        figures=tuple(_figures(material, found, largest)),
        sentences=tuple(_sentences(found)),
    )


def defects_held(material: Material) -> Holds:
    """Return the number of defects, and how many of them people judged."""
    found = material.inspection
    if found is None:
        return Holds("not looked for yet", nothing=True)
    judged = sum(defect.judgement != "open" for defect in found.found)
    n = len(found.found)
    return Holds(f"{number(n, 0)} defect{'' if n == 1 else 's'}, {judged} judged")


def _inspected(found: Inspection) -> Pairs:
    expected = found.expected_false_per_mm2
    false = f"{expected:.2g} per mm² expected" if expected is not None else "not known"
    return (
        ("Defects", number(len(found.found), 0)),
        ("Compared with", REFERENCES[found.reference]),
        ("Inspected", f"{found.inspected_mm2:.3g}\u202fmm²; unmeasured {found.unmeasured_mm2:.3g}\u202fmm²"),
        ("Recipe", f"{found.recipe.name}, sensitivity {found.recipe.sensitivity:g}"),
        ("False defects", false),
        ("Limits", _held(found)),
    )


def _held(found: Inspection) -> str:
    """Return the verdict by the limits of the recipe with its reasons, or that no limits are set."""
    if not found.recipe.limits.are_set:
        return "none set"
    verdict = verdict_of(found)
    return f"within, {verdict.counted} counted" if verdict.within else " ".join(("not within.", *verdict.why))


def _row(defect: Defect) -> tuple[str, ...]:
    length = quantity_text(defect.major.quantity) if defect.size_resolved else "not resolved"
    place = f"{number(defect.center.x_um, 1)}, {number(defect.center.y_um, 1)}"
    word = " ".join(part for part in (defect.judgement, defect.judged_by) if part and part != "open")
    height = quantity_text(defect.height.quantity)
    return (f"{defect.number}", defect.seen_as, defect.die, height, length, place, word)


def _figures(material: Material, found: Inspection, largest: list[Defect]) -> Iterator[Figure]:
    """Yield the map of dies, the Pareto chart, and pictures of the largest defects."""
    if dies := defect_map_svg(found):
        yield Figure("", f"Defects on each die: {kinds_text(found.dies)}.", svg=dies)
    if found.found:
        chart = pareto_svg(defect.seen_as for defect in found.found)
        yield Figure("", "Defects by class; at the right the share of all up to each.", svg=chart)
    yield from stacked(material, found)
    info = material.info
    if info is None or not material.result.has_mosaic:
        return
    surface = material.result.mosaic()
    for defect in largest[:MOST_PICTURES]:
        if url := place_picture(surface, defect.outline.bounds_um, info.low_um, info.high_um):
            yield Figure(url, f"{defect.number} · {defect.seen_as}", small=True)


def _sentences(found: Inspection) -> Iterator[str]:
    """Yield sentences on limitations of the numbers."""
    if len(found.found) > MOST_ROWS:
        yield f"The {MOST_ROWS} largest of {number(len(found.found), 0)} defects are listed."
    not_clean = [die.name for die in found.dies if die.state in ("partly scanned", "not scanned")]
    if not_clean:
        yield f"Not or only partly scanned, so not clean: {'; '.join(not_clean)}."
    yield from repeated(found)
    yield from found.notes
