"""The paper's jobs as a list of steps, each done once: an interrupted run continues where it was."""

from __future__ import annotations

import os
import platform
import threading
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import ClassVar, TypeVar

import msgspec
import numpy as np

from wafer_viewer._version import __version__
from wafer_viewer.compute.dask_worker import own_bytes
from wafer_viewer.compute.task_runner import n_local_workers
from wafer_viewer.model.acquisition.devices import Rig
from wafer_viewer.model.errors import DatasetError, DiesNotFound, DiskFullError, PlanError, RigError, WaferViewerError
from wafer_viewer.model.inspection.defect import DefectRecipe
from wafer_viewer.model.progress import Progress
from wafer_viewer.model.report import ReportOrder
from wafer_viewer.model.spec import Spec, decode, encode
from wafer_viewer.rigs.rig_config import open_rig
from wafer_viewer.session.acquisition.headless import scan_to
from wafer_viewer.session.core.dataset_library import today
from wafer_viewer.session.inspection.inspection_job import GivenDies, inspected, wafer_of
from wafer_viewer.session.planning.plan_editor import free_bytes
from wafer_viewer.session.planning.preflight import require_passed
from wafer_viewer.session.reporting.report import make_report
from wafer_viewer.session.reproduction.paper_samples import DEFAULT, FULL, METHODS, REDUCED, PaperSample
from wafer_viewer.session.reproduction.published import FILTERED
from wafer_viewer.session.reproduction.surface_figures import figures_of
from wafer_viewer.session.surface.headless import LocalOrCluster, SurfaceStep, Warn, make_surface
from wafer_viewer.session.surface.kernel_build import SIMULATION, compile_missing
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.dataset.scan_record import RESULTS
from wafer_viewer.store.io.atomic_files import make_folder, remove, size, write_text
from wafer_viewer.store.io.guarded_reading import read_content
from wafer_viewer.store.mosaic.poses_file import write_planes
from wafer_viewer.store.records.inspection_records import write_inspection

PARTS = ".parts.json"
"""Ending of the file with the parts of a step that is not done."""
LOOK_EVERY_S = 0.3
"""Pause between looks at the memory of the program."""

# ------------------------------------------------------------------------------------------------------------- records


class _Record(Spec, frozen=True, kw_only=True):
    """Base class of the records of steps; a step with a record is done."""

    error: ClassVar[type[WaferViewerError]] = DatasetError


RecordKind = TypeVar("RecordKind", bound=Spec)


class RunRecord(_Record, frozen=True, kw_only=True):
    """Begin of a run: whether it is reduced, the day, the machine and the version of the software."""

    reduced: bool
    begun: str
    machine: str
    software_version: str


class TimedPart(_Record, frozen=True, kw_only=True):
    """Uninterrupted part of a step: frames done in it, its time and the greatest memory of the program.

    instrument_s: time on the clock of the rig; peak_bytes: of all its processes, without mapped files.
    """

    frames: int = 0
    seconds: float = 0.0
    instrument_s: float = 0.0
    stitching_s: float = 0.0
    peak_bytes: int = 0


class StepRecord(_Record, frozen=True, kw_only=True):
    """Time and memory of a step, by its parts, and the bytes of its outcome."""

    parts: tuple[TimedPart, ...] = ()
    bytes_made: int = 0

    @property
    def frame_ms(self) -> float:
        """Time a frame."""
        return 1e3 * sum(part.seconds for part in self.parts) / max(1, sum(part.frames for part in self.parts))


class InspectionRecord(StepRecord, frozen=True, kw_only=True):
    """Outcome of an inspection: defects by class, the class found at the gel drop, and what was compared with."""

    kinds: dict[str, int] = msgspec.field(default_factory=dict[str, int])
    at_drop: str = ""
    reference: str = ""
    inspected_mm2: float = 0.0


# --------------------------------------------------------------------------------------------------------------- costs


@dataclass(frozen=True, slots=True)
class Costs:
    """Seconds of a core and bytes: a million pixels of frames, of fields (store, filter), of the mosaic.

    Measured by this command on an Intel Xeon; several workers share the work on fields. start_s: start of the workers.
    """

    scan_s: float = 0.045
    heights_s: float = 0.0035
    default_s: float = 0.012
    store_s: float = 0.4
    filter_s: float = 5.0
    start_s: float = 8.0
    stitch_s: float = 0.25
    figures_s: float = 0.2
    inspection_s: float = 3.0
    surface_bytes: float = 21e6
    mosaic_bytes: float = 20e6


