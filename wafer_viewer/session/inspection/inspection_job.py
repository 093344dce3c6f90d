"""Defect inspection of a dataset on a task runner: rows of dies are compared on workers.

The reference data may be large. They are stored in a temporary file with the result, and every worker reads them once.
"""

from __future__ import annotations

import hashlib
import math
import time
from collections.abc import Generator, Iterable, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal
from uuid import uuid4

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.compute.task_runner import Done, LocalRunner, TaskRunner
from wafer_viewer.model.acquisition.sample import Alignment, Sample
from wafer_viewer.model.errors import ComputeError, DatasetError, DiesNotFound, MeasureError, WaferViewerError
from wafer_viewer.model.inspection.defect import FORM_SEES, Against, DefectRecipe, Inspection
from wafer_viewer.model.inspection.die_grid import DieGrid, ProductDies
from wafer_viewer.model.inspection.golden_die import GoldenDie
from wafer_viewer.model.inspection.klarf import KlarfExport
from wafer_viewer.model.job import Job
from wafer_viewer.model.progress import Progress, ShouldStop, never, silent
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.height_map import Mosaic
from wafer_viewer.session.core.dataset_library import today
from wafer_viewer.session.surface.headless import LocalOrCluster, is_dataset, measured_surface
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.io.atomic_files import remove
from wafer_viewer.store.mosaic.poses_file import read_planes, write_planes

if TYPE_CHECKING:
    from wafer_viewer.measure.defects.cell_comparison import CellResult, ComparisonWork
    from wafer_viewer.measure.defects.golden_die import ReferenceDie
    from wafer_viewer.measure.defects.noise_model import NoiseModel
    from wafer_viewer.measure.dies.die_cells import Place
    from wafer_viewer.measure.dies.given_lattice_fit import FittedDies
    from wafer_viewer.store.dataset.result import Result


# --------------------------------------------------------------------------------------------------- die lattice source


Evidence = Literal["height", "picture", "both"]


