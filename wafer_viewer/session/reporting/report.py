"""Report of a dataset, generated from its folder alone, so that the page and the command line give the same.

The clock is not used: the same dataset gives the same bytes. The calibration is checked for the day of the scan.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from itertools import groupby
from pathlib import Path

from wafer_viewer._version import __version__
from wafer_viewer.draw.charts.marked_map import MapKey, marked_map_svg
from wafer_viewer.draw.number_format import number, share
from wafer_viewer.draw.quantities import UNIT_SIGNS, explained_quantity, recipe_rows
from wafer_viewer.draw.surface.display_style import DisplayStyle
from wafer_viewer.model.errors import ComputeError, DatasetError
from wafer_viewer.model.job import FeatureVerdict, keys_of_features, keys_under_review
from wafer_viewer.model.measurement.result_rows import title_of
from wafer_viewer.model.progress import Progress, ShouldStop, never, silent
from wafer_viewer.model.quantity import Quantity
from wafer_viewer.model.report import (
    DIGITAL,
    PART_TITLES,
    TRANSFER,
    Contents,
    Figure,
    Holds,
    Letterhead,
    Part,
    Report,
    ReportOrder,
    ReportSection,
    Table,
    zone_of,
)
from wafer_viewer.session.reporting.report_data import (
    LABORATORY,
    Material,
    calibration_pairs,
    gather,
    kind_of,
    local_time,
    marks_of,
    method_words,
    names_of,
    not_evaluated,
    notes_of,
    outline_um,
    plan_pairs,
    positioner_pairs,
    surface_pairs,
    unmeasured_words,
    verdict_text,
)
from wafer_viewer.session.reporting.sections import (
    MOST_SHEETS,
    audit,
    defects,
    defects_held,
    dies,
    dies_held,
    features,
    gauge,
    measured_dies,
    results,
    verdict,
)
from wafer_viewer.store.io.atomic_files import atomic_write, write_text
from wafer_viewer.store.records.digital_certificate import CertifiedResults, NamedResult, results_xml
from wafer_viewer.store.tables.aqdef import ControlledQuantity, MeasuredPart, MeasuredValue, transfer_file

OF_A_SCAN: tuple[Part, ...] = ("plan", "recipe")
"""Parts that a surface from a file does not have."""
SIGNED_BY = ("Measured by", "Checked by", "Approved by")
SCOPE = "The results relate only to the sample and the places named in this report. It may be copied only as a whole."
"""What a report holds for (ISO/IEC 17025, 7.8.2.1)."""


def report_of(
    folder: Path,
    result: str,
    order: ReportOrder,
    *,
    progress: Progress = silent,
    should_stop: ShouldStop = never,
) -> Report:
    """Return the report of a dataset, with the requested parts.

    Raises DatasetError when the folder is no dataset, ComputeError when the work is stopped.
    """
    material = gather(folder, result)
    parts: list[Part] = [part for part in order.parts if _goes_in(part, material)]
    sections: list[ReportSection] = []
    for part in parts:
        if should_stop():
            raise ComputeError("The report was stopped. Nothing was written.")
        sections.append(_MADE[part](material))
        progress(len(sections) / len(parts))
    return Report(
        title=order.title.strip() or material.dataset.path.stem,
        below=_below(material, order),
        simulated=material.dataset.simulated,
        facts=_facts(material, order),
        sections=tuple(sections),
        number=_number(material, order),
        scope=SCOPE,
        paper=order.paper,
        letterhead=_letterhead(material),
        language=order.language or material.laboratory.language,
        names=frozenset(filter(None, (*names_of(material), order.title.strip(), order.customer.strip()))),
    )


def _goes_in(part: Part, material: Material) -> bool:
    """Return whether a part applies to this dataset; parts that do not apply are omitted."""
    held: dict[Part, bool] = {
        "verdict": material.asks_for_a_verdict or material.verdict is not None,
        "features": bool(material.features),
        "defects": material.inspection is not None,
        "dies": bool(measured_dies(material)),
        "gauge": bool(material.gauge_checks),
        "pictures": bool(material.pictures),
        "audit": bool(material.actions or material.audit_fault),
        **dict.fromkeys(OF_A_SCAN, bool(material.dataset.fields)),
    }
    return held.get(part, True)


def _letterhead(material: Material) -> Letterhead | None:
    """Return the head of the laboratory; None if it is not given. Raises DatasetError."""
    from wafer_viewer.session.reporting.report_pictures import logo_picture

    lab = material.laboratory
    if not lab.name:
        return None
    logo = logo_picture(material.dataset.path.parent / Path(lab.logo).name) if lab.logo else ""
    return Letterhead(lab.name, tuple(line for line in (lab.address, lab.accreditation) if line), logo)


def certified_results(material: Material, order: ReportOrder) -> CertifiedResults:
    """Return the results of a dataset for other programs. Raises DatasetError where the laboratory is not given."""
    lab, scan = material.laboratory, material.dataset.scan
    if not lab.name or not lab.country:
        raise DatasetError(f"{LABORATORY} of the data folder gives no name and country, which results as XML need.")
    verdict_word = (f"Verdict: {verdict_text(material.verdict)}",) if material.verdict is not None else ()
    sample = scan.job.sample
    return CertifiedResults(
        number=_number(material, order),
        day=material.day,
        country=lab.country,
        laboratory=lab.name,
        address=lab.address,
        email=lab.email,
        person=sample.operator or lab.name,
        customer=order.customer.strip() or lab.name,
        sample=sample.wafer_id or sample.name or material.dataset.path.stem,
        instrument=scan.rig or scan.imported_from or "not given",
        software=scan.software_version,
        results=tuple(
            NamedResult(finding.name or kind_of(finding), kind_of(finding), tuple(finding.quantities.items()))
            for finding in material.findings
        ),
        statements=(*verdict_word, SCOPE, *_warnings(material).sentences),
    )


def measured_part(material: Material) -> MeasuredPart:
    """Return features and results of a dataset for statistical process control: a value of a feature for each die."""
    scan, sample = material.dataset.scan, material.dataset.scan.job.sample
    name = sample.product or scan.job.product or sample.name or material.dataset.path.stem
    wafer = sample.wafer_id or sample.name or material.dataset.path.stem
    warned = (
        "SIMULATED" if material.dataset.simulated else "",
        f"uncalibrated: {why}" if (why := material.uncalibrated) else "",
    )
    return MeasuredPart(
        number=name,
        name=sample.name or name,
        revision=scan.job.revision,
        instrument=scan.rig or scan.imported_from,
        remark="; ".join(filter(None, warned)),
        lot=sample.lot,
        at=local_time(scan.taken, zone_of(material.laboratory.zone)),
        characteristics=(*_controlled_features(material, wafer), *_controlled_results(material, wafer)),
    )


def _controlled_features(material: Material, wafer: str) -> Iterator[ControlledQuantity]:
    for n, (feature, items) in enumerate(groupby(material.features, lambda item: item.feature), 1):
        yield ControlledQuantity(
            number=f"F{n}",
            name=feature.name,
            unit=UNIT_SIGNS[feature.unit],
            values=[_judged_value(item, wafer) for item in items],
            nominal=feature.nominal,
            lower=feature.lower_limit,
            upper=feature.upper_limit,
            remark=feature.decision_rule.replace("_", " "),
        )


def _judged_value(item: FeatureVerdict, wafer: str) -> MeasuredValue:
    part = f"{wafer}, die {item.die}" if item.die else wafer
    if item.measured is None:
        return MeasuredValue(None, part, f"not measured: {item.why}")
    return _controlled(item.measured, part, item.word)


def _controlled_results(material: Material, wafer: str) -> Iterator[ControlledQuantity]:
    for finding in material.findings:
        for n, (symbol, quantity) in enumerate(finding.quantities.items(), 1):
            yield ControlledQuantity(
                number=f"{finding.number}.{n}",
                name=f"{finding.name or kind_of(finding)}, {title_of(type(finding), symbol)}",
                unit=UNIT_SIGNS[quantity.unit],
                values=[_controlled(quantity, wafer)],
            )


def _controlled(quantity: Quantity, part: str, word: str = "") -> MeasuredValue:
    coverage = f"k = {quantity.k:.2f}" if quantity.expanded is not None else ""
    text = "; ".join(filter(None, (explained_quantity(quantity), coverage, word)))
    return MeasuredValue(quantity.value if math.isfinite(quantity.value) else None, part, text)


def _number(material: Material, order: ReportOrder) -> str:
    """Return the number of a report: the one given, or the dataset's name with the day of the scan."""
    return order.number.strip() or f"{material.dataset.path.stem}-{material.day.replace('-', '')}"