COSTS = Costs()


# --------------------------------------------------------------------------------------------------------------- steps


@dataclass(frozen=True, slots=True)
class PaperStep:
    """Step of a run: name of its record, title, expected time, and the work, which returns the record."""

    name: str
    title: str
    expected_s: float
    work: Callable[[Progress, Warn], Spec]


class Reproduction:
    """Run of the paper's jobs in a folder. keep: leave the datasets with all surfaces there.

    Raises PlanError where the folder holds another kind of run or other files.
    """

    def __init__(self, folder: Path, reduced: bool = False, keep: bool = False) -> None:
        self.folder, self.reduced, self.keep = folder, reduced, keep
        self.samples: tuple[PaperSample, ...] = REDUCED if reduced else FULL
        if self._run_file.exists():
            if self.begun.reduced != self.reduced:
                kind, flag = ("reduced", "with") if self.begun.reduced else ("full", "without")
                raise PlanError(
                    f"{self.folder} holds a {kind} run: continue it {flag} --reduced, or name another folder."
                )
        elif self.folder.exists() and any(self.folder.iterdir()):
            raise PlanError(f"{self.folder} holds other files: name a new folder, or that of an unfinished run.")

    @property
    def _run_file(self) -> Path:
        return self.folder / "run.json"

    @property
    def begun(self) -> RunRecord:
        """Record of the begin of the run. Raises DatasetError before it."""
        return decode(read_content(self._run_file), RunRecord, self._run_file.name, "json")

    @property
    def page(self) -> Path:
        """The page with all tables and figures."""
        return self.folder / "paper.html"

    def dataset(self, sample: PaperSample) -> Path:
        """Return the dataset of a sample."""
        return self.folder / f"{sample.name}.wafer"

    def arrays(self, sample: PaperSample, method: str) -> Path:
        """Return the file with picture and cuts of a surface."""
        return self.folder / f"{sample.name}-{method}.npz"

    def record(self, name: str, kind: type[RecordKind]) -> RecordKind | None:
        """Return the record of a step; None if it is not done."""
        path = self.folder / f"{name}.json"
        return decode(read_content(path), kind, path.name, "json") if path.exists() else None

    @cached_property
    def steps(self) -> tuple[PaperStep, ...]:
        """All steps in order."""
        return tuple(step for sample in self.samples for step in self._steps_of(sample))

    @property
    def pending(self) -> tuple[PaperStep, ...]:
        """Steps that are not done."""
        return tuple(step for step in self.steps if not (self.folder / f"{step.name}.json").exists())

    def _steps_of(self, sample: PaperSample) -> Generator[PaperStep]:
        name = sample.name.replace("_", " ")

        def step(what: str, title: str, expected_s: float, work: Callable[..., Spec], *given: str) -> PaperStep:
            run = partial(work, sample, *given)
            return PaperStep(f"{sample.name}-{what}", f"{name}: {title}", expected_s, run)

        yield step("scan", "scan", COSTS.scan_s * sample.frame_mpx, self._scan)
        for method, seconds in _surface_seconds(sample).items():
            yield step(f"{method}-surface", f"heights and stitching, {method}", seconds, self._make_surface, method)
            figures_s = COSTS.figures_s * sample.mosaic_mpx
            yield step(f"{method}-figures", f"figures, {method}", figures_s, self._measure, method)
        if sample.drop_um is not None:
            yield step("inspection", "inspection", COSTS.inspection_s * sample.mosaic_mpx, self._inspect)
        yield step("report", "report", 10.0, self._report)

    # ---------------------------------------------------------------------------------------------------- time and room

    @property
    def expected_s(self) -> float:
        """Expected time of the pending steps."""
        return sum(step.expected_s for step in self.pending)

    @property
    def needed_bytes(self) -> float:
        """Room that the pending steps need beside what lies in the folder."""
        pending = {step.name.split("-")[0] for step in self.pending}
        n_surfaces = len(METHODS) if self.keep else 1
        samples = [_room_bytes(sample, n_surfaces) for sample in self.samples if sample.name in pending]
        if not samples:
            return 0.0
        return max(0.0, (sum(samples) if self.keep else max(samples)) - _bytes_in(self.folder))

    def begin(self) -> None:
        """Make the folder. Raises DiskFullError when the disk has not enough room for the run."""
        at = next(path for path in (self.folder.absolute(), *self.folder.absolute().parents) if path.exists())
        free = free_bytes(at)
        if free is not None and free < self.needed_bytes:
            raise DiskFullError(
                f"{self.folder} has {size(free)} free and the run needs {size(self.needed_bytes)}: name a folder on "
                "another disk, or take the reduced run."
            )
        make_folder(self.folder)
        if not self._run_file.exists():
            record = RunRecord(reduced=self.reduced, begun=today(), machine=_machine(), software_version=__version__)
            write_text(self._run_file, encode(record, "json"))

    def run(self, step: PaperStep, tell: Progress, warn: Warn) -> None:
        """Do a pending step and write its record. Raises KeyboardInterrupt when Ctrl-C stops it."""
        write_text(self.folder / f"{step.name}.json", encode(step.work(tell, warn), "json"))
        (self.folder / f"{step.name}{PARTS}").unlink(missing_ok=True)
        if not self.keep:
            self.tidy()

    def tidy(self) -> None:
        """Remove the surfaces of measured methods but ours, and the datasets of samples that are done."""
        pending = {step.name for step in self.pending}
        for sample in self.samples:
            if f"{sample.name}-report" not in pending:
                remove(self.dataset(sample))
            for method in METHODS:
                if method != DEFAULT and f"{sample.name}-{method}-figures" not in pending:
                    remove(self.dataset(sample) / RESULTS / _result(method))

    # -------------------------------------------------------------------------------------------------------- the works

    def _scan(self, sample: PaperSample, tell: Progress, warn: Warn) -> Spec:
        """Scan a sample by its plan, with the checks before it."""
        path = self.dataset(sample)
        compile_missing(SIMULATION, lambda progress: warn(f"{progress.words}."))
        rig = open_rig(sample.rig)
        try:
            with self._timed(f"{sample.name}-scan", partial(_frames_of, path), rig):
                ended = scan_to(path, sample.job, rig, tell, require_passed, warn)
        finally:
            rig.close()
        if ended.error is not None:
            raise RigError(ended.error)
        if ended.stopped:
            raise KeyboardInterrupt
        return StepRecord(parts=self._parts(f"{sample.name}-scan"), bytes_made=_bytes_in(path))

    def _make_surface(self, sample: PaperSample, method: str, tell: Progress, warn: Warn) -> Spec:
        """Make the heights of all fields by a method, and stitch them."""
        path, name = self.dataset(sample), f"{sample.name}-{method}-surface"
        stored = Dataset.open(path).result(_result(method))

        def n_done() -> int:
            data = Dataset.open(path)
            fields = data.result(stored.name).surfaces_done(data.fields) if stored.exists else ()
            return len(fields) * data.scan.plan.sweep.n_frames

        hire = LocalOrCluster(workers=n_local_workers() if sample.size == "full" else None)
        with self._timed(name, n_done) as begin:
            make_surface(path, METHODS[method], stored.name, again=False, tell=tell, warn=warn, hire=hire, begin=begin)
        return StepRecord(parts=self._parts(name), bytes_made=_bytes_in(stored.path))

    def _measure(self, sample: PaperSample, method: str, tell: Progress, warn: Warn) -> Spec:
        """Measure a surface, and store its picture and cuts."""
        stored = Dataset.open(self.dataset(sample)).result(_result(method))
        figures, arrays = figures_of(sample, stored.mosaic(), tell)
        write_planes(self.arrays(sample, method), arrays)
        return figures

    def _inspect(self, sample: PaperSample, tell: Progress, warn: Warn) -> Spec:
        """Inspect our surface for defects: die by die, or against its form where too few dies are seen."""
        wafer, name = wafer_of(self.dataset(sample), DEFAULT), f"{sample.name}-inspection"
        with self._timed(name, int):
            try:
                found = inspected(wafer, DefectRecipe(), GivenDies(), None, "dies", tell)
            except DiesNotFound:
                found = inspected(wafer, DefectRecipe(), GivenDies(), None, "form", tell)
        write_inspection(Dataset.open(self.dataset(sample)).result(DEFAULT).path, found)
        x_um, y_um = np.array([sample.drop_um or (0.0, 0.0)]).T
        kinds: dict[str, int] = {}
        for defect in found.found:
            kinds[defect.seen_as] = kinds.get(defect.seen_as, 0) + 1
        return InspectionRecord(
            parts=self._parts(name),
            kinds=kinds,
            at_drop=", ".join(defect.seen_as for defect in found.found if defect.outline.contains(x_um, y_um)[0]),
            reference=found.reference,
            inspected_mm2=found.inspected_mm2,
        )

    def _report(self, sample: PaperSample, tell: Progress, warn: Warn) -> Spec:
        """Write the report of a dataset."""
        out = self.folder / f"{sample.name}-report.html"
        make_report(self.dataset(sample), DEFAULT, ReportOrder(), out, progress=tell)
        return StepRecord(bytes_made=out.stat().st_size)

    # ----------------------------------------------------------------------------------------------------------- timing

    @contextmanager
    def _timed(
        self, name: str, n_frames: Callable[[], int], rig: Rig | None = None
    ) -> Generator[Callable[[SurfaceStep], None]]:
        """Add what is done inside to the parts of a step, however it ends; yield the callback that begins heights."""
        before, began, clock_s = n_frames(), time.perf_counter(), rig.clock.now_s() if rig else 0.0
        times: dict[SurfaceStep, float] = {}
        with _highest_memory() as highest:
            try:
                yield lambda step: times.update({step: time.perf_counter()})
            finally:
                ended = time.perf_counter()
                stitched_s = times.get("stitching", ended)
                part = TimedPart(
                    frames=n_frames() - before,
                    seconds=stitched_s - times.get("heights", began),
                    stitching_s=ended - stitched_s,
                    instrument_s=rig.clock.now_s() - clock_s if rig else 0.0,
                    peak_bytes=max(highest),
                )
                so_far = StepRecord(parts=(*self._parts(name), part))
                write_text(self.folder / f"{name}{PARTS}", encode(so_far, "json"))

    def _parts(self, name: str) -> tuple[TimedPart, ...]:
        """Return the parts of a step so far."""
        path = self.folder / f"{name}{PARTS}"
        return decode(read_content(path), StepRecord, path.name, "json").parts if path.exists() else ()