@dataclass(frozen=True, slots=True)
class GivenDies:
    """Die lattice given by an operator: pitch, lower left corner of die 0,0 (stage um) and size, or a file's.

    None: the dies of the dataset's own job, or detected on the surface. Without a corner the dies are detected, next to
    this pitch and of this size; with one they are as large as their pitch by default. job: a job, or a KLARF or
    wafer map for its pitch. as_given: the dies are not fitted to the surface.
    """

    pitch_um: tuple[float, float] | None = None
    origin_um: tuple[float, float] | None = None
    size_um: tuple[float, float] | None = None
    angle_deg: float = 0.0
    job: Path | None = None
    as_given: bool = False

    def __post_init__(self) -> None:
        if self.pitch_um is None and (self.size_um is not None or self.origin_um is not None):
            raise MeasureError("The size and the corner of dies go with their pitch: give --pitch-um too.")
        if self.origin_um is None and (self.angle_deg or self.as_given):
            raise MeasureError("The angle of dies, and --as-given, go with their corner: give --origin-um too.")
        if self.pitch_um is not None and self.job is not None:
            raise MeasureError("Dies are given by a file or by their pitch: leave --job or --pitch-um out.")

    def known(self, dataset_job: Job | None) -> bool:
        """Return whether the place of dies is given or named by a job, so that none have to be detected."""
        of_job = self.job is not None and is_job(self.job)
        return self.origin_um is not None or of_job or dies_of_job(dataset_job) is not None

    def on(self, surface: Mosaic, dataset_job: Job | None = None, evidence: Evidence = "both") -> FittedDies:
        """Return the dies over a surface; `dataset_job`: the job that it was scanned by.

        Raises MeasureError if there are none, PlanError for a job that cannot be read or lists its dies one by one.
        """
        from wafer_viewer.measure.dies.die_lattice import find_dies, over_surface
        from wafer_viewer.measure.dies.given_lattice_fit import FittedDies

        if self.origin_um is not None:
            fitted = self._fitted(surface, self._lattice(), evidence)
            return FittedDies(over_surface(fitted.grid, surface), fitted.off)
        if (size := self._size(dataset_job)) is None:
            named = self._of_file(dataset_job) if self.job is not None else dies_of_job(dataset_job)
            if named is not None:
                return self._fitted(surface, named, evidence)
        return FittedDies(find_dies(surface, evidence=evidence, size=size))

    def _size(self, dataset_job: Job | None) -> ProductDies | None:
        """Return the pitch and size of dies whose place is not known: given, of a file, or of an unaligned job."""
        if self.pitch_um is not None:
            width_um, height_um = self.size_um or (0.0, 0.0)
            pitch = {"pitch_x_um": self.pitch_um[0], "pitch_y_um": self.pitch_um[1]}
            return ProductDies(**pitch, width_um=width_um, height_um=height_um)
        if self.job is not None:
            return None if is_job(self.job) else size_of_file(self.job)
        return size_of_job(dataset_job) if dies_of_job(dataset_job) is None else None

    def _fitted(self, surface: Mosaic, grid: DieGrid, evidence: Evidence) -> FittedDies:
        from wafer_viewer.measure.dies.given_lattice_fit import FittedDies, fitted_dies

        return FittedDies(grid) if self.as_given else fitted_dies(surface, grid, evidence)

    def _lattice(self) -> DieGrid:
        pitch_um, origin_um = self.pitch_um or (0.0, 0.0), self.origin_um or (0.0, 0.0)
        width_um, height_um = self.size_um or pitch_um
        return DieGrid(
            pitch_x_um=pitch_um[0],
            pitch_y_um=pitch_um[1],
            x0_um=origin_um[0],
            y0_um=origin_um[1],
            width_um=width_um,
            height_um=height_um,
            angle_rad=math.radians(self.angle_deg),
        )

    def _of_file(self, dataset_job: Job | None) -> DieGrid:
        """Return the dies of the job file, with the wafer alignment of the scan's own job if the file has none."""
        from wafer_viewer.session.planning.job_releases import read_job

        path = self.job or Path()
        job = read_job(path)
        if job.dies is None:
            raise MeasureError(f"{path.name} names no dies: give --pitch-um and --origin-um, or leave --job out.")
        if job.marks is not None and job.alignment is None:
            if dataset_job is None or dataset_job.alignment is None:
                raise MeasureError(
                    f"{path.name} has its dies in wafer um and nothing says how the wafer lies on the stage: "
                    "give --pitch-um and --origin-um instead of --job."
                )
            return DieGrid.of(job.dies, dataset_job.alignment)
        return DieGrid.of(job.dies, job.alignment or Alignment())


def dies_of_job(job: Job | None) -> DieGrid | None:
    """Return the dies named by a scan's own job; None if it has no lattice, or the wafer was not aligned."""
    if job is None or job.dies is None or job.dies.listed or (job.marks is not None and job.alignment is None):
        return None
    return DieGrid.of(job.dies, job.alignment or Alignment())


def size_of_job(job: Job | None) -> ProductDies | None:
    """Return the pitch and size of the dies of a job with a lattice."""
    if job is None or job.dies is None or job.dies.listed:
        return None
    return ProductDies(**{name: getattr(job.dies, name) for name in ProductDies.__struct_fields__})


def is_job(path: Path) -> bool:
    """Return whether a file that names dies is a job, not a KLARF or a wafer map."""
    return path.suffix.lower() == ".toml"


def size_of_file(path: Path) -> ProductDies:
    """Return the pitch of the dies of a KLARF or wafer map, and their size if it states one."""
    from wafer_viewer.store.tables.klarf import read_klarf
    from wafer_viewer.store.tables.wafer_map_reader import is_wafer_map, read_wafer_map

    if not is_wafer_map(path):
        klarf = read_klarf(path)
        return ProductDies(pitch_x_um=klarf.pitch_x_um, pitch_y_um=klarf.pitch_y_um)
    stated = read_wafer_map(path)
    if not (stated.pitch_x_um and stated.pitch_y_um):
        raise DatasetError(f"{path.name} does not state the pitch of its dies: give it (--pitch-um).")
    return ProductDies(**{name: getattr(stated, name) for name in ProductDies.__struct_fields__})