def make_report(
    folder: Path,
    result: str,
    order: ReportOrder,
    out: Path,
    *,
    progress: Progress = silent,
    should_stop: ShouldStop = never,
) -> Path:
    """Write the report of a dataset to a file atomically; return its path.

    Raises DatasetError when the folder is no dataset or `out` cannot be written, ComputeError when the work is stopped.
    """
    from wafer_viewer.store.records.conformance_reports import write_report

    if out.suffix == DIGITAL:
        write_text(out, results_xml(certified_results(gather(folder, result), order)))
        return out
    if out.suffix == TRANSFER:
        with atomic_write(out) as temporary:
            temporary.write_bytes(transfer_file(measured_part(gather(folder, result))))
        return out
    write_report(report_of(folder, result, order, progress=progress, should_stop=should_stop), out)
    return out


def contents(folder: Path, result_name: str) -> Contents:
    """Return a description of the contents of each part, without drawing.

    Raises DatasetError for a folder that is no dataset.
    """
    material = gather(folder, result_name)
    info, plan, why = material.info, material.dataset.scan.plan, material.uncalibrated
    pictures, warnings = len(material.pictures), len(_warnings(material).sentences)
    counted = _count(pictures, "picture") if pictures else "no pictures yet: key P takes one"
    points = f"{number(info.cols, 0)} × {number(info.rows, 0)} points" if info is not None else "not stitched yet"
    settled = info is not None and info.settled is not None
    return {
        "verdict": _verdict_held(material),
        "features": _held(len(material.features), "feature", "the job has no feature with limits"),
        "results": _results_held(material),
        "defects": defects_held(material),
        "dies": dies_held(material),
        "gauge": _held(len(material.gauge_checks), "check", "no gauge-block check was kept"),
        "pictures": Holds(counted, nothing=not pictures),
        "surface": Holds(points, nothing=info is None),
        "plan": Holds(f"{_count(len(plan.fields), 'field')} of {plan.frames_each} frames"),
        "recipe": Holds("the settings that were used" if settled else "the settings that were asked for"),
        **({} if plan.fields else dict.fromkeys(OF_A_SCAN, Holds("a surface from a file has none", nothing=True))),
        "calibration": Holds("lengths are calibrated" if why is None else f"uncalibrated: {why}"),
        "warnings": Holds(_count(warnings, "warning") if warnings else "no warnings"),
        "audit": _audit_held(material),
        "checksums": Holds("of data and results; versions of the program"),
        "signatures": Holds(", ".join(SIGNED_BY).lower()),
    }


