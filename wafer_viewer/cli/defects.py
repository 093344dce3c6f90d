"""Commands that find dies and inspect for defects, with output as JSON, KLARF or CSV and an exit code.

The signature of a command defines its flags, its docstring is the help.
"""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import msgspec
from tyro.conf import Positional, arg

from wafer_viewer.cli.arguments import Count, File, Place, Source, Text, Um
from wafer_viewer.cli.output import print_json, print_statistics, progress, to_program, warn
from wafer_viewer.model.acquisition.sample import Notch
from wafer_viewer.model.errors import MeasureError, WaferViewerError
from wafer_viewer.model.inspection.defect import (
    Against,
    DefectLimits,
    DefectRecipe,
    Inspection,
    headline,
    require_die_limit,
    verdict_of,
)
from wafer_viewer.model.inspection.klarf import KlarfExport
from wafer_viewer.model.inspection.wafer_map import require_notch
from wafer_viewer.model.spec import Spec, encode, replace
from wafer_viewer.session.inspection.inspection_files import WRITERS, Handover, compared, overlay_klarf
from wafer_viewer.session.inspection.inspection_job import GivenDies, Wafer, dies_on, inspected, wafer_of
from wafer_viewer.session.state.inspection_state import product_of
from wafer_viewer.session.surface.headless import LocalOrCluster

if TYPE_CHECKING:
    from wafer_viewer.model.inspection.golden_die import GoldenDie
    from wafer_viewer.model.inspection.lot import StatisticsRow


NOT_PASSED = 1
Pair = Annotated[tuple[float, float] | None, arg(metavar="X Y")]


