"""Import of images and surface files, and export of surfaces, as background work."""

from __future__ import annotations

import datetime
import glob
import re
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Future
from dataclasses import dataclass
from functools import partial
from itertools import count
from pathlib import Path

from wafer_viewer.model.acquisition.calibration import OpticalSetup
from wafer_viewer.model.acquisition.image_source import ImageOptions
from wafer_viewer.model.acquisition.plan import IMPORT, MIN_FRAMES, FieldGrid, FocusSweep, ScanPlan
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.file_contents import DATASET_ENDING, FileContents
from wafer_viewer.model.job import Job
from wafer_viewer.model.progress import Progress, ShouldStop, never, silent
from wafer_viewer.model.region import Region
from wafer_viewer.model.report import Contents, ReportOrder
from wafer_viewer.model.surface.comparison import comparison_of
from wafer_viewer.model.surface.height_map import HeightMap
from wafer_viewer.model.surface_format import Reading
from wafer_viewer.session.core.background_work import BackgroundWork, RunningWork
from wafer_viewer.session.core.command_queue import CommandQueue
from wafer_viewer.session.core.commands import command, observer_command, query
from wafer_viewer.session.core.dataset_library import (
    DEFAULT_RESULT,
    Library,
    free_name,
    save_summary,
    summarise,
)
from wafer_viewer.session.reporting.report import contents, make_report
from wafer_viewer.session.surface.worker_tasks import (
    SeenFrames,
    export_fields,
    export_surface,
    import_images,
    look_at_files,
    stitch_images,
)
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.dataset.scan_record import JOURNAL, RESULTS, Finished, JournalWriter, ScanRecord, write_record
from wafer_viewer.store.io.atomic_files import atomic_write

# ------------------------------------------------------------------------------------------------------------ file jobs


READ_SHARE = 0.4
"""Fraction of the progress bar for reading the file, during an import."""
_ANY_UM = 1.0
"""Placeholder for the z step where a plan needs a sweep and the file has none."""


def import_surface(
    src: Path,
    out: Path,
    says: Reading = Reading(),
    *,
    progress: Progress = silent,
    should_stop: ShouldStop = never,
) -> Path:
    """Import a surface file into a dataset, which appears once it is complete.

    says: values that the file does not contain. Raises DatasetError, with nothing written, for everything that
    `read_surface` refuses, for a path that exists or cannot be written to, and when the import is stopped.
    """
    from wafer_viewer.store.formats.conversion import read_surface
    from wafer_viewer.store.records.manifest import forget_marks, sign_result, sign_scan

    if out.exists():
        raise DatasetError(f"{out} exists already. Nothing was written. Choose another name.")
    read = partial(_part, progress, 0.0, READ_SHARE)
    surface = read_surface(src, says.z_unit, says.pixel_um, says.invert_z, read, should_stop, table=says.table)
    with atomic_write(out) as temporary:
        temporary.mkdir(parents=True)
        _write(temporary, surface, src.name, partial(_part, progress, READ_SHARE, 1 - READ_SHARE), should_stop)
    forget_marks(out)
    sign_scan(out)
    sign_result(out / RESULTS / DEFAULT_RESULT)
    return out


def _write(folder: Path, surface: HeightMap, source: str, progress: Progress, should_stop: ShouldStop) -> None:
    from wafer_viewer.store.mosaic.zarr_mosaic import write_mosaic

    calibration, job = surface.provenance.calibration, _job(surface)
    date = datetime.datetime.now().astimezone().isoformat(timespec="seconds")
    record = ScanRecord(
        software_version=surface.provenance.software_version,
        taken=date,
        simulated=surface.provenance.simulated,
        imported_from=source,
        setup=OpticalSetup() if calibration is None else calibration.setup,
        calibration=calibration,
        job=job,
        plan=_plan(surface, job),
    )
    journal = JournalWriter(folder / JOURNAL)
    journal.write(Finished(date))
    journal.close()
    write_record(folder, record)
    result = Dataset.open(folder).result(DEFAULT_RESULT)
    result.save_recipe(job.recipe)
    mosaic = write_mosaic(result.mosaic_path, surface, progress, should_stop)
    save_summary(result, summarise(mosaic, 0, DEFAULT_RESULT, job.recipe))


def _job(surface: HeightMap) -> Job:
    rows, cols = surface.shape
    x_low, y_low, x_high, y_high = surface.bounds_um
    return Job(
        grid=FieldGrid(
            rows=1,
            cols=1,
            field_width_um=cols * surface.pixel_um,
            field_height_um=rows * surface.pixel_um,
            x0_um=(x_low + x_high) / 2,
            y0_um=(y_low + y_high) / 2,
        ),
        sweep=FocusSweep(z_step_um=surface.provenance.z_step_um or _ANY_UM, n_frames=MIN_FRAMES),
        recipe=surface.provenance.recipe,
    )


