"""Contents of a file or folder before it is imported: axes, lengths with their sources, frames in order, and doubts."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.focus_stack import Image
from wafer_viewer.model.acquisition.image_source import ImageOptions, ImagePlane, Stated
from wafer_viewer.model.acquisition.plan import MIN_FRAMES
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.file_contents import DATASET_ENDING, AxisChoice, Fact, FileContents, FrameFact
from wafer_viewer.model.progress import Progress, ShouldStop, with_progress
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface_format import Reading
from wafer_viewer.numerics.frame_sequence import place_sharpness
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.dataset.stack_import import OVERLAP_FRACTION, placed_fields
from wafer_viewer.store.formats.conversion import is_surface_file, read_surface
from wafer_viewer.store.images.image_files import Paths, PlanesOf, image_files, planes_of
from wafer_viewer.store.images.stack_source import ImportSource, SourceField, UnsettledValue, order_doubt, read_source
from wafer_viewer.store.io.atomic_files import os_errors_as_dataset_errors

OnFrame = Callable[[int, Image], None]
SHOWN_PLACES = 5
"""Places of a frame whose sharpness is told."""
SHOWN_TILES = 12
"""Single images of a grid that are passed on."""
_NAMED = 8


def file_contents(
    src: Paths,
    options: ImageOptions = ImageOptions(),
    reading: Reading = Reading(),
    *,
    look: bool = True,
    on_frame: OnFrame | None = None,
    progress: Progress | None = None,
    should_stop: ShouldStop | None = None,
    seen: dict[str, NDArray[np.float64]] | None = None,
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
    on_frame : callable, optional
        Receives the number in the order of z, from 0, and the image [row, col] of each frame that is read.
    progress : callable, optional
        Receives the completed fraction, 0 to 1.
    should_stop : callable, optional
        Returns True if the work should stop.
    seen : dict, optional
        Sharpness of frames by `FrameFact.key`, from an earlier call, which are not read again; completed.

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
    return _of_images(src, options, look, _Look(on_frame, progress, should_stop, {} if seen is None else seen))


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


@dataclass(frozen=True, slots=True)
class _Look:
    """Look at the frames; seen: sharpness by key."""

    on_frame: OnFrame | None
    progress: Progress | None
    should_stop: ShouldStop | None
    seen: dict[str, NDArray[np.float64]]


def _of_images(src: Paths, options: ImageOptions, look: bool, how: _Look) -> FileContents:
    files, read = image_files(src), cache(planes_of)
    planes = [plane for path in files for plane in read(path)]
    first = planes[0].read()
    choices = tuple(_choices(planes))
    facts = tuple(_facts(planes, first, choices))
    found = FileContents(_name(src), "images", facts, choices=choices)
    source, refusals = _read(src, options, read)
    doubts = tuple(dict.fromkeys(str(refusal) for refusal in refusals))
    unsettled = {refusal.name: refusal for refusal in refusals if isinstance(refusal, UnsettledValue)}
    found = replace(found, doubts=doubts, unsettled=tuple(unsettled))
    if source is None:
        return replace(found, frames=tuple(FrameFact(plane.name, plane.z_um) for plane in planes))
    field = source.fields[0]
    frames = _tiles(source) if source.is_tiled else _frames(field, source, "z step" in unsettled)
    n_frames = sum(bool(frame.name) for frame in frames)
    if n_frames < MIN_FRAMES and not source.is_tiled:
        few = f"There are {n_frames} frames: at least {MIN_FRAMES} are needed to find a focus peak."
        found = replace(found, doubts=(*doubts, few))
    elif source.is_tiled:
        frames = _shown_tiles(frames, source, how) if look else frames
    elif look:
        frames, contradictions = _looked_at(frames, field, source, how)
        found = replace(found, doubts=(*doubts, *contradictions))
    taken = [plane for one in source.fields for slot in one.slots for plane in slot if plane is not None]
    taken_files = {plane.path for plane in taken}
    rows, cols = first.shape
    known = "pixel size" not in unsettled
    pixel_um = source.pixel_um.value
    places = placed_fields(source, first, OVERLAP_FRACTION) if known else ()
    return replace(
        found,
        facts=(*facts, *_agreed(source, unsettled)),
        frames=frames,
        fields=len(source.fields),
        is_tiled=source.is_tiled,
        notes=source.notes,
        left_out=tuple(path.name for path in files if path not in taken_files),
        places_um=tuple((place.x_um, place.y_um) for place in places),
        field_um=(cols * pixel_um, rows * pixel_um) if known else None,
        n_bytes=len(taken) * first.nbytes,
    )


def _read(src: Paths, options: ImageOptions, planes_of: PlanesOf) -> tuple[ImportSource | None, list[DatasetError]]:
    """Return the images with what has to be settled; a placeholder stands for each value that is open.

    None where it is something else than a value.
    """
    refusals = list[DatasetError]()
    while len(refusals) < _MOST_REFUSALS:
        try:
            return read_source(src, options, planes_of), refusals
        except UnsettledValue as refusal:
            refusals.append(refusal)
            options = _settled(options, refusal)
        except DatasetError as refusal:
            return None, [*refusals, refusal]
    return None, refusals


_MOST_REFUSALS = 12


def _settled(options: ImageOptions, refusal: UnsettledValue) -> ImageOptions:
    """Return the options with a placeholder for an unsettled value: the files' own, 1 um, or the first name."""
    option = _OPTIONS.get(refusal.name)
    if option is None:
        return replace(options, **{refusal.name: "0"})
    if refusal.values and getattr(options, option) is not None:
        return replace(options, **{option: None})
    if refusal.values:
        return replace(options, **{option: refusal.values[0].value}, overrule=True)
    return replace(options, **{option: 1.0})