# ------------------------------------------------------------------------------------------------------- inspection job


PLANES = ("z_um", "z_spread_um", "picture", "picture_spread")
BY_KEY, OF_ALL = ("spread", "fall", "places"), ("kinds", "spectrum")
BEGINS, ENDS = ".inspection-", ".npz"
LEFT_FOR_S = 86_400.0
"""Age in seconds beyond which a reference file counts as left behind by a killed process."""


@dataclass(frozen=True, slots=True)
class RowHands:
    """Task runner for the die rows of one inspection; folder: location of the temporary reference file."""

    crew: TaskRunner
    folder: Path
    should_stop: ShouldStop = never

    @classmethod
    def of(cls, crew: TaskRunner, dataset: Path, folder: Path, should_stop: ShouldStop = never) -> RowHands:
        """Create the runner for a dataset's surface.

        Raises ComputeError with the machine's name if a worker has no access.
        """
        crew.require_sight(dataset)
        return cls(crew, folder, should_stop)

    def __call__(
        self, work: ComparisonWork, noise: NoiseModel, rows: Sequence[tuple[Place, ...]]
    ) -> Generator[list[CellResult]]:
        """See `RowsBy`. Raises ComputeError when the work is stopped or no worker is left."""
        if isinstance(self.crew, LocalRunner):
            yield from self._done(compare_here, [(work, noise, row) for row in rows])
            return
        with stored_golden(self.folder, work.golden, noise) as reference:
            lean = replace(work, golden=replace(work.golden, **dict.fromkeys(PLANES, np.empty((0, 0), np.float32))))
            yield from self._done(compare_row, [(lean, reference, row) for row in rows])

    def _done(self, task: Any, items: Sequence[tuple[Any, ...]]) -> Generator[list[CellResult]]:
        with closing(self.crew.each(task, items, should_stop=self.should_stop)) as outcomes:
            yield from in_order(outcomes)


def compare_row(work: ComparisonWork, reference: Path, row: tuple[Place, ...]) -> list[CellResult]:
    """Compare the dies of one strip with the reference file, as a worker's task."""
    golden, noise = _reference(reference)
    return compare_here(replace(work, golden=replace(work.golden, **golden)), noise, row)


def compare_here(work: ComparisonWork, noise: NoiseModel, row: tuple[Place, ...]) -> list[CellResult]:
    """Compare the dies of one strip."""
    from wafer_viewer.measure.defects.cell_comparison import compare_cells

    return compare_cells(work, row, noise)


def in_order(outcomes: Iterable[Done]) -> Generator[Any]:
    """Yield the values of items in the order of the items; the first fault is raised."""
    early: dict[int, Any] = {}
    wanted = 0
    for done in outcomes:
        if done.fault is not None:
            raise done.fault
        early[done.index] = done.value
        while wanted in early:
            yield early.pop(wanted)
            wanted += 1


@contextmanager
def stored_golden(folder: Path, golden: ReferenceDie, noise: NoiseModel) -> Generator[Path]:
    """Store the reference data of the comparison in a temporary file."""
    _sweep(folder)
    path = folder / f"{BEGINS}{uuid4().hex[:12]}{ENDS}"
    write_planes(path, {name: getattr(golden, name) for name in PLANES} | _planes_of(noise))
    try:
        yield path
    finally:
        remove(path)


def _sweep(folder: Path) -> None:
    for leftover in folder.glob(f"{BEGINS}*{ENDS}"):
        if time.time() - leftover.stat().st_mtime > LEFT_FOR_S:
            remove(leftover)


@lru_cache(maxsize=1)
def _reference(path: Path) -> tuple[dict[str, NDArray[Any]], NoiseModel]:
    """Return the golden planes by name and the noise; cached from row to row."""
    planes = read_planes(path)
    return {name: planes.pop(name) for name in PLANES}, _noise_of(planes)


def _planes_of(noise: NoiseModel) -> dict[str, NDArray[Any]]:
    """Return the arrays of the noise model by name, with layer and scale where they have one."""
    facts = {name: getattr(noise, name) for name in BY_KEY}
    named = {f"{name}/{k[0]}/{k[1]!r}": value for name, by in facts.items() for k, value in by.items()}
    return named | {name: getattr(noise, name) for name in OF_ALL}