def measure_defects(
    src: Source,
    recipe: File = None,
    classes: File = None,
    sensitivity: Annotated[float | None, arg(metavar="0..1")] = None,
    against: Against = "dies",
    golden: File = None,
    save_golden: Annotated[Path | None, arg(metavar="FOLDER/NAME")] = None,
    klarf: File = None,
    klarf_version: Literal["1.2", "1.8"] = "1.2",
    klarf_images: bool = False,
    center_um: Pair = None,
    notch: Notch | None = None,
    diameter_mm: Um = None,
    step: Text = None,
    e142: File = None,
    sinf: File = None,
    csv: File = None,
    dies_csv: File = None,
    training: Annotated[Path | None, arg(metavar="FOLDER")] = None,
    other: File = None,
    max_per_die: Count = None,
    max_per_mm2: Um = None,
    max_tilt_mrad: Um = None,
    max_offset_um: Um = None,
    max_bow_um: Um = None,
    pitch_um: Pair = None,
    origin_um: Pair = None,
    size_um: Pair = None,
    angle_deg: float = 0.0,
    job: File = None,
    as_given: bool = False,
    result: str = "default",
    scheduler: Text = None,
    workers: Count = None,
) -> int:
    """The defects of a patterned wafer, each with size, height and class, as JSON; dies not scanned are named.

    The first line, also on standard error, has the share that was inspected. Status 0: within the limits; 1: any other
    verdict, also where dies were not or only partly scanned or compared, or where a file could not be written, which
    throws no result away; 2: bad input, or dies that are not found. What people judged a nuisance in the dataset does
    not count.

    Args:
        src: A NAME.wafer or a surface file.
        recipe: How defects are looked for, a TOML file; that kept for the product of a NAME.wafer by default.
        classes: The fab's class table, a TOML file; that of the recipe, else the built-in one by default.
        sensitivity: The dial: 0 finds only clear defects, 1 everything that may be one; the recipe's by default.
        against: Compare dies with each other, or the surface with its fitted form, which sees nothing of a pattern.
        golden: A NAME.golden.npz to compare with instead; shows what repeats in every die. The recipe's by default.
        save_golden: Keep the typical die of this wafer as the next version of NAME.
        klarf: Write a KLARF file.
        klarf_version: Its version; lengths are in um in 1.2 and in nm in 1.8.
        klarf_images: Write the picture of each defect to a TIFF next to the KLARF.
        center_um: The wafer's centre on the stage, for a KLARF; that of the dataset's alignment by default.
        notch: The side of the wafer's notch, for a KLARF or a map; that of the dataset's sample by default.
        diameter_mm: The wafer's diameter, for a KLARF; that of the dataset's sample by default.
        step: The process step, StepID of a KLARF.
        e142: Write a wafer map, XML of SEMI E142; a die fails beyond the largest number of defects per die.
        sinf: Write a wafer map as SINF, a text.
        csv: Write a table of the defects.
        dies_csv: Write a table of the dies: state, tilts, offset, bow and brightness of each with U.
        training: Write a folder of cut-outs with the classes given by the rules and by people.
        other: A KLARF of another tool: reports what both found and what only one of them found.
        max_per_die: Largest number of defects per die; the recipe's by default.
        max_per_mm2: Largest number of defects per inspected mm2; the recipe's by default.
        max_tilt_mrad: Largest tilt of a die against the others; the recipe's by default.
        max_offset_um: Farthest that a die may lie above or below the others; the recipe's by default.
        max_bow_um: Largest bow of a die; the recipe's by default.
        pitch_um: From die to die along x and y; found by default. Without a corner dies are searched next to it.
        origin_um: Lower left corner of die 0,0, stage um; goes with the pitch.
        size_um: Width and height of a die without its street; found, or with a corner as the pitch, by default.
        angle_deg: How the dies are turned, anticlockwise; goes with the corner.
        job: The PLAN.toml whose dies these are, or a KLARF or wafer map for their pitch; those of the dataset's own job
            by default.
        as_given: Leave given dies where they were given; they are moved to where they are seen by default.
        result: Name of the reconstruction.
        scheduler: A dask cluster that works on a NAME.wafer, tls://HOST:PORT.
        workers: Processes of this machine that work on a NAME.wafer; 1 is this one alone. As many as help by default.
    """
    from wafer_viewer.measure.defects.defect_builder import repeated_places

    given, hire = GivenDies(pitch_um, origin_um, size_um, angle_deg, job, as_given), LocalOrCluster(scheduler, workers)
    planarity = {"max_tilt_mrad": max_tilt_mrad, "max_offset_um": max_offset_um, "max_bow_um": max_bow_um}
    limits = DefectLimits(max_per_die=max_per_die, max_per_mm2=max_per_mm2, **planarity)
    _require_readable(other)
    x_um, y_um = center_um or (None, None)
    stated = KlarfExport(center_x_um=x_um, center_y_um=y_um, diameter_mm=diameter_mm, step=step or "")
    stated = replace(stated, notch=notch or "none", images=klarf_images)
    wafer = _with_stated(wafer_of(src, result), stated)
    if klarf is not None:
        wafer.stated.require_complete()
    used_recipe = _with_classes(_recipe(recipe, wafer, src, sensitivity, limits), classes)
    stored = _golden(golden, against, used_recipe, src)
    wanted: dict[Handover, Path | None] = {"e142": e142, "sinf": sinf, "csv": csv, "dies": dies_csv}
    wanted["training"] = training
    wanted["klarf18" if klarf_version == "1.8" else "klarf"] = klarf
    if e142 or sinf:
        require_die_limit(used_recipe.limits)
        require_notch(wafer.stated.notch)
    with progress("Looking for defects") as tell:
        inspection = inspected(wafer, used_recipe, given, stored, against, tell, hire)
    files, faults = _files(wafer, inspection, wanted)
    files |= _keep_golden(wafer, inspection, given, save_golden)
    verdict = verdict_of(inspection)
    first = {"result": headline(inspection), "verdict": verdict, "files": files}
    summary = first | {"repeats": repeated_places(inspection), "inspection": inspection}
    print_json(msgspec.to_builtins(summary | _beside(other, wafer, inspection)))
    warn(headline(inspection))
    for fault in faults:
        warn(fault)
    return 0 if verdict.within and not faults else NOT_PASSED


def _with_stated(wafer: Wafer, stated: KlarfExport) -> Wafer:
    """Return a wafer with what flags state of it, completed by what is known."""
    return dataclasses.replace(wafer, stated=stated.over(wafer.stated))


def _recipe(
    path: Path | None, wafer: Wafer, src: Path, sensitivity: float | None, limits: DefectLimits
) -> DefectRecipe:
    """Return the recipe of a file, else the one saved for the product next to the dataset, with a warning.

    Sensitivity and limits from flags take precedence.
    """
    from wafer_viewer.store.records.inspection_records import read_defect_recipe

    own = read_defect_recipe(path) if path is not None else _of_product(wafer, src)
    dial = own.sensitivity if sensitivity is None else sensitivity
    return replace(own, sensitivity=dial, limits=limits.over(own.limits))


def _with_classes(recipe: DefectRecipe, path: Path | None) -> DefectRecipe:
    from wafer_viewer.store.records.inspection_records import read_class_table

    return recipe if path is None else replace(recipe, classes=read_class_table(path))


def _of_product(wafer: Wafer, src: Path) -> DefectRecipe:
    from wafer_viewer.store.records.inspection_records import readable_recipes

    product = product_of(wafer.job) if wafer.job is not None else ""
    recipes, problems = readable_recipes(src.absolute().parent) if product else ((), ())
    for problem in problems:
        warn(problem)
    recipe = next((recipe for recipe in recipes if recipe.product == product), None)
    if recipe is None:
        return DefectRecipe(product=product)
    warn(f"Recipe '{recipe.name}' of {product} is used because it was saved last: --recipe takes another.")
    return recipe


