"""Sections of a report: verdict, results with their budgets and pictures, defects and dies overlaid."""

from __future__ import annotations

import base64
import math
from collections.abc import Iterator

from wafer_viewer.draw.charts.defect_charts import die_stack_svg, pareto_svg
from wafer_viewer.draw.charts.die_map import defect_map_svg, kinds_text
from wafer_viewer.draw.charts.limits_bar import limits_bar_svg, share_bar_svg
from wafer_viewer.draw.number_format import NOTHING, THIN, digits_of_u, number, plural, share, value_and_u
from wafer_viewer.draw.quantities import display_unit, explained_quantity
from wafer_viewer.model.findings import AnyResult
from wafer_viewer.model.gauge import GaugeCheck
from wafer_viewer.model.inspection.defect import REFERENCES, Defect, Inspection, headline, verdict_of
from wafer_viewer.model.inspection.defect_classes import DEFECT_CLASSES
from wafer_viewer.model.inspection.die_grid import DieMeasurement, DieStatus
from wafer_viewer.model.job import GRAVEST, FeatureVerdict, WaferVerdict, key_of_result, keys_of_features
from wafer_viewer.model.measurement.feature import DecisionRule
from wafer_viewer.model.measurement.result_rows import title_of
from wafer_viewer.model.measurement.tools import TOOLS
from wafer_viewer.model.quantity import BudgetLine, Quantity
from wafer_viewer.model.report import PART_TITLES, Figure, Holds, Pairs, ReportSection, Sheet, Table
from wafer_viewer.model.roles import AuditEntry
from wafer_viewer.session.reporting.report_data import (
    Material,
    budget_of,
    feature_row,
    judgement_text,
    kind_of,
    limits_of,
    not_evaluated,
    notes_of,
    numbers_of,
    regions,
    regions_of_feature,
    result_row,
    where,
)
from wafer_viewer.session.reporting.report_pictures import place_picture, views_of

MOST_SHEETS = 60
"""Maximum number of result sheets; further results are in the table only, to limit the report's size."""
RESULT_HEADS = ("No.", "Result", "What, on which heights", "Value ± U, 95 %", "Place on the stage", "Judgement")
FEATURE_HEADS = ("No.", "Feature", "Limits", "Value ± U, 95 %", "Word", "Judgement")
BETWEEN = "Value and U between the limits"
AUDIT_HEADS = ("Time", "Who", "Through", "Action", "Details")
GAUGE_HEADS = ("No.", "Certificate", "Scans", "Mean", "Reference", "Error", "En", "Limit", "Word")


def verdict(material: Material) -> ReportSection:
    """Return the section with the wafer's verdict, its dies, and every feature with its limits."""
    title, judged = PART_TITLES["verdict"], material.verdict
    if judged is None:
        return ReportSection(
            title, empty="No verdict was kept on this surface: wafer-viewer measure verdict gives one."
        )
    keyed = enumerate(zip(keys_of_features(judged), judged.items, strict=True), 1)
    rows = tuple(feature_row(n, item, material.notebook.judgement(key)) for n, (key, item) in keyed)
    sentences = (*conformity(judged), *(f"{item.name}: {item.why}" for item in judged.items if item.word != "pass"))
    return ReportSection(
        title,
        word=judged.word,
        beside=" · ".join(part for part in (judged.job, judged.next) if part),
        table=Table(
            FEATURE_HEADS, rows, "n  n", tuple(map(_between_limits, judged.items)), "Value and U between the limits"
        ),
        figures=_die_map(material, judged),
        sentences=tuple(sentence.replace(" um", "\u202fµm") for sentence in sentences),
    )


def features(material: Material) -> ReportSection:
    """Return the section with a sheet of each feature: its place, value and budget."""
    numbered = _one_of_each(material.verdict) if material.verdict is not None else ()
    return ReportSection(
        PART_TITLES["features"],
        sheets=tuple(_of_feature(material, n, item) for n, item in numbered),
        empty="No verdict was kept on this surface.",
    )


