"""The report of a dataset: gathered from what lies in its folder, so that the page and the command line make the same.

No clock is read: the same dataset makes the same bytes. Whether lengths are calibrated is asked of the day of the scan.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from wafer_viewer.draw.numbers import number
from wafer_viewer.model.findings import AnyFinding
from wafer_viewer.model.notebook import Notebook, keys_of_features, keys_under_review
from wafer_viewer.model.report import PART_TITLES, Contents, Figure, Holds, Part, Report, ReportOrder, Section, Table
from wafer_viewer.model.verdict import Judged, WaferVerdict
from wafer_viewer.session.judging import kept_verdict
from wafer_viewer.session.report_words import (
    bounds_um,
    calibration_pairs,
    feature_row,
    plan_pairs,
    quantity_text,
    recipe_pairs,
    result_row,
    surface_pairs,
    verdict_text,
)
from wafer_viewer.session.state import SurfaceInfo

if TYPE_CHECKING:
    from wafer_viewer.store.dataset import Dataset
    from wafer_viewer.store.result import Result

MOST_PLACES = 24
"""Results beyond that have no picture of their own: the report stays of a size to be sent."""
RESULT_HEADS = ("No.", "Result", "What, on which heights", "Value, k = 2", "x, y of the stage, µm", "Judgement")


@dataclass(frozen=True, slots=True)
class Material:
    """What the parts of a report are made from."""

    dataset: Dataset
    result: Result
    info: SurfaceInfo | None
    findings: tuple[AnyFinding, ...]
    notebook: Notebook
    verdict: WaferVerdict | None = None

    @property
    def day(self) -> str:
        """The day of the scan, ISO 8601."""
        return self.dataset.scan.taken[:10]

    @property
    def uncalibrated(self) -> str | None:
        """Why lengths are not calibrated, or None."""
        return self.dataset.calibration_problem(self.day)

    @property
    def features(self) -> tuple[Judged, ...]:
        """The features of the verdict, if there is one."""
        return self.verdict.items if self.verdict is not None else ()


def report_of(folder: Path, result: str, order: ReportOrder) -> Report:
    """The report of a dataset, with what was ordered. Raises DatasetError when the folder is no dataset."""
    material = gather(folder, result)
    return Report(
        title=order.title.strip() or material.dataset.path.stem,
        below=_below(material, order),
        simulated=material.dataset.simulated,
        facts=_facts(material),
        sections=tuple(_MADE[part](material) for part in order.parts if part != "pictures" or _taken(material)),
    )


def make_report(folder: Path, result: str, order: ReportOrder, out: Path) -> Path:
    """Write the report of a dataset to a file; returns its path."""
    from wafer_viewer.store.report import write_report

    write_report(report_of(folder, result, order), out)
    return out


def gather(folder: Path, result_name: str) -> Material:
    """Read what a report needs of a dataset. Raises DatasetError when the folder is none."""
    from wafer_viewer.session.summary import load_summary
    from wafer_viewer.store.dataset import Dataset
    from wafer_viewer.store.notebook import read_notebook

    dataset = Dataset.open(folder)
    result = dataset.result(result_name)
    info = load_summary(result) if result.has_mosaic else None
    return Material(dataset, result, info, result.findings().items, read_notebook(result.path), kept_verdict(result))


def contents(folder: Path, result_name: str) -> Contents:
    """What each part would hold; nothing is drawn for it. Raises DatasetError when the folder is no dataset."""
    material = gather(folder, result_name)
    info, plan, why = material.info, material.dataset.scan.plan, material.uncalibrated
    pictures, warnings = len(_taken(material)), len(_warnings(material).sentences)
    taken = _count(pictures, "picture") if pictures else "no pictures yet: key P takes one"
    points = f"{number(info.cols, 0)} × {number(info.rows, 0)} points" if info is not None else "not stitched yet"
    settled = info is not None and info.settled is not None
    return {
        "results": _results_held(material),
        "pictures": Holds(taken, nothing=not pictures),
        "surface": Holds(points, nothing=info is None),
        "plan": Holds(f"{_count(len(plan.fields), 'field')} of {_count(plan.sweep.n_frames, 'frame')}"),
        "recipe": Holds("the settings that were used" if settled else "the settings that were asked for"),
        "calibration": Holds("lengths are calibrated" if why is None else f"uncalibrated: {why}"),
        "warnings": Holds(_count(warnings, "warning") if warnings else "no warnings"),
    }


def _results_held(material: Material) -> Holds:
    """Counts of features and results, and how many of them people judged."""
    counts = ((len(material.features), "feature"), (len(material.findings), "result"))
    said = [_count(n, word) for n, word in counts if n]
    if not said:
        return Holds("no results yet", nothing=True)
    judged = material.notebook.judged(keys_under_review(material.verdict, material.findings))
    return Holds(", ".join([*said, f"{judged} judged"]))


def _count(n: int, word: str) -> str:
    return f"{number(n, 0)} {word}{'' if n == 1 else 's'}"


def _below(material: Material, order: ReportOrder) -> str:
    name = f"{material.dataset.path.stem} · " if order.title.strip() else ""
    taken = material.dataset.scan.taken.replace("T", " ")[:16]
    return f"{name}taken {taken} · result {material.result.name}"


def _facts(material: Material) -> tuple[tuple[str, str], ...]:
    scan, sample = material.dataset.scan, material.dataset.scan.job.sample
    named = (
        ("Sample", sample.name),
        ("Lot", sample.lot),
        ("Wafer", sample.wafer_id),
        ("Product", sample.product or scan.job.product),
        ("Operator", sample.operator),
        ("Instrument", scan.rig or scan.imported_from),
        ("Program", f"Wafer Viewer {scan.software_version}"),
        ("Verdict", verdict_text(material.verdict) if material.verdict else ""),
        ("Lengths", "calibrated" if material.uncalibrated is None else f"uncalibrated: {material.uncalibrated}"),
    )
    return tuple((name, value) for name, value in named if value)


def _results(material: Material) -> Section:
    keyed = enumerate(zip(keys_of_features(material.verdict), material.features, strict=True), 1)
    judged = [feature_row(n, feature, material.notebook.judgement(key)) for n, (key, feature) in keyed]
    rows = (*judged, *(result_row(finding, material.notebook) for finding in material.findings))
    figures = tuple(
        figure for finding in material.findings[:MOST_PLACES] if (figure := _place(material, finding)) is not None
    )
    return Section(
        PART_TITLES["results"],
        table=Table(RESULT_HEADS, rows, "n"),
        figures=figures,
        empty="No results were kept.",
    )


def _place(material: Material, finding: AnyFinding) -> Figure | None:
    """The surface round the place of a result, where it was measured on the stitched one."""
    from wafer_viewer.session.report_pictures import place_picture

    box, info = bounds_um(finding), material.info
    if box is None or info is None or finding.show != 0:
        return None
    url = place_picture(material.result.mosaic(), box, info.low_um, info.high_um)
    caption = f"{finding.number} · {finding.name}: {quantity_text(finding.main)}"
    return Figure(url, caption, small=True) if url else None


def _pictures(material: Material) -> Section:
    from wafer_viewer.session.report_pictures import taken_picture

    figures = tuple(Figure(taken_picture(picture), picture.stem) for picture in _taken(material))
    return Section(PART_TITLES["pictures"], figures=figures, empty="No pictures were taken at print size.")


def _taken(material: Material) -> list[Path]:
    """The pictures beside the dataset, in the order of their numbers."""
    from wafer_viewer.store.files import natural

    path = material.dataset.path
    return sorted(path.parent.glob(f"{path.stem}-picture-*.png"), key=lambda p: natural(p.name))


def _surface(material: Material) -> Section:
    from wafer_viewer.session.report_pictures import whole_picture

    info, title = material.info, PART_TITLES["surface"]
    if info is None:
        return Section(title, empty="The fields are not stitched.")
    url = whole_picture(material.result.mosaic(), info.low_um, info.high_um)
    ends = f"{number(info.low_um, 2, signed=True)} to {number(info.high_um, 2, signed=True)}\u202fµm"
    caption = f"Heights from above, dark to light {ends}, light from the north-west; plain grey: not measured."
    return Section(title, pairs=surface_pairs(info), figures=(Figure(url, caption),))


def _plan(material: Material) -> Section:
    scan = material.dataset.scan
    return Section(PART_TITLES["plan"], pairs=plan_pairs(scan.plan, scan.job))


def _recipe(material: Material) -> Section:
    settled = material.info.settled if material.info else None
    pairs = recipe_pairs(settled or material.dataset.scan.job.recipe)
    return Section(PART_TITLES["recipe"], pairs=pairs)


def _calibration(material: Material) -> Section:
    calibration = material.dataset.scan.calibration
    why = (f"Lengths are uncalibrated: {material.uncalibrated}.",) if material.uncalibrated else ()
    pairs = calibration_pairs(calibration) if calibration else ()
    return Section(PART_TITLES["calibration"], pairs=pairs, sentences=why)


def _warnings(material: Material) -> Section:
    dataset, info = material.dataset, material.info
    missing = len(dataset.missing())
    said = [f"{number(missing, 0)} of {number(dataset.scan.plan.n_frames, 0)} frames are missing."] if missing else []
    if info is not None:
        said += [*info.recipe_notes, *(info.stitching.notes if info.stitching else ())]
    said += [f"Result {f.number}, {f.name}: {note}" for f in material.findings for note in f.notes]
    told = tuple(dict.fromkeys(sentence.replace(" um", "\u202fµm") for sentence in said))
    return Section(PART_TITLES["warnings"], sentences=told, empty="None.")


_MADE: dict[Part, Callable[[Material], Section]] = {
    "results": _results,
    "pictures": _pictures,
    "surface": _surface,
    "plan": _plan,
    "recipe": _recipe,
    "calibration": _calibration,
    "warnings": _warnings,
}