# ------------------------------------------------------------------------------------------------------------- helpers


def _result(method: str) -> str:
    """Return the name of the result of a method."""
    return method.lower().replace("_", "-")


def _surface_seconds(sample: PaperSample) -> dict[str, float]:
    """Return the expected time of the surface of every method; a large job has several workers."""
    is_large = sample.size == "full"
    share = 1 / min(n_local_workers(), os.cpu_count() or 1) if is_large else 1.0
    alone_s = COSTS.stitch_s * sample.mosaic_mpx + COSTS.start_s * is_large

    def seconds(method: str) -> float:
        frames_s = (COSTS.default_s if method == DEFAULT else COSTS.heights_s) * sample.frame_mpx
        fields_s = (COSTS.store_s + COSTS.filter_s * method.endswith(FILTERED)) * sample.field_mpx
        return share * (frames_s + fields_s) + alone_s

    return {method: seconds(method) for method in METHODS}


def _room_bytes(sample: PaperSample, n_surfaces: int) -> float:
    """Return the room of a sample: its frames, and one surface, or those of all methods."""
    surface = COSTS.surface_bytes * sample.field_mpx + COSTS.mosaic_bytes * sample.mosaic_mpx
    return 1e6 * sample.frame_mpx + n_surfaces * surface


def _frames_of(path: Path) -> int:
    return len(Dataset.open(path).arrived()) if path.exists() else 0


def _bytes_in(folder: Path) -> int:
    return sum(file.stat().st_size for file in folder.rglob("*") if file.is_file())


@contextmanager
def _highest_memory() -> Generator[list[int]]:
    """Yield a list of the memory of this process and its children, looked at several times a second."""
    looks, over = [_own_bytes_of_all()], threading.Event()

    def watch() -> None:
        while not over.wait(LOOK_EVERY_S):
            looks[0] = max(looks[0], _own_bytes_of_all())

    watcher = threading.Thread(target=watch, daemon=True)
    watcher.start()
    try:
        yield looks
    finally:
        over.set()
        watcher.join()


def _own_bytes_of_all() -> int:
    import psutil

    me = psutil.Process()
    return sum(own_bytes(pid) for pid in (me.pid, *(child.pid for child in me.children(recursive=True))))


def _machine() -> str:
    """Return processor, number of cores, system, and the load by other programs where the system tells it."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        named = next(line.split(":")[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        named = platform.processor() or platform.machine()
    load = f", load {os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else ""
    return f"{named}, {os.cpu_count()} cores, {platform.system()}{load}"