_OPTIONS = {"pixel size": "pixel_um", "z step": "z_step_um", "numerical aperture": "numerical_aperture"}


def _name(src: Paths) -> str:
    alone = _alone(src)
    return alone.name if alone is not None else f"{len(src)} files"  # type: ignore[arg-type]


def _choices(planes: Sequence[ImagePlane]) -> Iterator[AxisChoice]:
    for axis in ("position", "channel", "time"):
        names = tuple(dict.fromkeys(getattr(plane, axis) for plane in planes))
        if len(names) > 1:
            yield AxisChoice(axis, names)


def _facts(planes: Sequence[ImagePlane], image: Image, choices: Sequence[AxisChoice]) -> Iterator[Fact]:
    """Yield what the files hold before any choice: their number, size, axes, and what they say."""
    yield Fact("files", str(len({plane.path for plane in planes})))
    yield Fact("images", f"{len(planes)} of {image.shape[1]} x {image.shape[0]} px, {8 * image.dtype.itemsize} bits")
    for choice in choices:
        more = f" and {len(choice.names) - _NAMED} more" if len(choice.names) > _NAMED else ""
        shown = ", ".join(name or "unnamed" for name in choice.names[:_NAMED])
        yield Fact(f"{choice.axis}s", shown + more, planes[0].path.name)
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


def _agreed(source: ImportSource, unsettled: Mapping[str, UnsettledValue]) -> Iterator[Fact]:
    """Yield the lengths that are used, with their sources; those that are not settled with all their values."""
    for name, unit, stated in (
        ("pixel size", " um", source.pixel_um),
        ("z step", " um", source.z_step_um),
        ("numerical aperture", "", source.numerical_aperture),
    ):
        values = unsettled[name].values if name in unsettled else () if stated is None else (stated,)
        if (values or name in unsettled) and not (name == "z step" and source.is_tiled):
            shown = " or ".join(f"{abs(value.value):.6g}{unit}" for value in values)
            yield Fact(name, shown, "; ".join(value.source for value in values))
    if len(source.fields) > 1:
        yield Fact("fields", str(len(source.fields)))
    missing = sum(None in slot for field in source.fields for slot in field.slots)
    if missing:
        yield Fact("missing frames", str(missing))