def conformity(judged: WaferVerdict) -> Iterator[str]:
    """Yield how many features conform, and by which decision rule."""
    n, passed = len(judged.items), sum(item.word == "pass" for item in judged.items)
    conform = "feature conforms" if n == 1 else "features conform"
    yield f"{passed} of {n} {conform} to the limits given."
    rules: list[DecisionRule] = [item.feature.decision_rule for item in judged.items]
    for rule in dict.fromkeys(rules):
        of_rule = [f"F{k}" for k, each in enumerate(rules, 1) if each == rule]
        which = "" if len(of_rule) == n else f" of {', '.join(of_rule)}"
        yield f"Decision rule{which}: {RULES[rule]}"


RULES: dict[DecisionRule, str] = {
    "guard_band": "the expanded uncertainty U (about 95 %) is taken off every limit (ISO 14253-1).",
    "simple_acceptance": "a value within its limits conforms, whatever its U (simple acceptance).",
}


def _between_limits(item: FeatureVerdict) -> str:
    return limits_bar_svg(item.feature, item.measured, item.word)


def _one_of_each(judged: WaferVerdict) -> Iterator[tuple[int, FeatureVerdict]]:
    """Yield the item with the worst verdict of every feature, with its number; the budgets of dies are similar."""
    numbered = list(enumerate(judged.items, 1))
    for name in dict.fromkeys(item.feature.name for item in judged.items):
        of_name = [(n, item) for n, item in numbered if item.feature.name == name]
        yield min(of_name, key=lambda of: GRAVEST.index(of[1].word))


def _of_feature(material: Material, n: int, item: FeatureVerdict) -> Sheet:
    """Return the uncertainty sheet of a feature."""
    feature, measured = item.feature, item.measured
    tool = TOOLS[feature.tool]
    labels = (tool.title, title_of(tool.result, feature.quantity) if feature.quantity else "")
    return Sheet(
        number=f"F{n}",
        title=item.name,
        below=" · ".join(part for part in (*labels, limits_of(feature)) if part),
        word=item.word.upper(),
        value=explained_quantity(measured) if measured is not None else "not measured",
        **views_of(material, regions_of_feature(material.dataset.scan.job, item)),
        budget=budget_table(measured.budget, measured) if measured else None,
        missing=item.not_evaluated,
    )


def _die_map(material: Material, judged: WaferVerdict) -> tuple[Figure, ...]:
    from wafer_viewer.draw.charts.die_map import die_map_svg

    if not judged.dies:
        return ()
    job = material.dataset.scan.job
    counts = ", ".join(f"{n} {word}" for word, n in judged.die_counts.items())
    across_um = (job.sample.width_um or 0.0) if job.marks is not None else 0.0
    dies = "1 die" if len(judged.dies) == 1 else f"{len(judged.dies)} dies"
    caption = f"{dies}: {counts}. The notch points down; seen from above."
    return (Figure("", caption, svg=die_map_svg(judged.dies, across_um, width_px=260, most_height_px=260)),)


def results(material: Material) -> ReportSection:
    """Return the section with a table of all results, and a sheet of each."""
    rows = tuple(result_row(finding, material.notebook) for finding in material.findings)
    sheets = tuple(_sheet(material, finding) for finding in material.findings[:MOST_SHEETS])
    title = PART_TITLES["results"]
    return ReportSection(title, table=Table(RESULT_HEADS, rows, "n"), sheets=sheets, empty="No results were kept.")


def _sheet(material: Material, finding: AnyResult) -> Sheet:
    judgement = judgement_text(material.notebook.judgement(key_of_result(finding.number)))
    below = (kind_of(finding), title_of(type(finding), finding.main_field), where(finding), judgement)
    return Sheet(
        number=f"{finding.number}",
        title=finding.name,
        below=" · ".join(part for part in below if part),
        value=explained_quantity(finding.main),
        **views_of(material, regions(finding), finding),
        pairs=tuple((name, material.time(text)) for name, text in numbers_of(finding)),
        budget=budget_table(budget_of(finding), finding.main),
        missing=not_evaluated(finding),
        notes=notes_of(finding),
    )