def _golden(path: Path | None, against: str, recipe: DefectRecipe, src: Path) -> GoldenDie | None:
    """Return the golden die of a file, else the one that the recipe names, next to the dataset; None without either."""
    from wafer_viewer.store.records.golden_dies import FOLDER, golden_named, open_golden

    if path is not None and against == "form":
        raise MeasureError("A golden die is compared die by die: leave --golden or --against form out.")
    if path is not None:
        return open_golden(path)
    named = recipe.golden if against == "dies" else ""
    return golden_named(src.absolute().parent / FOLDER, named, recipe.product) if named else None


def _files(
    wafer: Wafer, found: Inspection, paths: dict[Handover, Path | None]
) -> tuple[dict[str, str], tuple[str, ...]]:
    """Write the requested files; return their paths by flag, and why others could not be written."""
    written: dict[str, str] = {}
    faults: list[str] = []
    for what, path in paths.items():
        if path is None:
            continue
        try:
            WRITERS[what](wafer, found, path)
        except (WaferViewerError, OSError) as fault:
            faults.append(f"{path.name} was not written, and the result is kept: {fault}")
        else:
            written["klarf" if what == "klarf18" else what] = str(path)
    return written, tuple(faults)


def _require_readable(other: Path | None) -> None:
    """Read a KLARF file before the inspection, so that an invalid one fails early."""
    from wafer_viewer.store.tables.klarf import read_klarf

    if other is not None:
        read_klarf(other)


def _beside(path: Path | None, wafer: Wafer, found: Inspection) -> dict[str, Any]:
    """Return the comparison with the defects of another tool; empty without a file."""
    if path is None:
        return {}
    alignment = wafer.job.alignment if wafer.job is not None else None
    return {"other": compared(overlay_klarf(path, alignment, found), found)}


def _keep_golden(wafer: Wafer, found: Inspection, given: GivenDies, path: Path | None) -> dict[str, str]:
    from wafer_viewer.measure.defects.inspection import golden_of_surface
    from wafer_viewer.store.records.golden_dies import save_golden

    if path is None:
        return {}
    golden = golden_of_surface(wafer.surface, found.grid or dies_on(wafer, given), found.recipe, product=found.product)
    return {"golden": str(save_golden(golden, path))}


Size = Annotated[tuple[float, float], arg(metavar="W H")]


def measure_dies(
    src: Source,
    pitch_um: Place | None = None,
    origin_um: Place | None = None,
    size_um: Size | None = None,
    angle_deg: float = 0.0,
    job: File = None,
    as_given: bool = False,
    evidence: Literal["height", "picture", "both"] = "both",
    field: int = 0,
    result: str = "default",
) -> None:
    """The lattice of the dies and the state of each, whole, cut, partly or not scanned, missing; as JSON. Stage um.

    Dies are those of the dataset's own job, or as the flags say, and lie where they are seen; `off` says how far that
    is from where they were given. Without either they are found.

    Args:
        src: A NAME.wafer or a surface file, such as .x3p.
        pitch_um: From die to die along x and y; found by default. Without a corner dies are searched next to it.
        origin_um: The lower left corner of die 0,0; goes with the pitch.
        size_um: Width and height of a die without its street; found, or with a corner as the pitch, by default.
        angle_deg: How the lattice is turned, anticlockwise; goes with the corner.
        job: The PLAN.toml whose dies these are, or a KLARF or wafer map for their pitch, instead.
        as_given: Leave given dies where they were given.
        evidence: What dies are found by: heights, the all-in-focus picture, or both.
        field: A field of the dataset; 0 is the stitched surface.
        result: Name of the reconstruction.
    """
    from wafer_viewer.measure.dies.die_lattice import pitches
    from wafer_viewer.measure.dies.die_status import statuses
    from wafer_viewer.session.surface.headless import job_of, measured_surface

    given = GivenDies(pitch_um, origin_um, size_um, angle_deg, job, as_given)
    surface, calibrated = measured_surface(src, field, result)
    dies = given.on(surface, job_of(src), evidence)
    along_x, along_y = pitches(surface, dies.grid, calibration_valid=calibrated)
    states = statuses(surface, dies.grid)
    facts = {
        "grid": dies.grid,
        "off": dies.off,
        "pitch_x": along_x,
        "pitch_y": along_y,
        "counts": Counter(die.state for die in states),
        "dies": states,
        "simulated": surface.provenance.simulated,
    }
    print_json(msgspec.to_builtins(facts))