def _noise_of(planes: dict[str, NDArray[Any]]) -> NoiseModel:
    from wafer_viewer.measure.defects.noise_model import NoiseModel

    shared: dict[str, Any] = {name: planes.pop(name) for name in OF_ALL}
    facts: dict[str, dict[tuple[str, float], Any]] = {name: {} for name in BY_KEY}
    for title, value in planes.items():
        name, layer, scale = title.split("/")
        facts[name][layer, float(scale)] = value
    return NoiseModel(**facts, **shared)


Dies = DieGrid | ProductDies | Literal["found"] | None
"""Source of the die lattice: given, detected with or without a known size, or None: the job's, else detected."""
MARK_DIGITS = 16
BY_FORM = "Or compare with the fitted form (--against form)."


def inspect_dataset(
    dataset: Path,
    result: str,
    recipe: DefectRecipe,
    dies: Dies = None,
    against: Against = "dies",
    *,
    crew: TaskRunner | None = None,
    progress: Progress = silent,
    should_stop: ShouldStop = never,
) -> Inspection:
    """Inspect the stitched surface of a dataset for defects; nothing is stored.

    dies: a given lattice covers the full surface, whatever columns and rows it names. crew: runner of the die rows,
    this process by default; the outcome is the same. against "form": with the dies of the job, if it names any.

    Raises DiesNotFound if dies are to be compared and none are found, MeasureError if nothing can be inspected,
    DatasetError if there is no surface, ComputeError when stopped.
    """
    from wafer_viewer.measure.defects.inspection import inspect
    from wafer_viewer.store.dataset.dataset import Dataset
    from wafer_viewer.store.records.golden_dies import FOLDER, golden_named

    data = Dataset.open(dataset)
    stored = data.result(result)
    surface, mark, job = stored.mosaic(), mosaic_mark(stored), data.scan.job
    recipe = replace(recipe, product=recipe.product or job.product or job.sample.product)
    golden = golden_named(dataset.parent / FOLDER, recipe.golden, recipe.product) if recipe.golden else None
    known = isinstance(dies, DieGrid) or dies_of_job(job) is not None
    grid = _die_grid(dies, data, surface) if against == "dies" or known else None
    with _until_stopped(should_stop):
        inspection = inspect(
            surface,
            grid,
            recipe,
            golden,
            against=against,
            calibration_valid=data.calibration_problem(today()) is None,
            progress=progress,
            should_stop=should_stop,
            rows_by=RowHands.of(crew or LocalRunner(), data.path, stored.path, should_stop),
        )
    return with_classes_of_product(replace(inspection, mark=mark), surface, dataset.parent)


def with_classes_of_product(inspection: Inspection, surface: Mosaic, folder: Path) -> Inspection:
    """Propose classes from the judged defects of the product, if there are any; a note says why it is not possible."""
    from wafer_viewer.measure.defects.learned_classes import with_learned_classes
    from wafer_viewer.store.records.inspection_records import read_judged

    try:
        judged = read_judged(folder, inspection.product)
        return with_learned_classes(inspection, surface, (judged,)) if judged.defects else inspection
    except WaferViewerError as fault:
        return replace(inspection, notes=(*inspection.notes, f"No classes are proposed from judgements: {fault}"))


@contextmanager
def _until_stopped(should_stop: ShouldStop) -> Generator[None]:
    """Raise one ComputeError for a stopped inspection, whatever error it ended with."""
    try:
        yield
    except WaferViewerError:
        if not should_stop():
            raise
    if should_stop():
        raise ComputeError("The inspection was stopped. What was found before it is kept.")


def _die_grid(dies: Dies, data: Dataset, surface: Mosaic) -> DieGrid:
    """Return the lattice on a surface.

    Raises MeasureError if none is found, or the given one does not match its dies.
    """
    from wafer_viewer.measure.dies.die_lattice import find_dies, over_surface
    from wafer_viewer.measure.dies.given_lattice_fit import fitted_dies

    if isinstance(dies, DieGrid):
        return over_surface(fitted_dies(surface, dies).grid, surface)
    if isinstance(dies, ProductDies):
        return find_dies(surface, size=dies)
    return find_dies(surface) if dies == "found" else GivenDies().on(surface, data.scan.job).grid