def budget_table(lines: tuple[BudgetLine, ...], quantity: Quantity) -> Table | None:
    """Return contributions in the display unit, the largest first, then the totals; None if empty.

    Each has its type of evaluation, distribution, degrees of freedom and share of the variance.
    """
    read = display_unit(quantity)
    variance = sum(line.u**2 for line in lines)
    if not variance:
        return None
    ordered = sorted(lines, key=lambda line: -line.u)
    combined = variance**0.5 * read.factor
    shares = [line.u**2 / variance for line in ordered]
    rows = [
        (
            line.name,
            f"{line.evaluation}, {line.distribution}",
            _freedom(line.freedom),
            _part_of_u(line.u * read.factor, combined),
            share(part),
        )
        for line, part in zip(ordered, shares, strict=True)
    ]
    totals = [
        ("combined, k = 1", "", _freedom(quantity.freedom), _part_of_u(combined, combined), ""),
        (f"expanded, {quantity.k_text}", "", "", _part_of_u(quantity.k * combined, combined), ""),
    ]
    heads = ("Contribution", "Type", "Freedom", f"u, {read.unit}", "of u²")
    return Table(heads, (*rows, *totals), "  nnn", (*map(share_bar_svg, shares), "", ""))


def _freedom(freedom: float | None) -> str:
    """Return degrees of freedom, whole as they are rounded down in tables."""
    if freedom is None:
        return "∞"
    return number(math.floor(freedom), 0) if freedom <= MOST_FREEDOM else f">{THIN}{number(MOST_FREEDOM, 0)}"


MOST_FREEDOM = 10_000
"""Degrees of freedom above which a table says no more."""


def _part_of_u(u: float, combined: float) -> str:
    """Return a standard uncertainty to two significant digits; one far below the combined one as under a limit."""
    if not u:
        return "0"
    digits = digits_of_u(combined) + 2
    least = 10.0**-digits
    return number(u, min(digits_of_u(u), digits)) if u >= least else f"<{THIN}{number(least, digits)}"


def gauge(material: Material) -> ReportSection:
    """Return the section of the gauge-block checks among the results."""
    checks = material.gauge_checks
    table = Table(GAUGE_HEADS, tuple(_gauge_row(check) for check in checks), "n nnnnnn")
    sentences = tuple(_of_check(material, check).replace(" um", "\u202fµm") for check in checks)
    return ReportSection(PART_TITLES["gauge"], table=table, sentences=sentences, empty="No gauge-block check was kept.")


def _gauge_row(check: GaugeCheck) -> tuple[str, ...]:
    limit_um = check.terms.limit_um
    heights = (explained_quantity(length.quantity) for length in (check.height, check.reference, check.deviation))
    limit = f"±{number(limit_um, 3)}\u202fµm" if limit_um is not None else "none"
    word = check.verdict.upper()
    return (f"{check.number}", check.certificate.number, f"{check.n}", *heights, number(check.en, 3), limit, word)


def _of_check(material: Material, check: GaugeCheck) -> str:
    """Return the details of a check: reason of the verdict, certificate and signer."""
    paper = check.certificate
    blocks = f"Certificate {paper.number} of {paper.laboratory}, blocks {', '.join(paper.serials)}, to {paper.expires}"
    signed = f"; signed by {check.signed_by}, {material.time(check.at)}" if check.signed_by else ""
    return f"{check.number}: {check.why} {blocks}{signed}."


def audit(material: Material) -> ReportSection:
    """Return the section with what people did to the dataset and its job, from the signed audit log of its folder."""
    title = PART_TITLES["audit"]
    if material.audit_fault:
        return ReportSection(title, sentences=(material.audit_fault,))
    rows = tuple(_audit_row(material, entry) for entry in material.actions)
    return ReportSection(
        title, table=Table(AUDIT_HEADS, rows, "w w"), empty="The audit log has no entry on this dataset."
    )


