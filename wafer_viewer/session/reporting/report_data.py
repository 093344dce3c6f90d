"""Data and texts of a report, read once from a dataset's folder."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime, tzinfo
from itertools import chain, islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from wafer_viewer.draw.charts.marked_map import Mark
from wafer_viewer.draw.number_format import THIN, digits_of_u, duration, number, share, size, value_and_u, with_unit
from wafer_viewer.draw.quantities import UNIT_SIGNS, explained_quantity, row_text, with_unit_sign
from wafer_viewer.model.acquisition.calibration import Calibration
from wafer_viewer.model.acquisition.plan import ScanPlan
from wafer_viewer.model.acquisition.positioners import ROLES, PositionerReading
from wafer_viewer.model.errors import WaferViewerError
from wafer_viewer.model.findings import AnyResult
from wafer_viewer.model.gauge import GaugeCheck
from wafer_viewer.model.inspection.defect import Inspection
from wafer_viewer.model.job import FeatureVerdict, Job, Judgement, Notebook, WaferVerdict, key_of_result
from wafer_viewer.model.measurement.feature import Feature, limits_text, on_die
from wafer_viewer.model.measurement.result_rows import rows, spaced, title_of
from wafer_viewer.model.measurement.tools import TOOLS
from wafer_viewer.model.quantity import BudgetLine
from wafer_viewer.model.region import Region
from wafer_viewer.model.report import Laboratory, zone_of
from wafer_viewer.model.roles import AuditEntry
from wafer_viewer.model.spec import decode
from wafer_viewer.model.surface.focus_measures import focus_measures
from wafer_viewer.model.surface.height_map import LAYER_TITLES, Mosaic
from wafer_viewer.session.planning.job_releases import release_of
from wafer_viewer.session.planning.verdicts import stored_verdict
from wafer_viewer.session.state.snapshot import SurfaceInfo

if TYPE_CHECKING:
    from wafer_viewer.store.dataset.dataset import Dataset
    from wafer_viewer.store.dataset.result import Result


VERDICTS = {"open": "", "accepted": "accepted", "rejected": "rejected"}
Pairs = tuple[tuple[str, str], ...]


def result_row(finding: AnyResult, notebook: Notebook) -> tuple[str, ...]:
    """Return number, name, kind, value, position and judgement of a result."""
    judged = judgement_text(notebook.judgement(key_of_result(finding.number)))
    return (
        f"{finding.number}",
        finding.name,
        kind_of(finding),
        explained_quantity(finding.main),
        where(finding),
        judged,
    )


MOST_LETTERS = 160
"""Letters of a text beside a label; longer ones are omitted."""


def numbers_of(finding: AnyResult) -> Pairs:
    """Return label and text of all numbers of a result but the main one."""
    listed = rows(finding, frozenset({finding.main_field}))
    texts = ((row.label.title, row_text(row).replace(" um", "\u202fµm")) for row in listed)
    return tuple((title, text) for title, text in texts if text and len(text) <= MOST_LETTERS)


def budget_of(finding: AnyResult) -> tuple[BudgetLine, ...]:
    """Return the budget lines of the main quantity's uncertainty (k = 1), or those of the result itself."""
    if finding.main.budget:
        return finding.main.budget
    lines: Any = getattr(finding, "budget", ())
    return tuple(line.general for line in lines)


def not_evaluated(finding: AnyResult) -> tuple[str, ...]:
    """Return the known contributions missing from the uncertainty, by its own list or by its notes."""
    listed: tuple[str, ...] = tuple(getattr(finding, "not_evaluated", ()))
    noted = (note.removeprefix(MISSING).rstrip(".").split(", ") for note in finding.notes if note.startswith(MISSING))
    return (*listed, *chain.from_iterable(noted))


MISSING = "Not in the budget: "
"""Beginning of the notes that name contributions missing from the uncertainty."""


def notes_of(finding: AnyResult) -> tuple[str, ...]:
    """Return the notes of a result but those on its uncertainty."""
    return tuple(note.replace(" um", "\u202fµm") for note in finding.notes if not note.startswith(MISSING))


def kind_of(finding: AnyResult) -> str:
    """Return the kind of a result, with its height layer and datum."""
    return f"{spaced(type(finding).__name__)}{_terms(finding)}"


def feature_row(n: int, judged: FeatureVerdict, judgement: Judgement) -> tuple[str, ...]:
    """Return number and name of a feature of the job, its limits and value, the verdict and people's judgement."""
    feature = judged.feature
    value = explained_quantity(judged.measured) if judged.measured is not None else "not measured"
    quantity = f", {title_of(TOOLS[feature.tool].result, feature.quantity)}" if feature.quantity else ""
    return (
        f"F{n}",
        f"{judged.name}{quantity}",
        limits_of(feature),
        value,
        judged.word.upper(),
        judgement_text(judgement),
    )