def _held(n: int, word: str, nothing: str) -> Holds:
    return Holds(_count(n, word) if n else nothing, nothing=not n)


def _verdict_held(material: Material) -> Holds:
    """Return the verdict, the number of features, and how many of them people judged."""
    if material.verdict is None:
        why = "no verdict was kept" if material.asks_for_a_verdict else "the job has no feature with limits"
        return Holds(why, nothing=True)
    judged = material.notebook.judged(keys_of_features(material.verdict))
    return Holds(f"{material.verdict.word.upper()}, {_count(len(material.features), 'feature')}, {judged} judged")


def _results_held(material: Material) -> Holds:
    """Return the number of results, and how many of them people judged."""
    if not material.findings:
        return Holds("no results yet", nothing=True)
    judged = material.notebook.judged(keys_under_review(None, material.findings))
    return Holds(f"{_count(len(material.findings), 'result')}, {judged} judged")


def _audit_held(material: Material) -> Holds:
    """Return the number of entries of the audit log, or why there are none."""
    n = len(material.actions)
    entries = f"{number(n, 0)} {'entry' if n == 1 else 'entries'} on this dataset and its job"
    return Holds(
        material.audit_fault or (entries if n else "no entry on this dataset"), nothing=not (n or material.audit_fault)
    )


def _count(n: int, word: str) -> str:
    return f"{number(n, 0)} {word}{'' if n == 1 else 's'}"