def _plan(surface: HeightMap, job: Job) -> ScanPlan:
    return ScanPlan(
        fields=(),
        sweep=job.sweep,
        exposures_us=job.exposures_us,
        strategy=IMPORT,
        legs=(),
        predicted_s=0.0,
        prices=(),
        rows=surface.shape[0],
        cols=surface.shape[1],
        pixel_um=surface.pixel_um,
    )


def _part(tell: Progress, begin: float, length: float, share: float) -> None:
    tell(begin + length * share)


MOST_PICTURES = 12
"""Frames of which a look at files brings a thumbnail."""


@dataclass(frozen=True, slots=True)
class ImportLook:
    """Contents of files that may be imported, and what the import would make.

    thumbnails: JPEG by number of the frame. out: dataset, or picture, that would be written.
    """

    contents: FileContents
    thumbnails: Mapping[int, bytes]
    out: Path

    @classmethod
    def of(cls, contents: FileContents, thumbnails: Mapping[int, bytes], dataset: Path) -> ImportLook:
        """Return the look; of single images a picture would be written, in the place of the dataset."""
        return cls(contents, thumbnails, picture_path(dataset) if contents.is_tiled else dataset)


def picture_path(dataset: Path) -> Path:
    """Return the path of a stitched picture in the place of a dataset that is not there; a free one."""
    wish = dataset.with_name(f"{dataset.stem}{PICTURE_ENDING}")
    others = (dataset.with_name(f"{dataset.stem}-{n}{PICTURE_ENDING}") for n in count(2))
    return next(path for path in (wish, *others) if not path.exists()) if wish.exists() else wish


PICTURE_ENDING = ".ome.tif"


class FileJobs:
    """Import, export and report jobs, ``session.exchange``; commands return futures."""

    def __init__(
        self,
        command_queue: CommandQueue,
        library: Library,
        background: BackgroundWork,
        open_dataset: Callable[[Path], Path],
    ) -> None:
        self._command_queue, self._library, self._background, self._open = (
            command_queue,
            library,
            background,
            open_dataset,
        )
        self._looks = set[str]()
        self._seen = SeenFrames()

    @query
    def is_surface(self, path: Path) -> bool:
        """Return whether a path names a surface file, rather than a dataset or images."""
        from wafer_viewer.store.formats.conversion import is_surface_file

        return is_surface_file(Path(path))

    @observer_command
    def look(
        self,
        srcs: tuple[Path, ...],
        options: ImageOptions = ImageOptions(),
        says: Reading = Reading(),
        name: str | None = None,
    ) -> RunningWork[ImportLook]:
        """Look at files in the background before they are imported; nothing is written.

        The future is done when the look has begun; `RunningWork.done` when it is over. says: values that a surface file
        does not contain. name: of the dataset to make.
        """
        out = self._new_dataset(name, srcs[0].stem if srcs else "import")
        files = tuple(Path(src).absolute() for src in srcs)
        title = f"Look at {srcs[0].name if len(srcs) == 1 else f'{len(srcs)} files'}"
        work = self._background.run(title, look_at_files, files, options, says, MOST_PICTURES, self._seen)
        self._looks.add(work.id)
        work.done.add_done_callback(lambda _: self._looks.discard(work.id))
        return RunningWork(work.id, self._command_queue.then(work.done, lambda found: self._looked(found, out)))

    def _looked(self, found: tuple[FileContents, Mapping[int, bytes], SeenFrames], out: Path) -> ImportLook:
        contents, thumbnails, self._seen = found
        return ImportLook.of(contents, thumbnails, out)

    @observer_command
    def stop_look(self, work_id: str) -> None:
        """Stop a look at files; one that is over is ignored."""
        if work_id in self._looks:
            self._background.cancel(work_id)

    @command.audited("Images imported")
    def import_images(
        self,
        srcs: tuple[Path, ...],
        options: ImageOptions = ImageOptions(),
        *,
        name: str | None = None,
        overlap_fraction: float = 0.1,
    ) -> Future[Path]:
        """Import images from another instrument into a dataset, open and reconstruct it.

        The future is done when it is open. options: values and choices of the user.
        """
        out = self._new_dataset(name, srcs[0].stem if srcs else "import")
        files = tuple(Path(src).absolute() for src in srcs)
        made = self._background.run(f"Import of {out.stem}", import_images, files, out, options, overlap_fraction)
        return self._command_queue.then(made.done, self._open)

    @command.audited("Images stitched")
    def stitch_images(
        self,
        srcs: tuple[Path, ...],
        options: ImageOptions = ImageOptions(),
        *,
        name: str | None = None,
        overlap_fraction: float = 0.1,
    ) -> Future[Path]:
        """Make one picture of single images of a grid, NAME.ome.tif in the data folder; the future is done with it.

        options: values and choices of the user.
        """
        out = picture_path(self._new_dataset(name, srcs[0].stem if srcs else "stitched"))
        files = tuple(Path(src).absolute() for src in srcs)
        return self._background.run(f"Picture {out.name}", stitch_images, files, out, options, overlap_fraction).done

    @command.audited("Surface imported")
    def import_surface(self, path: Path, says: Reading = Reading(), name: str | None = None) -> Future[Path]:
        """Import a surface file into a dataset and open it. says: values that the file does not contain."""
        src = Path(path).absolute()
        out = self._new_dataset(name, src.stem)
        made = self._background.run(f"Import of {out.stem}", import_surface, src, out, says)
        return self._command_queue.then(made.done, self._open)

    @observer_command
    def export_surface(
        self, path: Path, field: int | None = None, every: int | None = None, part: Region | None = None
    ) -> Future[Path]:
        """Write the stitched surface, a field's or a comparison layer, with every n-th pixel.

        The file ending determines the format. part: only the upright rectangle around this region.
        """
        out, dataset, result = Path(path).absolute(), self._library.dataset, self._library.result_name
        if (face := comparison_of(field or 0)) is not None:
            result = next((c.name for c in self._command_queue.now.comparisons if c.number == face[0]), result)
            field = -face[1]
        return self._background.run(
            f"Export to {out.name}", export_surface, dataset.path, result, field, out, every, part
        ).done

    @observer_command
    def export_fields(self, path: Path) -> Future[Path]:
        """Write the fields of the stitched surface as images in place, NAME.ome.zarr."""
        out, dataset, result = Path(path).absolute(), self._library.dataset, self._library.result_name
        return self._background.run(f"Fields to {out.name}", export_fields, dataset.path, result, out).done

    def write_report(self, order: ReportOrder, out: Path) -> Future[Path]:
        """Write the report of the open dataset, on the session's thread; the future's result is its path."""
        dataset = self._library.dataset
        args = (dataset.path, self._library.result_name, order, out.absolute())
        return self._background.run(f"Report of {dataset.path.stem}", make_report, *args).done

    def _new_dataset(self, name: str | None, stem: str) -> Path:
        folder = self._command_queue.now.data_folder
        wish = Path(name).name.removesuffix(DATASET_ENDING) if name else free_name(folder, stem)
        return folder / f"{wish}{DATASET_ENDING}"


