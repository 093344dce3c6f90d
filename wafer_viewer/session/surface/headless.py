"""Reconstruction without a session, for the command line: surfaces are made and read in its own process."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal

from wafer_viewer.compute.crews import crew_for
from wafer_viewer.compute.dask_worker import attempt
from wafer_viewer.compute.task_runner import LocalRunner, TaskRunner, n_local_workers, require_tls
from wafer_viewer.model.acquisition.image_source import ImageOptions
from wafer_viewer.model.errors import ComputeError, DatasetError, DiskFullError, PlanError, WaferViewerError
from wafer_viewer.model.file_contents import DATASET_ENDING
from wafer_viewer.model.job import Job
from wafer_viewer.model.progress import Progress, part_of
from wafer_viewer.model.surface.focus_curve import FocusCurve
from wafer_viewer.model.surface.height_map import Mosaic
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.model.surface_format import Reading
from wafer_viewer.session.core.dataset_library import summarise, today
from wafer_viewer.session.state.snapshot import SurfaceInfo
from wafer_viewer.session.surface.focus_evidence import focus_curve
from wafer_viewer.session.surface.kernel_build import HEIGHTS, STITCHING, KernelPart, compile_missing
from wafer_viewer.session.surface.stitching_job import bring_up_to_date
from wafer_viewer.session.surface.worker_tasks import reconstruct_field
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.dataset.lock import Lock
from wafer_viewer.store.dataset.stack_import import stack_of
from wafer_viewer.store.formats.conversion import is_surface_file, read_surface
from wafer_viewer.store.mosaic.poses_file import write_poses_csv

Warn = Callable[[str], None]
SurfaceStep = Literal["heights", "stitching"]
READ_SHARE = 0.3
"""Fraction of the progress bar for reading the files, during a reconstruction of image files."""
STITCH_SHARE = 0.1
"""Fraction of the progress bar for stitching, after the heights."""
CLUSTER_PAYS_BYTES = 4e9
"""Size of the frames in bytes from which starting own worker processes is faster, despite their start-up time."""


@dataclass(frozen=True, slots=True)
class LocalOrCluster:
    """Factory of task runners: the cluster at `scheduler`, or `workers` processes of this machine.

    None chooses the number by data size.
    """

    scheduler: str | None = None
    workers: int | None = None

    def __post_init__(self) -> None:
        require_tls(self.scheduler)
        if self.workers is not None and self.workers < 1:
            raise PlanError(f"--workers is {self.workers}: it must be at least 1, which is this process alone.")
        if self.scheduler is not None and self.workers is not None:
            raise PlanError("--workers is for this machine and --scheduler for a cluster: give one of them.")

    def crew(self, work_bytes: float) -> AbstractContextManager[TaskRunner]:
        """Return the task runner for that many bytes of frames."""
        return crew_for(self.scheduler, self.workers or (1 if work_bytes < CLUSTER_PAYS_BYTES else n_local_workers()))


def surface_of(
    src: Sequence[Path],
    recipe: Recipe,
    images: ImageOptions,
    result: str,
    tell: Progress,
    warn: Warn,
    hire: LocalOrCluster,
) -> tuple[Mosaic, SurfaceInfo]:
    """Return the reconstructed surface of images or of a dataset, and its summary; warn of what the files tell.

    Raises DatasetError for unreadable images.
    """
    if len(src) == 1 and is_dataset(src[0]):
        info = make_surface(src[0], recipe, result, again=False, tell=tell, warn=warn, hire=hire)
        return Dataset.open(src[0]).result(result).mosaic(), info
    from wafer_viewer.reconstruct.field_pipeline import reconstruct

    files = src[0] if len(src) == 1 else tuple(src)
    stack = stack_of(files, images, progress=part_of(tell, 0, READ_SHARE))
    for note in stack.notes:
        warn(note)
    _compile(HEIGHTS, warn)
    surface = reconstruct(stack, recipe, part_of(tell, READ_SHARE, 1))
    return surface, summarise(surface, 1, result, recipe)


def make_surface(
    path: Path,
    recipe: Recipe,
    result: str,
    *,
    again: bool,
    tell: Progress,
    warn: Warn,
    hire: LocalOrCluster = LocalOrCluster(),
    begin: Callable[[SurfaceStep], None] = lambda step: None,
) -> SurfaceInfo:
    """Compute the missing heights of all fields with this recipe, then the mosaic; the dataset is locked meanwhile.

    warn: called for each field that fails and is omitted; begin: with each step. Raises ComputeError when all fields
    fail.
    """
    data = Dataset.open(path.absolute())
    lock = Lock.take(data.path)
    try:
        todo = _fields_to_do(data, recipe, result, again)
        _compile((*HEIGHTS, *STITCHING), warn)
        with hire.crew(len(todo) * data.scan.plan.bytes_on_disk / len(data.fields)) as crew:
            crew.require_sight(data.path)
            share = 0 if not todo else 1 - STITCH_SHARE
            begin("heights")
            _reconstruct(data, result, recipe, todo, crew, part_of(tell, 0, share), warn)
            begin("stitching")
            drawn = part_of(tell, share, 1)
            return bring_up_to_date(data.path, result, recipe, crew=crew, progress=drawn)
    finally:
        lock.release()


def _compile(parts: Sequence[KernelPart], say: Warn) -> None:
    compile_missing(parts, lambda progress: say(f"{progress.words}."))


def write_poses_of(path: Path, result: str, out: Path) -> None:
    """Write the field poses of a stitched surface as CSV. Raises DatasetError when the fields were not stitched."""
    if (poses := Dataset.open(path).result(result).poses()) is None:
        raise DatasetError(f"{path.name} has no stitched surface {result!r}: stitch it first.")
    write_poses_csv(poses, out)


def measured_surface(src: Path, field_number: int, result: str) -> tuple[Mosaic, bool]:
    """Return the surface of a dataset (0: the mosaic) or of a file, and whether its calibration is valid today."""
    if not is_dataset(src):
        surface = read_surface(src)
        calibration = surface.provenance.calibration
        return surface, calibration is not None and calibration.problem(calibration.setup, today()) is None
    data = Dataset.open(src)
    stored = data.result(result)
    surface = stored.surface(data.field(field_number)) if field_number else stored.mosaic()
    return surface, data.calibration_problem(today()) is None


def job_of(src: Path) -> Job | None:
    """Return the job that a dataset was scanned by; None for a file."""
    return Dataset.open(src).scan.job if is_dataset(src) else None


def file_or_mosaic(src: Path, result: str, says: Reading, tell: Progress) -> Mosaic:
    """Return the surface of a file, or the stitched one of a dataset, which needs no options.

    Raises DatasetError otherwise.
    """
    if is_dataset(src):
        if says != Reading():
            raise DatasetError(
                f"{src.name} gives its own units: leave --z-unit, --pixel-um, --invert-z and --table out."
            )
        return Dataset.open(src).result(result).mosaic()
    return read_surface(src, says.z_unit, says.pixel_um, says.invert_z, tell, table=says.table)


def evidence_of(
    src: Sequence[Path],
    at_um: tuple[float, float],
    field_number: int,
    result: str,
    recipe: Recipe,
    images: ImageOptions,
    tell: Progress,
) -> FocusCurve:
    """Return the focus curve of a pixel of images or of a dataset.

    With the default recipe, the recipe of an existing surface is used. Raises DatasetError for unreadable data, and for
    a surface without its frames.
    """
    if len(src) == 1 and is_dataset(src[0]):
        return focus_curve(src[0], result, field_number, *at_um, None if recipe == Recipe() else recipe)
    if is_surface_file(src[0]):
        raise DatasetError(f"{src[0].name} is a surface without its frames: give the dataset or images it was made of.")
    from wafer_viewer.reconstruct import focus_evidence

    stack = stack_of(src[0] if len(src) == 1 else tuple(src), images, progress=tell)
    return focus_evidence.focus_curve(stack, *at_um, recipe)


def is_dataset(path: Path) -> bool:
    """Return whether a path names a dataset, existing or not."""
    return path.suffix == DATASET_ENDING


def _fields_to_do(data: Dataset, recipe: Recipe, result: str, again: bool) -> list[int]:
    stored, complete = data.result(result), sorted(data.complete_fields())
    if not data.fields:
        raise DatasetError(f"{data.path.name} is a surface without frames: there is nothing to reconstruct.")
    if not complete:
        raise DatasetError(f"{data.path.name} has no field with all its frames yet: continue its scan.")
    unchanged = stored.exists and stored.surfaces_done(data.fields) and stored.matches_recipe(recipe)
    stored.save_recipe(recipe)
    done = stored.surfaces_done(data.fields) if unchanged and not again else set[int]()
    return [number for number in complete if number not in done]


def _reconstruct(
    data: Dataset, result: str, recipe: Recipe, todo: Sequence[int], crew: TaskRunner, tell: Progress, warn: Warn
) -> None:
    """Compute the heights of fields; failed ones are reported.

    Raises ComputeError if no field has any, DiskFullError at the first that there is no space for.
    """
    faults: list[str] = []
    for n_done, (number, fault) in enumerate(_outcomes(data, result, recipe, todo, crew, tell), 1):
        tell(n_done / len(todo))
        if isinstance(fault, DiskFullError):
            raise fault
        if fault is not None:
            faults.append(f"Field {number} has no heights and is left out. {fault}")
            warn(faults[-1])
    if faults and not data.result(result).surfaces_done(data.fields):
        raise ComputeError(f"No field of {data.path.name} has heights. {faults[0]}")


def _outcomes(
    data: Dataset, result: str, recipe: Recipe, todo: Sequence[int], crew: TaskRunner, tell: Progress
) -> Iterator[tuple[int, WaferViewerError | None]]:
    """Yield fields in order of completion, with the error of failed ones.

    Until the first field resolves `auto` for all, fields are processed one by one, so that heights do not depend on the
    number of workers.
    """
    stored, n = data.result(result), 0
    while n < len(todo) and (isinstance(crew, LocalRunner) or (recipe.heights_have_auto and stored.settled() is None)):
        task = partial(reconstruct_field, progress=part_of(tell, n / len(todo), (n + 1) / len(todo)))
        _, fault = attempt(task, (data.path, todo[n], result, recipe, None))
        n += 1
        yield todo[n - 1], fault
    items = [(data.path, number, result, recipe, crew.threads_each) for number in todo[n:]]
    with closing(crew.each(reconstruct_field, items)) as outcomes:
        for done in outcomes:
            yield todo[n + done.index], done.fault
