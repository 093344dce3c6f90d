"""Worker tasks: each names a dataset, opens it itself, writes its own file and can be repeated.

Pixels are passed through the dataset, never through the scheduler. The command line calls the same functions directly.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.focus_stack import FieldStack, Image
from wafer_viewer.model.acquisition.image_source import ImageOptions
from wafer_viewer.model.acquisition.plan import MIN_FRAMES, Shot
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.file_contents import FileContents, FrameFact
from wafer_viewer.model.progress import Progress, ShouldStop, never, silent
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.model.surface_format import Reading
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.formats.field_scene import write_scene

if TYPE_CHECKING:
    from wafer_viewer.store.dataset.compression import CompressionReport


# --------------------------------------------------------------------------------------------------------- field export


def write_fields(
    dataset: str | Path,
    folder: str | Path,
    result: str = "default",
    progress: Progress | None = None,
    should_stop: ShouldStop | None = None,
) -> Path:
    """Write the fields of a stitched surface as an OME-NGFF scene of images.

    Parameters
    ----------
    dataset : str or Path
        Dataset NAME.wafer whose fields were stitched.
    folder : str or Path
        Folder to write, ``NAME.ome.zarr``; it must not exist.
    result : str
        Name of the reconstruction.
    progress : callable, optional
        Receives the completed fraction, 0 to 1.
    should_stop : callable, optional
        Returns True if the work should stop.

    Returns
    -------
    Path
        The folder written.

    Raises
    ------
    DatasetError
        When the fields were not stitched, the folder exists, does not end with ``.zarr`` or cannot be written, or
        the work is stopped.

    Notes
    -----
    Each field is a multiscale image ``r0000c0000`` (float32) of two channels: the grey value of the all-in-focus
    picture, and the height in um, NaN without one, from which the field's own offset, tilt and sag are removed. The
    scene translates every image to the coordinate system *stitched* and to *stage*; fields that are left out of the
    mosaic have only the latter. x is that of the stage and y minus that of the stage, as in ``mosaic.zarr``, for the
    centres of pixels in um. The attribute ``wafer_viewer`` of an image holds the pose with its standard uncertainties
    (k = 1).

    References
    ----------
    .. [1] OME-NGFF 0.6, https://ngff.openmicroscopy.org/specifications/0.6/index.html
    """
    data, target = Dataset.open(Path(dataset)), Path(folder)
    stored = data.result(result)
    if (poses := stored.poses()) is None:
        raise DatasetError(f"{data.path.name} has no stitched surface {result!r}: stitch it first.")
    fields = (data.field(int(number)) for number in poses.numbers)
    surfaces = ((field.name, stored.surface(field)) for field in fields)
    about = {"dataset": data.path.name, "result": result, "notes": list(poses.notes)}
    write_scene(target, surfaces, poses, about, progress, should_stop)
    return target


# --------------------------------------------------------------------------------------------------------- worker tasks


LIVE_BITS = 8
LIVE_LOOK_EVERY_S = 0.02
LIVE_PATIENCE_S = 20.0
"""Polling interval and maximum wait in seconds for frames of a field during its scan."""


def reconstruct_field(
    dataset: Path,
    field_number: int,
    result: str,
    recipe: Recipe,
    threads: int | None = 1,
    *,
    progress: Progress = silent,
    should_stop: ShouldStop = never,
) -> None:
    """Reconstruct the surface of one field and store it in a result.

    The `auto` choices of the first representative field are stored for the others, so that a scan is processed
    uniformly.
    """
    from wafer_viewer.reconstruct.field_pipeline import is_representative, reconstruct
    from wafer_viewer.store.dataset.dataset import Dataset

    data = Dataset.open(dataset)
    stored = data.result(result)
    recipe = stored.settled() or recipe
    surface = reconstruct(data.stack(field_number), recipe, progress=progress, threads=threads)
    if recipe.heights_have_auto and is_representative(surface):
        # First: after an interruption the field is made again with these values, which gives the same bytes. The other
        # way round the next field would choose for all others.
        stored.save_settled(surface.provenance.recipe)
    stored.save_surface(data.field(field_number), surface)


def compress_frames(
    dataset: Path, codec: str, *, progress: Progress = silent, should_stop: ShouldStop = never
) -> CompressionReport:
    """Compress the frames of a dataset without loss; the fields that are done stay so when it is stopped."""
    from wafer_viewer.store.dataset.dataset import Dataset

    return Dataset.open(dataset).compress(codec, progress, should_stop)


def find_damaged_frames(
    dataset: Path, *, progress: Progress = silent, should_stop: ShouldStop = never
) -> tuple[Shot, ...]:
    """Return the frames of a dataset that differ from their checksums, by field and frame; reads all of them.

    Raises DatasetError when stopped.
    """
    from wafer_viewer.store.dataset.damaged_frames import find_damage
    from wafer_viewer.store.dataset.dataset import Dataset

    damages = find_damage(Dataset.open(dataset), progress, should_stop)
    return tuple(
        sorted((shot for damage in damages for shot in damage.shots), key=lambda s: (s.field, s.k, s.exposure))
    )


def reconstruct_live(
    dataset: Path, field_number: int, result: str, *, progress: Progress = silent, should_stop: ShouldStop = never
) -> bool:
    """Reconstruct a field while its frames are taken, with the recipe resolved by earlier fields.

    Return False, without a surface, if there is no such recipe yet, the frames are of an unsuitable kind, or not all of
    them arrived.
    """
    from wafer_viewer.reconstruct.live_field import LiveField
    from wafer_viewer.store.dataset.dataset import Dataset

    data = Dataset.open(dataset)
    stored = data.result(result)
    recipe = stored.settled()
    if recipe is None or data.n_exposures > 1 or data.scan.bits > LIVE_BITS:
        return False
    live: LiveField | None = None
    for stack in _growing(data, field_number, should_stop):
        live = live or LiveField(stack.images, stack.z_step_um, recipe)
        live.take_new(stack.present)
        if field_number in data.complete_fields():
            stored.save_surface(data.field(field_number), live.surface(stack))
            return True
    return False


def _growing(data: Dataset, field_number: int, should_stop: ShouldStop) -> Iterator[FieldStack]:
    """Yield the stack of a field whenever frames arrive, until it is complete, one was missed, or no more arrive."""
    complete, before, came_at = False, 0, time.monotonic()
    while not complete and time.monotonic() - came_at < LIVE_PATIENCE_S and not should_stop():
        data.refresh()
        now = sum(shot.field == field_number for shot in data.arrived())
        if any(shot.field == field_number for shot in data.ever_missed()):
            return
        complete = field_number in data.complete_fields()
        if complete or (now > before and now >= MIN_FRAMES):
            before, came_at = now, time.monotonic()
            yield data.stack(field_number, verify=False)  # frames just written are not verified each time
        else:
            time.sleep(LIVE_LOOK_EVERY_S)


def import_images(
    srcs: Sequence[Path],
    out: Path,
    options: ImageOptions,
    overlap_fraction: float,
    *,
    progress: Progress = silent,
    should_stop: ShouldStop = never,
) -> Path:
    """Import images of another instrument into a dataset."""
    from wafer_viewer.store.dataset.stack_import import dataset_of

    paths = srcs[0] if len(srcs) == 1 else tuple(srcs)
    return dataset_of(paths, out, options, overlap_fraction, progress, should_stop).path


def stitch_images(
    srcs: Sequence[Path],
    out: Path,
    options: ImageOptions,
    overlap_fraction: float,
    *,
    progress: Progress = silent,
    should_stop: ShouldStop = never,
) -> Path:
    """Make one picture of single images, with the table of their places beside it."""
    from wafer_viewer.session.surface.image_tiles import write_stitched

    paths, table = srcs[0] if len(srcs) == 1 else tuple(srcs), out.with_name(f"{out.name.split('.')[0]}-places.csv")
    write_stitched(paths, out, table, options, overlap_fraction, progress=progress, should_stop=should_stop)
    return out


@dataclass(frozen=True, slots=True, eq=False)
class SeenFrames:
    """Frames that a look at files has read: sharpness and thumbnail by `FrameFact.key`."""

    sharpness: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)
    pictures: Mapping[str, bytes] = field(default_factory=dict)

    def of_the_last(self) -> SeenFrames:
        """Return at most `MOST_SEEN` frames, the last ones."""
        keys = list(self.pictures)[-MOST_SEEN:]
        return SeenFrames({key: self.sharpness[key] for key in keys}, {key: self.pictures[key] for key in keys})


MOST_SEEN = 2000
"""Frames that are known again: 10 MB of thumbnails."""


def look_at_files(
    srcs: Sequence[Path],
    options: ImageOptions,
    says: Reading,
    most_pictures: int,
    seen: SeenFrames = SeenFrames(),
    *,
    progress: Progress = silent,
    should_stop: ShouldStop = never,
) -> tuple[FileContents, dict[int, bytes], SeenFrames]:
    """Return what files hold that may be imported, thumbnails of frames, spread over z, by number, and what was seen.

    seen: by an earlier look; frames whose file is unchanged are not read again.
    """
    from wafer_viewer.store.dataset.file_contents import file_contents
    from wafer_viewer.store.dataset.preview import thumbnail_jpeg

    read, sharpness = dict[int, bytes](), dict(seen.sharpness)

    def keep(k: int, image: Image) -> None:
        read[k] = thumbnail_jpeg(image)

    paths = srcs[0] if len(srcs) == 1 else tuple(srcs)
    found = file_contents(
        paths, options, says, on_frame=keep, progress=progress, should_stop=should_stop, seen=sharpness
    )
    pictures = {**seen.pictures, **{found.frames[k].key: jpeg for k, jpeg in read.items()}}
    frames = {k: found.frames[k].key for k in spread_frames(found.frames, most_pictures)}
    thumbnails = {k: pictures[key] for k, key in frames.items() if key in pictures}
    return found, thumbnails, SeenFrames(sharpness, pictures).of_the_last()


def spread_frames(frames: Sequence[FrameFact], most: int) -> tuple[int, ...]:
    """Return the numbers of at most `most` present frames, evenly spread, with those beside the first gap."""
    present = [k for k, frame in enumerate(frames) if frame.name]
    if len(present) <= most:
        return tuple(present)
    chosen = [present[round(n * (len(present) - 1) / (most - 1))] for n in range(most)]
    gap = next((k for k, frame in enumerate(frames) if not frame.name), None)
    if gap is not None:
        beside = [k for k in (gap - 1, gap + 1) if k in present]
        others = [k for k in chosen if k not in beside]
        others.sort(key=lambda k: abs(k - gap), reverse=True)
        chosen = [*others[: most - len(beside)], *beside]
    return tuple(sorted(chosen))


def export_surface(
    dataset: Path,
    result: str,
    field_number: int | None,
    out: Path,
    every: int | None = None,
    part: Region | None = None,
    *,
    progress: Progress = silent,
    should_stop: ShouldStop = never,
) -> Path:
    """Write the mosaic, a field's surface, or a layer of a comparison (below 0), in the format of the ending of `out`.

    part: only the upright rectangle around this region.
    """
    from wafer_viewer.model.surface.comparison import ComparisonFace
    from wafer_viewer.model.surface.height_map import Mosaic, PartOfMosaic
    from wafer_viewer.session.surface.comparison_job import comparison_view
    from wafer_viewer.store.dataset.dataset import Dataset
    from wafer_viewer.store.formats.conversion import export

    data = Dataset.open(dataset)
    stored = data.result(result)
    surface: Mosaic
    if field_number is not None and field_number < 0:
        surface = comparison_view(dataset, result, ComparisonFace(-field_number))
    else:
        surface = stored.mosaic() if field_number is None else stored.surface(data.field(field_number))
    return export(surface if part is None else PartOfMosaic(surface, part), out, every, progress, should_stop)


def export_fields(
    dataset: Path, result: str, out: Path, *, progress: Progress = silent, should_stop: ShouldStop = never
) -> Path:
    """Write the fields of a stitched surface as images in place."""
    return write_fields(dataset, out, result, progress, should_stop)