def mosaic_mark(stored: Result) -> str:
    """Return a hash of the mosaic's metadata, which changes with recipe, frames or fields; a copy has the same one."""
    header = stored.mosaic_path / "zarr.json"
    return hashlib.sha256(header.read_bytes()).hexdigest()[:MARK_DIGITS] if header.exists() else ""


# ------------------------------------------------------------------------------------------------------------- headless


CLUSTER_PAYS_PX = 60_000_000
"""Number of pixels from which starting own worker processes is faster, despite their start-up time."""


@dataclass(frozen=True, slots=True, eq=False)
class Wafer:
    """Surface to inspect, with wafer data; stated: what a KLARF states of it, as far as it is known."""

    surface: Mosaic
    calibrated: bool
    sample: Sample = Sample()
    stated: KlarfExport = KlarfExport()
    job: Job | None = None
    lies_in: tuple[Path, Path] | None = None
    """Folders of its dataset and its result; None for a file."""
    before: Inspection | None = None
    """Earlier inspection, from which judgements are carried over."""


def wafer_of(src: Path, result: str) -> Wafer:
    """Return the stitched surface of a dataset, or that of a file. Raises DatasetError if there is none."""
    from wafer_viewer.store.records.inspection_records import read_inspection

    surface, calibrated = measured_surface(src, 0, result)
    if not is_dataset(src):
        return Wafer(surface, calibrated)
    data = Dataset.open(src)
    job = data.scan.job
    stated = KlarfExport.of(job.sample, job.alignment)
    folder = data.result(result).path
    return Wafer(surface, calibrated, job.sample, stated, job, (data.path, folder), read_inspection(folder))


def inspected(
    wafer: Wafer,
    recipe: DefectRecipe,
    given: GivenDies,
    golden: GoldenDie | None,
    against: Against,
    tell: Progress,
    hire: LocalOrCluster = LocalOrCluster(),
) -> Inspection:
    """Inspect a surface for defects; the dies are given, from the job, or detected.

    against "form": with given dies or those of the job, if any. Raises DiesNotFound if dies are to be compared and none
    are found, MeasureError if nothing can be inspected.
    """
    from wafer_viewer.measure.defects.inspection import inspect
    from wafer_viewer.store.records.inspection_records import carry_over

    recipe_with_product = replace(recipe, product=recipe.product or wafer.sample.product)
    try:
        grid = dies_on(wafer, given) if against == "dies" or given.known(wafer.job) else None
    except DiesNotFound as fault:
        raise DiesNotFound(f"{fault} {BY_FORM} {FORM_SEES}") from fault
    with _rows_by(wafer, hire) as rows_by:
        inspection = inspect(
            wafer.surface,
            grid,
            recipe_with_product,
            golden,
            against=against,
            calibration_valid=wafer.calibrated,
            progress=tell,
            rows_by=rows_by,
        )
    if wafer.lies_in is not None:  # before judgements are carried over, which the product has already
        inspection = with_classes_of_product(inspection, wafer.surface, wafer.lies_in[0].parent)
    return inspection if wafer.before is None else carry_over(wafer.before, inspection)


@contextmanager
def _rows_by(wafer: Wafer, hire: LocalOrCluster) -> Generator[RowHands | None]:
    """Provide the task runner for die rows; None if workers cannot read the surface themselves."""
    if wafer.lies_in is None:
        yield None
        return
    large = wafer.surface.shape[0] * wafer.surface.shape[1] >= CLUSTER_PAYS_PX
    with hire.crew(math.inf if large else 0.0) as crew:
        yield RowHands.of(crew, *wafer.lies_in)


def dies_on(wafer: Wafer, given: GivenDies) -> DieGrid:
    """Return the dies given by the operator, else those of the job, else the detected ones."""
    return given.on(wafer.surface, wafer.job).grid