def _audit_row(material: Material, entry: AuditEntry) -> tuple[str, ...]:
    """Return the cells of an entry; what it was done to is named unless that is the dataset."""
    named = "" if entry.subject == material.dataset.path.name else f", {entry.subject}"
    action = f"{entry.action}{named}"
    details = (entry.detail, f"SHA-256 {entry.sha256}" if entry.sha256 else "")
    return (material.time(entry.at), entry.by, entry.through, action, " · ".join(part for part in details if part))


MOST_PLACES = 10
"""Maximum number of listed positions; the report gives the number of further ones."""
WIDTH_PX = 420


def stacked(material: Material, inspection: Inspection) -> Iterator[Figure]:
    """Yield the figure with the defects of all dies overlaid; none without dies or without defects on them."""
    from wafer_viewer.measure.defects.defect_builder import repeated_places

    if inspection.grid is None or not any(defect.die for defect in inspection.found):
        return
    places = repeated_places(inspection)
    ringed = " Rings: places that repeat." if places else ""
    caption = f"All dies overlaid, their defects by class.{ringed}"
    yield Figure("", caption, svg=die_stack_svg(inspection, places, _ground(material, inspection), width_px=WIDTH_PX))


def repeated(inspection: Inspection) -> Iterator[str]:
    """Yield the positions at which several dies have a defect."""
    from wafer_viewer.measure.defects.defect_builder import repeated_places

    places = repeated_places(inspection)
    if places:
        yield (
            "Defects that repeat at the same place of several dies are systematic, of the mask or the process, "
            "unless chance explains them."
        )
    for k, place in enumerate(places[:MOST_PLACES], 1):
        x, y = number(place.in_die.x_um, 1), number(place.in_die.y_um, 1)
        kind = DEFECT_CLASSES[place.kind].title.lower()
        chance = f", {place.chance_words}" if place.chance_words else ""
        yield f"Place {k}, x {x}, y {y} µm of the die: {kind} {place.words}{chance}."
    if len(places) > MOST_PLACES:
        yield f"{len(places) - MOST_PLACES} more places repeat."


def _ground(material: Material, found: Inspection) -> str:
    """Return the picture of the typical die as a data URL; empty if there is none."""
    from wafer_viewer.session.inspection.reference_views import like_die
    from wafer_viewer.session.rendering.render_comparisons import picture_of_die

    if material.info is None or not material.result.has_mosaic:
        return ""
    seen = picture_of_die(material.result.mosaic(), material.dataset.path.parent, like_die(found))
    return f"data:image/jpeg;base64,{base64.b64encode(seen.picture).decode()}" if seen.picture else ""


MOST_ROWS, MOST_PICTURES = 40, 12
"""Maximum numbers of rows and pictures.

The report gives the number of omitted ones, which the CSV and KLARF contain.
"""
HEADS = ("No.", "Class", "Die", "Height ± U, 95 %", "Length", "x, y of the stage, µm", "Judgement")


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


MOST_DIES = 200
"""Maximum number of rows of dies; the CSV has all."""
DIE_HEADS = ("Die", "Defects", "Tilt x, mrad", "Tilt y, mrad", "Offset, µm", "Bow, µm", "Brightness, %")


def dies(material: Material) -> ReportSection:
    """Return the section with tilt, offset, bow and brightness of every die, the most tilted first."""
    found = measured_dies(material)
    told = ["Value ± U (95 %), relative to the other dies and their trend over the wafer. The most tilted come first."]
    if len(found) > MOST_DIES:
        told.append(f"The {MOST_DIES} most tilted of {number(len(found), 0)} dies are listed.")
    rows = tuple(_die_row(die, at) for die, at in found[:MOST_DIES])
    return ReportSection(PART_TITLES["dies"], table=Table(DIE_HEADS, rows, "wnnnnnn"), sentences=tuple(told))


def dies_held(material: Material) -> Holds:
    """Return how many dies were measured."""
    n = len(measured_dies(material))
    return Holds(f"{plural(n, 'die')} measured" if n else "no die was compared with others", nothing=not n)