def _below(material: Material, order: ReportOrder) -> str:
    name = f"{material.dataset.path.stem} · " if order.title.strip() else ""
    return f"{name}taken {material.time(material.dataset.scan.taken)} · result {material.result.name}"


def _facts(material: Material, order: ReportOrder) -> tuple[tuple[str, str], ...]:
    scan, sample = material.dataset.scan, material.dataset.scan.job.sample
    named = (
        ("Customer", order.customer.strip()),
        ("Sample", sample.name),
        ("Lot", sample.lot),
        ("Wafer", sample.wafer_id),
        ("Product", sample.product or scan.job.product),
        ("Operator", sample.operator),
        ("Instrument", scan.rig or scan.imported_from),
        ("Objective", scan.setup.objective if scan.imported_from else ""),
        ("Method", method_words(material)),
        ("Program", f"Wafer Viewer {scan.software_version}"),
        ("Verdict", verdict_text(material.verdict) if material.verdict else ""),
        ("Lengths", "calibrated" if material.uncalibrated is None else f"uncalibrated: {material.uncalibrated}"),
    )
    return tuple((name, value) for name, value in named if value)


def _pictures(material: Material) -> ReportSection:
    from wafer_viewer.session.reporting.report_pictures import taken_picture

    figures = tuple(Figure(taken_picture(picture), picture.stem) for picture in material.pictures)
    return ReportSection(PART_TITLES["pictures"], figures=figures, empty="No pictures were taken at print size.")


def _surface(material: Material) -> ReportSection:
    from wafer_viewer.session.reporting.report_pictures import whole_picture

    info, title = material.info, PART_TITLES["surface"]
    if info is None:
        return ReportSection(title, empty="The fields are not stitched.")
    mosaic, marks = material.result.mosaic(), marks_of(material)
    missing = share(1.0 - info.measured_fraction) if info.measured_fraction < 1 else ""
    drawing = marked_map_svg(
        whole_picture(mosaic, info.low_um, info.high_um),
        outline_um(mosaic),
        marks,
        MapKey(info.low_um, info.high_um, DisplayStyle().colours, missing and f"Not measured, {missing}"),
    )
    figure = Figure("", " ".join(_map_caption(material, {mark.label for mark in marks})), svg=drawing)
    return ReportSection(title, pairs=surface_pairs(info), figures=(figure,))


def _map_caption(material: Material, marked: set[str]) -> Iterator[str]:
    """Yield what the map shows, what its numbers are, and which features and results are not on it."""
    yield "Heights of the stitched surface from above, light from the north-west."
    features, results = (sum(label.startswith("F") == kind for label in marked) for kind in (True, False))
    if results and features:
        yield "Numbers: results; F with a number: features of the job."
    elif marked:
        yield "Numbers: results." if results else "F with a number: features of the job."
    listed = (*(f"F{n}" for n, _ in enumerate(material.features, 1)), *(f"{each.number}" for each in material.findings))
    absent = [label for label in listed if label not in marked]
    if absent:
        named = ", ".join(absent[:MOST_NAMED]) + (
            f" and {len(absent) - MOST_NAMED} more" if absent[MOST_NAMED:] else ""
        )
        yield f"Not on the map: {named}."


MOST_NAMED = 20
"""Features and results that the caption of the map lists as not on it."""


def _plan(material: Material) -> ReportSection:
    scan = material.dataset.scan
    return ReportSection(
        PART_TITLES["plan"], pairs=plan_pairs(scan.plan, scan.job) + positioner_pairs(scan.positioners)
    )