# ------------------------------------------------------------------------------------------------------------ documents


PICTURE, REPORT = "picture", "report"
_REPORT_NAME = re.compile(r"[^/\\]+-report-\d+\.(html|pdf)")


class Documents:
    """Documents of the open dataset, ``session.papers``; every command returns a future."""

    def __init__(self, command_queue: CommandQueue, library: Library, files: FileJobs) -> None:
        self._command_queue, self._library, self._files = command_queue, library, files
        self.pictures_kept = 0
        """Number of pictures stored since the start; a change means that a report may have more to show."""
        self.saved_reports: dict[str, Path] = {}
        """Reports written to a path chosen by a person, by file name."""

    @observer_command
    def keep_picture(self, png: bytes) -> Path:
        """Store a picture next to the open dataset, as ``NAME-picture-3.png``; the future's result is its path."""
        from wafer_viewer.store.io.atomic_files import atomic_write

        path = free_path(self._library.shown.path, PICTURE, ".png")
        with atomic_write(path) as temporary:
            temporary.write_bytes(png)
        self.pictures_kept += 1
        return path

    @observer_command
    def contents(self) -> Contents:
        """Return a short description of each part that a report of the open dataset would have."""
        return contents(self._library.dataset.path, self._library.result_name)

    @observer_command
    def write_report(self, order: ReportOrder, path: Path | None = None) -> Future[Path]:
        """Write the report; the future's result is its path.

        The default path is ``NAME-report-2.html`` next to the dataset.
        """

        def note(done: Future[Path]) -> None:
            if path is not None and not done.cancelled() and done.exception() is None:
                self.saved_reports[path.name] = path

        written = self._files.write_report(order, path or free_path(self._library.shown.path, REPORT, ".html"))
        written.add_done_callback(note)
        return written


def newest_report(dataset: Path) -> Path | None:
    """Return the report of a dataset that was written last, or None."""
    beside = dataset.parent.glob(f"{glob.escape(dataset.stem)}-{REPORT}-*")
    reports = (path for path in beside if _REPORT_NAME.fullmatch(path.name))
    return max(reports, key=lambda path: path.stat().st_mtime, default=None)


def read_report(name: str, folders: Iterable[Path], saved: Mapping[str, Path] = {}) -> bytes | None:
    """Return the bytes of a report by its file name, from the first folder that has it; None for any other file.

    saved: reports written to other folders or under other names.
    """
    if (path := saved.get(name)) is not None and path.is_file():
        return path.read_bytes()
    if not _REPORT_NAME.fullmatch(name):
        return None
    return next((path.read_bytes() for folder in folders if (path := folder / name).is_file()), None)


def free_path(dataset: Path, purpose: str, ending: str) -> Path:
    """Return the first of ``NAME-what-1``, ``NAME-what-2``, … next to a dataset that is not a file yet."""
    paths = (dataset.with_name(f"{dataset.stem}-{purpose}-{n}{ending}") for n in count(1))
    return next(path for path in paths if not path.exists())