def measured_dies(material: Material) -> list[tuple[DieStatus, DieMeasurement]]:
    """Return the dies that were compared with others, the most tilted first."""
    found = material.inspection.dies if material.inspection is not None else ()
    return sorted(((die, die.measured) for die in found if die.measured is not None), key=lambda one: -one[1].tilt_mrad)


def _die_row(die: DieStatus, at: DieMeasurement) -> tuple[str, ...]:
    lengths = (at.tilt_x, at.tilt_y, at.offset.quantity, at.bow.quantity)
    bright = value_and_u(100 * at.brightness_fraction, 200 * at.u_brightness_fraction or None, 1, signed=True)
    pairs = [*(value_and_u(one.value, one.expanded, signed=True) for one in lengths), bright]
    return (
        die.name,
        NOTHING if die.defects is None else number(die.defects, 0),
        *(" ± ".join(pair) if pair[1] != NOTHING else pair[0] for pair in pairs),
    )


def _inspected(inspection: Inspection) -> Pairs:
    expected = inspection.expected_false_per_mm2
    false = f"{expected:.2g} per mm² expected" if expected is not None else "not known"
    return (
        ("Result", headline(inspection).replace("mm2", "mm²")),
        ("Defects", number(len(inspection.found), 0)),
        ("Compared with", REFERENCES[inspection.reference]),
        ("Inspected", f"{inspection.inspected_mm2:.3g}\u202fmm²; unmeasured {inspection.unmeasured_mm2:.3g}\u202fmm²"),
        ("Recipe", f"{inspection.recipe.name}, sensitivity {inspection.recipe.sensitivity:g}"),
        ("False defects", false),
        ("Limits", _held(inspection)),
    )


def _held(inspection: Inspection) -> str:
    """Return the verdict by the limits of the recipe with its reasons, or that no limits are set."""
    if not inspection.recipe.limits.are_set:
        return "none set"
    verdict = verdict_of(inspection)
    if verdict.word == "pass":
        return f"within, {verdict.counted} counted"
    return " ".join(("not within." if verdict.word == "fail" else "no verdict, not all was inspected.", *verdict.why))


def _row(defect: Defect) -> tuple[str, ...]:
    length = explained_quantity(defect.major.quantity) if defect.size_resolved else "not resolved"
    place = f"{number(defect.center.x_um, 1)}, {number(defect.center.y_um, 1)}"
    word = " ".join(part for part in (defect.judgement, defect.judged_by) if part and part != "open")
    height = explained_quantity(defect.height.quantity)
    return (f"{defect.number}", defect.seen_as, defect.die, height, length, place, word)


def _figures(material: Material, inspection: Inspection, largest: list[Defect]) -> Iterator[Figure]:
    """Yield the map of dies, the Pareto chart, and pictures of the largest defects."""
    if dies := defect_map_svg(inspection):
        yield Figure("", f"Defects on each die: {kinds_text(inspection.dies)}.", svg=dies)
    if inspection.found:
        chart = pareto_svg(defect.seen_as for defect in inspection.found)
        yield Figure("", "Defects by class; at the right the share of all up to each.", svg=chart)
    yield from stacked(material, inspection)
    info = material.info
    if info is None or not material.result.has_mosaic:
        return
    surface = material.result.mosaic()
    for defect in largest[:MOST_PICTURES]:
        if url := place_picture(surface, defect.outline.bounds_um, info.low_um, info.high_um):
            yield Figure(url, f"{defect.number} · {defect.seen_as}", small=True)


def _sentences(inspection: Inspection) -> Iterator[str]:
    """Yield sentences on limitations of the numbers."""
    if len(inspection.found) > MOST_ROWS:
        yield f"The {MOST_ROWS} largest of {number(len(inspection.found), 0)} defects are listed."
    not_clean = [die.name for die in inspection.dies if die.state in ("partly scanned", "not scanned")]
    if not_clean:
        yield f"Not or only partly scanned, so not clean: {'; '.join(not_clean)}."
    yield from repeated(inspection)
    yield from inspection.notes