def _recipe(material: Material) -> ReportSection:
    settled = material.info.settled if material.info else None
    pairs = recipe_rows(settled or material.dataset.scan.job.recipe)
    return ReportSection(PART_TITLES["recipe"], pairs=tuple(pairs))


def _calibration(material: Material) -> ReportSection:
    calibration = material.dataset.scan.calibration
    why = (f"Lengths are uncalibrated: {material.uncalibrated}.",) if material.uncalibrated else ()
    pairs = calibration_pairs(calibration) if calibration else ()
    return ReportSection(PART_TITLES["calibration"], pairs=pairs, sentences=why)


def _warnings(material: Material) -> ReportSection:
    dataset, info = material.dataset, material.info
    missing = len(dataset.missing())
    warnings = ["The frames are simulated: nothing was measured on a real sample."] if dataset.simulated else []
    if material.uncalibrated is not None:
        warnings.append(f"Lengths are uncalibrated, and have no U: {material.uncalibrated}")
    if material.audit_fault:
        warnings.append(material.audit_fault)
    if missing:
        warnings.append(f"{number(missing, 0)} of {number(dataset.scan.plan.n_frames, 0)} frames are missing.")
    if info is not None:
        warnings += [*unmeasured_words(info)]
        warnings += [*info.recipe_notes, *(info.stitching.notes if info.stitching else ())]
    warnings += [
        f"Result {f.number}, {f.name}: {note}" for f in material.findings[MOST_SHEETS:] for note in notes_of(f)
    ]
    sentences = tuple(
        dict.fromkeys(sentence.replace(" um", "\u202fµm") for sentence in (*warnings, *_left_out(material)))
    )
    return ReportSection(PART_TITLES["warnings"], sentences=sentences, empty="None.")


def _left_out(material: Material) -> Iterator[str]:
    """Yield the contributions not evaluated in U, with the numbers of the results."""
    named = (
        *(("result", f"{finding.number}", not_evaluated(finding)) for finding in material.findings),
        *(("feature", f"F{n}", item.not_evaluated) for n, item in enumerate(material.features, 1)),
    )
    numbers_by_missing: dict[tuple[str, tuple[str, ...]], list[str]] = {}
    for kind, name, missing in named:
        if missing:
            key = kind, tuple(what.rstrip(".") for what in missing)
            numbers_by_missing.setdefault(key, []).append(name)
    for (kind, missing), names in numbers_by_missing.items():
        yield f"Not evaluated in U of {kind}{'' if len(names) == 1 else 's'} {', '.join(names)}: {'; '.join(missing)}."


def _checksums(material: Material) -> ReportSection:
    from wafer_viewer.store.dataset.integrity import digests_of_result, digests_of_scan

    digests = (*digests_of_scan(material.dataset.path), *digests_of_result(material.result))
    made = material.result.mosaic().provenance.software_version if material.result.has_mosaic else ""
    versions = (
        ("Taken with", material.dataset.scan.software_version),
        ("Surface made with", made),
        ("Reported with", __version__),
    )
    return ReportSection(
        PART_TITLES["checksums"],
        pairs=tuple((name, f"Wafer Viewer {version}") for name, version in versions if version),
        table=Table(
            ("What", "Of which files", "SHA-256"), tuple((digest.what, digest.of, digest.sha256) for digest in digests)
        ),
    )


def _signatures(material: Material) -> ReportSection:
    return ReportSection(PART_TITLES["signatures"], lines=SIGNED_BY)


_MADE: dict[Part, Callable[[Material], ReportSection]] = {
    "verdict": verdict,
    "features": features,
    "results": results,
    "defects": defects,
    "dies": dies,
    "gauge": gauge,
    "pictures": _pictures,
    "surface": _surface,
    "plan": _plan,
    "recipe": _recipe,
    "calibration": _calibration,
    "warnings": _warnings,
    "audit": audit,
    "checksums": _checksums,
    "signatures": _signatures,
}