def _length(name: str, stated: Stated[float]) -> Fact:
    return Fact(name, f"{stated.value:.6g} um", stated.source)


def _frames(field: SourceField, source: ImportSource, z_is_open: bool) -> tuple[FrameFact, ...]:
    z_um = field.z_um or tuple(None if z_is_open else k * source.z_step_um.value for k in range(len(field.slots)))
    return tuple(
        FrameFact("" if slot[0] is None else slot[0].name, z) for slot, z in zip(field.slots, z_um, strict=True)
    )


def _tiles(source: ImportSource) -> tuple[FrameFact, ...]:
    planes = (field.slots[0][0] for field in source.fields)
    return tuple(FrameFact("" if plane is None else plane.name, None) for plane in planes)


def _shown_tiles(frames: tuple[FrameFact, ...], source: ImportSource, how: _Look) -> tuple[FrameFact, ...]:
    """Look at some of the single images, spread over the fields; return them with their keys."""
    shown = list(frames)
    for n in np.unique(np.linspace(0, len(shown) - 1, min(len(shown), SHOWN_TILES)).astype(int)).tolist():
        plane = source.fields[n].slots[0][0]
        if plane is not None:
            shown[n] = replace(shown[n], key=_key(plane))
            _place_sharpness(n, plane, shown[n].key, how)
    return tuple(shown)


def _key(plane: ImagePlane) -> str:
    """Return what changes with the file of a plane: its path, page, size and time."""
    with os_errors_as_dataset_errors(plane.path):
        state = plane.path.stat()
    return f"{plane.path}|{plane.page}|{plane.name}|{state.st_size}|{state.st_mtime_ns}"


def _place_sharpness(k: int, plane: ImagePlane, key: str, how: _Look) -> NDArray[np.float64]:
    """Return the sharpness of a frame, which is read unless it was seen."""
    if key not in how.seen:
        image = plane.read()
        how.seen[key] = place_sharpness(image)
        if how.on_frame is not None:
            how.on_frame(k, image)
    return how.seen[key]


def _looked_at(
    frames: tuple[FrameFact, ...],
    field: SourceField,
    source: ImportSource,
    how: _Look,
) -> tuple[tuple[FrameFact, ...], list[str]]:
    """Return the frames with their sharpness, and a doubt where it contradicts their order."""
    there = [(k, slot[0]) for k, slot in enumerate(field.slots) if slot[0] is not None]
    told = with_progress(there, len(there), "Looking at the images", how.progress, how.should_stop)
    known, seen = list(frames), list[NDArray[np.float64]]()
    for k, plane in told:
        known[k] = replace(known[k], key=_key(plane))
        seen.append(_place_sharpness(k, plane, known[k].key, how))
    if len({len(one) for one in seen}) > 1:
        return tuple(known), ["The images have several sizes: give those of one size."]
    sharpness = np.stack(seen)
    places = _shown_places(sharpness)
    shown = sharpness[:, places] / (sharpness[:, places].max(0) + 1e-12)
    for (k, _), row in zip(there, shown, strict=True):
        known[k] = replace(known[k], sharpness=tuple(float(value) for value in row))
    if source.order_is_stated:
        return tuple(known), []
    doubt = order_doubt([plane.name for _, plane in there], sharpness)
    return tuple(known), [] if doubt is None else [doubt]


def _shown_places(sharpness: NDArray[np.float64]) -> NDArray[np.intp]:
    """Return the places that are told: of the half where sharpness changes most, those with peaks spread over z."""
    change = np.ptp(sharpness, 0) / (sharpness.max(0) + 1e-12)
    most = np.argsort(-change, kind="stable")[: max(SHOWN_PLACES, len(change) // 2)]
    by_peak = most[np.argsort(sharpness[:, most].argmax(0), kind="stable")]
    spread = np.linspace(0, len(by_peak) - 1, min(SHOWN_PLACES, len(by_peak)))
    return by_peak[np.rint(spread).astype(np.intp)]