Inspected = Annotated[Positional[tuple[Path, ...]], arg(metavar="FILE ...")]
Output = Annotated[Path | None, arg(aliases=("-o",), metavar="FILE|FOLDER")]


def lot(
    files: Inspected,
    out: Output = None,
    csv: File = None,
    json: bool = False,
    tests: Annotated[tuple[Path, ...], arg(metavar="FILE ...")] = (),
    max_per_die: Count = None,
    result: str = "default",
) -> int:
    """Pareto charts, stack, yield, kill ratios and the control chart of defect density of inspected wafers.

    Prints tables, or JSON into a pipe or a file. Status 1 where the density of a wafer is out of control.

    Args:
        files: Inspected wafers, NAME.wafer or KLARF, in the order of the control chart.
        out: A report, FILE.html or FILE.pdf, or a folder for lot.html, lot.csv and lot.json.
        csv: Write all numbers as a table.
        json: Print JSON also on a terminal.
        tests: Wafer maps with test results, E142 or SINF, found by their wafer ids; for yield and kill ratios.
        max_per_die: Largest number of defects of a good die, without test results; that of each inspection by default.
        result: Name of the reconstruction of datasets.
    """
    from wafer_viewer.measure.defects.lot_statistics import lot_statistics, stacked_defects
    from wafer_viewer.session.inspection.lot_files import read_wafer_defects
    from wafer_viewer.session.reporting.lot_report import write_lot_report
    from wafer_viewer.store.tables.wafer_map_reader import read_wafer_map

    wafers = [read_wafer_defects(path, result) for path in files]
    found = lot_statistics(wafers, tests=[read_wafer_map(path) for path in tests], max_per_die=max_per_die)
    stack = stacked_defects(wafers)
    _write_statistics(found, found.rows, out, csv, "lot", lambda path: write_lot_report(found, stack, path))
    if to_program(json):
        print_json(msgspec.to_builtins(found))
    else:
        print_statistics(found.rows)
    for note in (*found.notes, *stack.notes):
        warn(note)
    return NOT_PASSED if found.outside else 0


Earlier = Annotated[Positional[Path], arg(metavar="EARLIER")]
Later = Annotated[Positional[Path], arg(metavar="LATER")]


def adders(
    first: Earlier,
    second: Later,
    out: Output = None,
    csv: File = None,
    json: bool = False,
    within_um: Um = None,
    max_added: Count = None,
    result: str = "default",
) -> int:
    """The defects that two inspections of a wafer have in common, and those added and removed between them.

    Prints tables, or JSON into a pipe or a file. Status 1 where more defects were added than permitted.

    Args:
        first: The earlier inspection, NAME.wafer or KLARF.
        second: The later inspection.
        out: A report, FILE.html or FILE.pdf, or a folder for adders.html, adders.csv and adders.json.
        csv: Write all numbers as a table.
        json: Print JSON also on a terminal.
        within_um: Largest distance of the same defect; by the uncertainty of both places by default.
        max_added: Largest number of added defects.
        result: Name of the reconstruction of datasets.
    """
    from wafer_viewer.measure.defects.adders import adders as compared_inspections
    from wafer_viewer.session.inspection.lot_files import read_wafer_defects
    from wafer_viewer.session.reporting.lot_report import write_adders_report

    earlier, later = (read_wafer_defects(path, result) for path in (first, second))
    found = compared_inspections(earlier, later, within_um=within_um)
    _write_statistics(found, found.rows, out, csv, "adders", lambda path: write_adders_report(found, later, path))
    if to_program(json):
        print_json(msgspec.to_builtins(found))
    else:
        print_statistics(found.rows)
    for note in found.notes:
        warn(note)
    return NOT_PASSED if max_added is not None and len(found.added) > max_added else 0


def _write_statistics(
    found: Spec,
    rows: tuple[StatisticsRow, ...],
    out: Path | None,
    csv: Path | None,
    name: str,
    write_page: Callable[[Path], Path],
) -> None:
    """Write the requested files: a page, or all of them into a folder, and a table."""
    from wafer_viewer.store.io.atomic_files import make_folder, write_text
    from wafer_viewer.store.tables.csv_tables import statistics_csv

    tables = [path for path in (csv,) if path is not None]
    if out is not None and out.suffix:
        write_page(out)
    elif out is not None:
        make_folder(out)
        write_page(out / f"{name}.html")
        write_text(out / f"{name}.json", encode(found, "json"))
        tables.append(out / f"{name}.csv")
    for path in tables:
        write_text(path, statistics_csv(rows))
