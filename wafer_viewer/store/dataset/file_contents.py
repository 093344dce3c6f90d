"""Contents of a file or folder before it is imported: axes, lengths with their sources, frames in order, and doubts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from wafer_viewer.model.acquisition.image_source import ImageOptions, ImagePlane, Stated
from wafer_viewer.model.acquisition.plan import MIN_FRAMES
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.file_contents import Fact, FileContents, FrameFact
from wafer_viewer.model.progress import Progress, ShouldStop, with_progress
from wafer_viewer.model.surface_format import Reading
from wafer_viewer.numerics.frame_sequence import place_sharpness
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.formats.conversion import is_surface_file, read_surface
from wafer_viewer.store.images.image_files import Paths, image_files, planes_of
from wafer_viewer.store.images.stack_source import SourceField, StackSource, order_doubt, read_source

DATASET_ENDING = ".wafer"
SHOWN_PLACES = 5
"""Places of a frame whose sharpness is told: those where it changes most."""
_NAMED = 8


def file_contents(
    src: Paths,
    options: ImageOptions = ImageOptions(),
    reading: Reading = Reading(),
    *,
    look: bool = True,
    progress: Progress | None = None,
    should_stop: ShouldStop | None = None,
) -> FileContents:
    """Return what a source of images or heights contains, and what has to be settled before it is imported.

    Nothing is written.

    Parameters
    ----------
    src : str, Path or sequence of them
        Folder of images, image file, several of them, a surface file, or a dataset.
    options : ImageOptions
        Values and choices of the user for images.
    reading : Reading
        Values of the user for a surface file.
    look : bool, default True
        Read all frames of the first field, for their sharpness and the order that it supports.
    progress : callable, optional
        Receives the completed fraction, 0 to 1.
    should_stop : callable, optional
        Returns True if the work should stop.

    Returns
    -------
    FileContents
        Facts with their sources, the frames of the first field in the order of z, notes and doubts.

    Raises
    ------
    DatasetError
        When the source does not exist or is of a kind that is not read, or the work is stopped.
    """
    alone = _alone(src)
    if alone is not None and alone.is_dir() and alone.name.endswith(DATASET_ENDING):
        return _of_dataset(alone)
    if alone is not None and is_surface_file(alone):
        return _of_surface(alone, reading, progress, should_stop)
    return _of_images(src, options, look, progress, should_stop)


def _alone(src: Paths) -> Path | None:
    if isinstance(src, str | Path):
        return Path(src)
    return Path(src[0]) if len(src) == 1 else None


# --- datasets and surfaces


def _of_dataset(path: Path) -> FileContents:
    data = Dataset.open(path)
    plan = data.scan.plan
    facts = (
        Fact("fields", str(len(data.fields))),
        Fact("frames of a field", str(plan.sweep.n_frames)),
        Fact("frame", f"{plan.cols} x {plan.rows} px"),
        _length("pixel size", Stated(plan.pixel_um, "scan record")),
        _length("z step", Stated(plan.sweep.z_step_um, "scan record")),
        Fact("sample", "simulated" if data.scan.simulated else "real", "scan record"),
        Fact("surfaces", ", ".join(data.results()) or "none"),
    )
    return FileContents(path.name, "dataset", facts, fields=len(data.fields))


def _of_surface(
    path: Path, reading: Reading, progress: Progress | None, should_stop: ShouldStop | None
) -> FileContents:
    try:
        given = reading.z_unit, reading.pixel_um, reading.invert_z
        surface = read_surface(path, *given, progress, should_stop, table=reading.table)
    except DatasetError as doubt:
        if not path.is_file():
            raise
        return FileContents(path.name, "surface", (), doubts=(str(doubt),))
    known = surface.z_um[np.isfinite(surface.z_um)]
    rows, cols = surface.z_um.shape
    provenance = surface.provenance
    facts = [
        Fact("lattice", f"{cols} x {rows} points"),
        _length("pixel size", Stated(surface.pixel_um, "")),
        Fact("gaps", f"{1 - known.size / surface.z_um.size:.1%}"),
        Fact("sample", "simulated" if provenance.simulated else "real or not stated"),
    ]
    if known.size:
        facts.insert(2, Fact("heights", f"{known.min():.6g} to {known.max():.6g} um"))
    return FileContents(path.name, "surface", tuple(facts), notes=provenance.notes)


# --- images


def _of_images(
    src: Paths, options: ImageOptions, look: bool, progress: Progress | None, should_stop: ShouldStop | None
) -> FileContents:
    name = _name(src)
    planes = [plane for path in image_files(src) for plane in planes_of(path)]
    facts = tuple(_facts(planes))
    try:
        source = read_source(src, options)
    except DatasetError as doubt:
        frames = tuple(FrameFact(plane.name, plane.z_um) for plane in planes)
        return FileContents(name, "images", facts, frames, doubts=(str(doubt),))
    field = source.fields[0]
    frames, doubts = _frames(field, source), list[str]()
    if len(frames) < MIN_FRAMES:
        doubts.append(f"There are {len(frames)} frames: at least {MIN_FRAMES} are needed to find a focus peak.")
    if look and not doubts:
        frames, doubts = _looked_at(frames, field, source, progress, should_stop)
    facts = (*facts, *_agreed(source))
    return FileContents(name, "images", facts, frames, len(source.fields), source.notes, tuple(doubts))


def _name(src: Paths) -> str:
    alone = _alone(src)
    return alone.name if alone is not None else f"{len(src)} files"  # type: ignore[arg-type]


def _facts(planes: Sequence[ImagePlane]) -> Iterator[Fact]:
    """Yield what the files hold before any choice: their number, size, axes, and what they say."""
    image = planes[0].read()
    yield Fact("files", str(len({plane.path for plane in planes})))
    yield Fact("images", f"{len(planes)} of {image.shape[1]} x {image.shape[0]} px, {8 * image.dtype.itemsize} bits")
    for axis in ("position", "channel", "time"):
        names = list(dict.fromkeys(getattr(plane, axis) for plane in planes))
        if len(names) > 1:
            more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
            yield Fact(f"{axis}s", ", ".join(name or "unnamed" for name in names[:_NAMED]) + more, planes[0].path.name)
    says = planes[0].says
    for plane in planes[1:]:
        says = says.merged(plane.says)
    for title, stated in (("objective", says.objective), ("taken", says.taken)):
        if stated is not None:
            yield Fact(title, stated.value, stated.source)
    exposures = sorted({plane.exposure_us for plane in planes if plane.exposure_us is not None})
    if exposures:
        yield Fact("exposure", ", ".join(f"{us:g} us" for us in exposures[:_NAMED]))
    yield Fact("sample", "simulated" if any(plane.simulated for plane in planes) else "real or not stated")


def _agreed(source: StackSource) -> Iterator[Fact]:
    """Yield the lengths that are used, with their sources."""
    yield _length("pixel size", source.pixel_um)
    yield _length("z step", source.z_step_um)
    if source.numerical_aperture is not None:
        yield Fact("numerical aperture", f"{source.numerical_aperture.value:g}", source.numerical_aperture.source)
    if len(source.fields) > 1:
        yield Fact("fields", str(len(source.fields)))
    missing = sum(None in slot for field in source.fields for slot in field.slots)
    if missing:
        yield Fact("missing frames", str(missing))


def _length(name: str, stated: Stated[float]) -> Fact:
    return Fact(name, f"{stated.value:.6g} um", stated.source)


def _frames(field: SourceField, source: StackSource) -> tuple[FrameFact, ...]:
    z_um = field.z_um or tuple(k * source.z_step_um.value for k in range(len(field.slots)))
    return tuple(
        FrameFact("" if slot[0] is None else slot[0].name, z) for slot, z in zip(field.slots, z_um, strict=True)
    )


def _looked_at(
    frames: tuple[FrameFact, ...],
    field: SourceField,
    source: StackSource,
    progress: Progress | None,
    should_stop: ShouldStop | None,
) -> tuple[tuple[FrameFact, ...], list[str]]:
    """Return the frames with their sharpness, and a doubt where it contradicts their order."""
    there = [(k, slot[0]) for k, slot in enumerate(field.slots) if slot[0] is not None]
    told = with_progress(there, len(there), "Looking at the images", progress, should_stop)
    seen = [place_sharpness(plane.read()) for _, plane in told]
    if len({len(one) for one in seen}) > 1:
        return frames, ["The images have several sizes: give those of one size."]
    sharpness = np.stack(seen)
    most = np.argsort(np.ptp(sharpness, 0) / (sharpness.max(0) + 1e-12))[::-1][:SHOWN_PLACES]
    shown = sharpness[:, most] / (sharpness[:, most].max(0) + 1e-12)
    known = list(frames)
    for (k, _), row in zip(there, shown, strict=True):
        known[k] = replace(known[k], sharpness=tuple(float(value) for value in row))
    if source.order_is_stated:
        return tuple(known), []
    doubt = order_doubt([plane.name for _, plane in there], sharpness)
    return tuple(known), [] if doubt is None else [doubt]