def limits_of(feature: Feature) -> str:
    """Return the limits of a feature, and the rule that it is judged by."""
    limits = limits_text(feature).replace(f" {feature.unit}", f"\u202f{UNIT_SIGNS[feature.unit]}")
    return f"{limits}, {feature.decision_rule.replace('_', ' ')}"


def verdict_text(verdict: WaferVerdict) -> str:
    """Return the verdict on the wafer, and its job."""
    return f"{verdict.word.upper()}{f', {verdict.job}' if verdict.job else ''}"


def judgement_text(judgement: Judgement) -> str:
    """Return people's verdict on an item, and their note."""
    return " · ".join(part for part in (VERDICTS[judgement.verdict], judgement.note) if part)


def regions(finding: AnyResult) -> tuple[Region, ...]:
    """Return the regions of a result."""
    held = (getattr(finding, name) for name in finding.__struct_fields__)
    return tuple(region for value in held for region in _regions_of(value))


def bounds_of(places: tuple[Region, ...]) -> tuple[float, float, float, float]:
    """Return the upright rectangle around regions, at least one."""
    x0, y0, x1, y1 = zip(*(region.bounds_um for region in places), strict=True)
    return min(x0), min(y0), max(x1), max(y1)


def where(finding: AnyResult) -> str:
    """Return the centre of the regions of a result, stage um."""
    places = regions(finding)
    if not places:
        return ""
    box = bounds_of(places)
    prefix = f"field {finding.show}, " if finding.show > 0 else ""
    x, y = ((box[k] + box[k + 2]) / 2 for k in (0, 1))
    return f"{prefix}x{THIN}{number(x, 1)}, y{THIN}{with_unit(y, 1)}"


def value_pair(value: float, expanded: float, unit: str = "") -> str:
    """Return a value with its U (k = 2), U to two significant digits and the value to match."""
    return with_unit_sign("{} ± {}".format(*value_and_u(value, expanded)), unit).rstrip(THIN) + " (k = 2)"


def surface_pairs(info: SurfaceInfo) -> Pairs:
    """Return the numbers of the surface."""
    rows = [
        ("Size", f"{number(info.cols, 0)} × {number(info.rows, 0)} points, {number(info.pixel_um, 4)}\u202fµm apart"),
        ("Fields", f"{info.n_fields}"),
        ("Highest", with_unit(info.highest_um, 2, signed=True)),
        ("Lowest", with_unit(info.lowest_um, 2, signed=True)),
        ("Measured", share(info.measured_fraction)),
        ("Filled", share(info.filled_fraction)),
    ]
    if info.overlap_rms_um is not None:
        rows.append(("Height difference in overlaps, rms", with_unit(info.overlap_rms_um, 2)))
    if (placed := info.stitching) is not None:
        rows += [
            ("Overlaps accepted", f"{placed.n_believed} of {placed.n_overlaps}"),
            ("Places, U (k = 2)", with_unit(placed.position_u_um, digits_of_u(placed.position_u_um))),
            ("Heights of fields, U (k = 2)", with_unit(placed.height_u_um, digits_of_u(placed.height_u_um))),
        ]
    rows += [("Not measured", words) for words in _reasons(info)]
    return tuple(rows)


def _reasons(info: SurfaceInfo) -> Iterator[str]:
    missing = 1.0 - info.measured_fraction
    reasons = ", ".join(f"{share(part)} {words}" for words, part in info.unmeasured if part > 0)
    if missing > 0:
        yield f"{share(missing)}: {reasons}" if reasons else share(missing)


def unmeasured_words(info: SurfaceInfo) -> Iterator[str]:
    """Yield how much of the surface is not measured, with the reasons; nothing if all is."""
    for reasons in _reasons(info):
        amount, _, why = reasons.partition(": ")
        yield f"{amount} of the surface is not measured{f': {why}' if why else ''}."


def local_time(iso: str, zone: tzinfo) -> datetime | None:
    """Return a time in a time zone, as it is without an offset; None if it is only a day, or none."""
    try:
        at = datetime.fromisoformat(iso)
    except ValueError:
        return None
    if at.tzinfo is None:
        return at if len(iso) > len("2026-03-01") else None
    return at.astimezone(zone)


