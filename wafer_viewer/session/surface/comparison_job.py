"""Two surfaces named, opened, subtracted and written: a worker's task, and what the command line calls itself."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path

from wafer_viewer.model.errors import ComputeError, DatasetError
from wafer_viewer.model.progress import Progress, ShouldStop, never, silent
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.comparison import Align, Comparison, ComparisonFace, SurfaceName
from wafer_viewer.model.surface.height_map import HeightMap, Mosaic, Provenance
from wafer_viewer.reconstruct.comparison.height_difference import Difference, DifferenceStatistics
from wafer_viewer.session.core.dataset_library import ENDING, today
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.dataset.lock import Lock
from wafer_viewer.store.dataset.result import COMPARISON, MOSAIC
from wafer_viewer.store.io.atomic_files import remove, replacing
from wafer_viewer.store.io.checksums import save_json

PREFIX = "difference-"
ALIGN_SHARE = 0.15
"""Of a comparison, how much of the progress bar the alignment takes."""
THREADS = 2


def opened(name: SurfaceName) -> Mosaic:
    """The surface of a name. Raises DatasetError when it is not there."""
    from wafer_viewer.reconstruct.comparison.height_layer_choice import read_as
    from wafer_viewer.store.formats.readers import read_surface

    path = Path(name.path)
    if path.suffix != ENDING:
        return read_as(read_surface(path), name.heights)
    data = Dataset.open(path)
    kept = data.result(name.result)
    return read_as(kept.surface(data.field(name.field)) if name.field else kept.mosaic(), name.heights)


def made_at(name: SurfaceName) -> float:
    """When the surface of a name was written, s since the epoch; 0 where it is gone."""
    path = Path(name.path)
    if path.suffix == ENDING:
        data = Dataset.open(path)
        kept = data.result(name.result)
        if name.field:
            return kept.field_stamp(data.field(name.field)) * 1e-9
        path = kept.mosaic_path / "zarr.json"
    return path.stat().st_mtime if path.exists() else 0.0


def face_of(dataset: Path, result: str, face: ComparisonFace) -> Mosaic:
    """What of a comparison is looked at. Raises DatasetError when it, or one of its surfaces, is gone."""
    from wafer_viewer.reconstruct.comparison.lazy_pyramid import as_pyramid
    from wafer_viewer.reconstruct.comparison.resampled_surface import ResampledMosaic
    from wafer_viewer.reconstruct.comparison.side_by_side import SideBySideMosaic

    kept = Dataset.open(dataset).result(result)
    if face is ComparisonFace.DIFFERENCE:
        return kept.mosaic()
    comparison = kept.comparison()
    first = as_pyramid(opened(comparison.first))
    if face is ComparisonFace.FIRST:
        return first
    laid = ResampledMosaic(first, as_pyramid(opened(comparison.second)), comparison.registration)
    return laid if face is ComparisonFace.SECOND else SideBySideMosaic(laid)


def comparisons_of(data: Dataset) -> dict[str, Comparison]:
    """The comparisons that lie with a dataset by the names of their results; those that cannot be read are left out."""
    found: dict[str, Comparison] = {}
    for name in data.differences():
        with suppress(DatasetError):
            found[name] = data.result(name).comparison()
    return found


def subtract(
    dataset: Path,
    result: str,
    first: SurfaceName,
    second: SurfaceName,
    align: Align,
    keep_z: bool,
    *,
    progress: Progress = silent,
    should_stop: ShouldStop = never,
) -> Comparison:
    """Subtract two surfaces and keep what comes out as a result of a dataset, whole or not at all.

    Raises MeasureError when they cannot be compared, ComputeError when the work is stopped, DatasetError when it cannot
    be written.
    """
    from wafer_viewer.store.mosaic.zarr_mosaic import write_mosaic

    data = Dataset.open(dataset)
    target, number = data.result(result), 1 + max((c.number for c in comparisons_of(data).values()), default=0)
    _sweep(target.path.parent)
    difference = _compared(first, second, align, keep_z)
    progress(ALIGN_SHARE)
    if should_stop():
        raise ComputeError("The comparison was stopped. Nothing was kept of it.")
    tallied = StreamingStatistics(difference)
    with replacing(target.path) as beside:
        beside.mkdir(parents=True)
        write_mosaic(beside / MOSAIC, tallied, partial(_later, progress), should_stop, THREADS)
        comparison = replace(tallied.comparison(first, second), number=number)
        save_json(beside / COMPARISON, comparison)
    return comparison


def keep_difference(
    path: Path, name: str, first: SurfaceName, second: SurfaceName, align: Align, keep_z: bool, tell: Progress
) -> Comparison:
    """Subtract two surfaces and keep what comes out with a dataset, which is held meanwhile."""
    data = Dataset.open(path)
    lock = Lock.take(data.path)
    try:
        return subtract(data.path, f"{PREFIX}{name.removeprefix(PREFIX)}", first, second, align, keep_z, progress=tell)
    finally:
        lock.release()


def compare_files(
    first: SurfaceName, second: SurfaceName, align: Align, keep_z: bool
) -> tuple[Mosaic, Callable[[], Comparison]]:
    """The difference of two surfaces, not written anywhere, and how to have its numbers."""
    tallied = StreamingStatistics(_compared(first, second, align, keep_z))
    return tallied.difference, lambda: tallied.comparison(first, second)


def _compared(first: SurfaceName, second: SurfaceName, align: Align, keep_z: bool) -> Difference:
    from wafer_viewer.reconstruct.comparison.compare import compare

    if first == second:
        raise DatasetError(f"{first.words} was to be compared with itself: choose another surface.")
    difference = compare(opened(first), opened(second), align, keep_z)
    notes = (f"{second.words} minus {first.words}.", *difference.provenance.notes[1:])
    return dataclasses.replace(difference, provenance=replace(difference.provenance, notes=notes))


def _later(progress: Progress, done: float) -> None:
    progress(ALIGN_SHARE + (1 - ALIGN_SHARE) * done)


def _sweep(folder: Path) -> None:
    """Remove what comparisons left behind whose process was killed; there is never more than one at a time."""
    for left in folder.glob(f".{PREFIX}*.part"):
        pid = left.name.removesuffix(".part").rpartition(".")[2].partition("-")[0]
        if pid != str(os.getpid()):
            remove(left)


@dataclasses.dataclass(eq=False)
class StreamingStatistics:
    """A difference that keeps the sums over the windows that are made of it, each window once."""

    difference: Difference
    _sums: dict[tuple[float, float], DifferenceStatistics] = dataclasses.field(
        default_factory=dict[tuple[float, float], "DifferenceStatistics"]
    )

    @property
    def pixel_um(self) -> float:
        """Pixel size."""
        return self.difference.pixel_um

    @property
    def x0_um(self) -> float:
        """Stage x of pixel (0, 0)."""
        return self.difference.x0_um

    @property
    def y0_um(self) -> float:
        """Stage y of pixel (0, 0)."""
        return self.difference.y0_um

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols)."""
        return self.difference.shape

    @property
    def levels(self) -> int:
        """It has one level."""
        return 1

    @property
    def provenance(self) -> Provenance:
        """That of the difference."""
        return self.difference.provenance

    def window(self, region: Region | None = None, level: int = 0) -> HeightMap:
        """A window of the difference. The one pixel that a header is made by begins as the first window does."""
        part = self.difference.window(region, level)
        self._sums[part.x0_um, part.y0_um] = self.difference.sums(part)
        return part

    def comparison(self, first: SurfaceName, second: SurfaceName) -> Comparison:
        """What was compared and how it came out, by the windows that were made; by all of it where none was."""
        total = sum(self._sums.values(), DifferenceStatistics()) if self._sums else None
        provenance = self.provenance
        calibration = provenance.calibration
        return Comparison(
            first=first,
            second=second,
            registration=self.difference.registration,
            change=self.difference.change(total),
            simulated=provenance.simulated,
            calibrated=calibration is not None and calibration.problem(calibration.setup, today()) is None,
            notes=provenance.notes,
        )