def time_words(iso: str, zone: tzinfo) -> str:
    """Return a time to the minute in a time zone, ``2026-03-01 10:00 UTC``; without an offset, or no time, as it is."""
    at = local_time(iso, zone)
    if at is None or at.tzinfo is None:
        return iso if at is None else f"{at:%Y-%m-%d %H:%M}"
    offset = f"{at:%z}"
    return f"{at:%Y-%m-%d %H:%M} " + ("UTC" if zone is UTC else f"{offset[:3]}:{offset[3:]}")


LABORATORY = "laboratory.toml"
NO_LABORATORY = Laboratory(name="")


def laboratory_of(folder: Path) -> Laboratory:
    """Return the laboratory of a data folder; one without a name if none is given. Raises DatasetError."""
    path = folder / LABORATORY
    return decode(path.read_bytes(), Laboratory, path.name) if path.exists() else NO_LABORATORY


def names_of(material: Material) -> Iterator[str]:
    """Yield the names and texts that people gave, and what is quoted as recorded: no language changes them."""
    scan, sample = material.dataset.scan, material.dataset.scan.job.sample
    yield from (sample.name, sample.lot, sample.wafer_id, sample.product, sample.operator, scan.job.product)
    yield from (scan.rig, scan.imported_from, scan.setup.objective, scan.setup.camera, material.result.name)
    yield material.dataset.path.stem
    yield from (reading.name for reading in scan.positioners)
    yield from (measure.title for measure in focus_measures().values())
    if (verdict := material.verdict) is not None:
        yield verdict.job
        yield from (name for item in verdict.items for name in (item.name, item.feature.name))
    if (calibration := scan.calibration) is not None:
        yield from (calibration.against, *calibration.z_against, calibration.setup.objective, calibration.setup.camera)
    yield from (finding.name for finding in material.findings)
    yield from (judgement.note for judgement in material.notebook.judgements)
    yield from (text for check in material.gauge_checks for text in (check.certificate.laboratory, check.signed_by))
    yield from (text for entry in material.actions for text in (entry.by, entry.action, entry.detail, entry.subject))


def method_words(material: Material) -> str:
    """Return how heights were measured."""
    scan, settled = material.dataset.scan, material.info.settled if material.info else None
    if not material.dataset.fields:
        return f"heights of the file {scan.imported_from}" if scan.imported_from else "heights of a file"
    measure = focus_measures()[(settled or scan.job.recipe).focus_measure].title
    return f"shape from focus ({measure}), fields stitched by their overlaps"


def outline_um(surface: Mosaic) -> tuple[float, float, float, float]:
    """Return (x low, y low, x high, y high) of the pixel centres of a surface."""
    rows, cols = surface.shape
    x0, y0, pixel_um = surface.x0_um, surface.y0_um, surface.pixel_um
    return x0, y0 - (rows - 1) * pixel_um, x0 + (cols - 1) * pixel_um, y0


def regions_of_feature(job: Job, judged: FeatureVerdict) -> tuple[Region, ...]:
    """Return where a feature was measured, stage um; empty if it has no place."""
    from wafer_viewer.measure.verdict import on_stage

    die = next((die for die in job.dies.all() if die.name == judged.die), None) if job.dies and judged.die else None
    placed = judged.feature.places if die is None else tuple(on_die(place, die) for place in judged.feature.places)
    return tuple(on_stage(place, job.alignment) for place in placed)


MOST_MARKS = 60
"""Places that are numbered on the map."""


def marks_of(material: Material) -> tuple[Mark, ...]:
    """Return the numbered places of features and of results on the stitched surface, as many as a map can hold."""
    job = material.dataset.scan.job
    features = (Mark(f"F{n}", regions_of_feature(job, item)) for n, item in enumerate(material.features, 1))
    results = (Mark(f"{finding.number}", finding.inputs) for finding in material.findings if finding.show == 0)
    return tuple(islice((mark for mark in chain(features, results) if mark.regions), MOST_MARKS))


def plan_pairs(plan: ScanPlan, job: Job) -> Pairs:
    """Return the scan's fields, frames, exposures and strategy."""
    grid = f", {job.grid.rows} rows × {job.grid.cols} columns" if job.grid else ""
    return (
        ("Fields", f"{len(plan.fields)}{grid}"),
        ("Frames per field", f"{plan.frames_each}, {number(plan.sweep.z_step_um, 3)}\u202fµm apart"),
        ("Exposures", ", ".join(f"{e:g}" for e in plan.exposures_us) + "\u202fµs" if plan.exposures_are_known else "–"),
        ("Strategy", plan.strategy.replace("_", " ")),
        ("Predicted time", duration(plan.predicted_s)),
        ("Frames", f"{number(plan.n_frames, 0)}, {size(plan.bytes_on_disk)}"),
    )


def positioner_pairs(readings: Iterable[PositionerReading]) -> Pairs:
    """Return the positions of light, objective, zoom, tilts and rotation at the start of a scan."""
    return tuple((f"{ROLES[one.role].title} ({one.name})", one.words.replace(" deg", "°")) for one in readings)


def calibration_pairs(calibration: Calibration) -> Pairs:
    """Return pixel size and z scale with uncertainty, setup, reference standard and validity dates."""
    setup = calibration.setup
    return (
        ("Pixel", value_pair(calibration.pixel_um, 2 * calibration.u_pixel_um, "µm")),
        ("z scale", value_pair(calibration.z_scale, 2 * calibration.u_z_scale)),
        ("Objective", setup.objective or "–"),
        ("Camera", setup.camera or "–"),
        ("Against", calibration.against),
        ("Made, due", f"{calibration.made}, {calibration.due}"),
        *((("z scale set by gauge blocks", ", ".join(calibration.z_against)),) if calibration.z_against else ()),
    )


def _terms(finding: AnyResult) -> str:
    """Return the height layer and the levelling of a result."""
    levelled = "" if finding.levelling.by == "stage" else f", levelled by {finding.levelling.by}"
    return f", {LAYER_TITLES[finding.surface]}{levelled}"


def _regions_of(value: Any) -> Iterator[Region]:
    if isinstance(value, Region):
        yield value
    elif isinstance(value, tuple):
        yield from (item for item in cast(tuple[Any, ...], value) if isinstance(item, Region))


@dataclass(frozen=True, slots=True)
class Material:
    """Input data of the report's parts.

    actions: what people did to the dataset and its job, oldest first; audit_fault: reason why that cannot be given.
    """

    dataset: Dataset
    result: Result
    info: SurfaceInfo | None
    findings: tuple[AnyResult, ...]
    notebook: Notebook
    verdict: WaferVerdict | None = None
    inspection: Inspection | None = None
    actions: tuple[AuditEntry, ...] = ()
    audit_fault: str = ""
    laboratory: Laboratory = NO_LABORATORY

    def time(self, iso: str) -> str:
        """Return a time as the laboratory writes it."""
        return time_words(iso, zone_of(self.laboratory.zone))

    @property
    def day(self) -> str:
        """Day of the scan, ISO 8601."""
        return self.dataset.scan.taken[:10]

    @property
    def uncalibrated(self) -> str | None:
        """Reason why lengths are not calibrated, or None."""
        return self.dataset.calibration_problem(self.day)

    @property
    def features(self) -> tuple[FeatureVerdict, ...]:
        """Features of the verdict; empty if there is none."""
        return self.verdict.items if self.verdict is not None else ()

    @property
    def asks_for_a_verdict(self) -> bool:
        """True if the job has features to be judged."""
        return any(feature.has_place for feature in self.dataset.scan.job.features)

    @property
    def gauge_checks(self) -> tuple[GaugeCheck, ...]:
        """Gauge-block checks among the results."""
        return tuple(finding for finding in self.findings if isinstance(finding, GaugeCheck))

    @property
    def pictures(self) -> list[Path]:
        """Pictures next to the dataset, in the order of their numbers."""
        from wafer_viewer.store.io.atomic_files import natural_sort_key

        path = self.dataset.path
        return sorted(path.parent.glob(f"{path.stem}-picture-*.png"), key=lambda p: natural_sort_key(p.name))


def gather(folder: Path, result_name: str) -> Material:
    """Read the report data of a dataset. Raises DatasetError when the folder is no dataset."""
    from wafer_viewer.session.core.dataset_library import load_summary
    from wafer_viewer.store.dataset.dataset import Dataset
    from wafer_viewer.store.records.inspection_records import read_inspection, read_notebook

    dataset = Dataset.open(folder)
    result = dataset.result(result_name)
    info = load_summary(result) if result.has_mosaic else None
    return Material(
        dataset,
        result,
        info,
        result.findings().items,
        read_notebook(result.path),
        stored_verdict(dataset, result),
        read_inspection(result.path),
        *_audited(dataset),
        laboratory_of(dataset.path.parent),
    )


def _audited(dataset: Dataset) -> tuple[tuple[AuditEntry, ...], str]:
    """Return the entries of the audit log on a dataset, after the release of its job; or none, and the reason."""
    from wafer_viewer.store.records.signed_log import recorded_actions

    folder = dataset.path.absolute().parent
    try:
        released = release_of(folder, dataset.scan.job)
        actions = recorded_actions(folder, dataset.path.name)
    except WaferViewerError as fault:
        return (), f"The audit log cannot be relied on: {fault}"
    return ((released,) if released is not None else ()) + actions, ""
