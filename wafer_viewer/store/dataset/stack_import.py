"""Import of external stacks: opened for one reconstruction, or imported as a dataset.

What the files say of themselves is used: pixel size, z, places, exposures, the aperture of the objective, and whether
they are simulated. What the user gives completes it. The stacks have no calibration, and their lengths are
uncalibrated.
"""

from __future__ import annotations

import hashlib
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from wafer_viewer.model.acquisition.calibration import WAVELENGTH_UM, OpticalSetup, depth_of_field_um
from wafer_viewer.model.acquisition.focus_stack import FieldStack, Frame, FrameStatus, Image
from wafer_viewer.model.acquisition.image_source import Corner, GridOrder, ImageOptions, ImagePlane, Mirror, Stated
from wafer_viewer.model.acquisition.plan import (
    IMPORT,
    MIN_FRAMES,
    UNKNOWN_EXPOSURE_US,
    Field,
    FieldGrid,
    FocusSweep,
    ScanPlan,
    Shot,
)
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.job import Job
from wafer_viewer.model.progress import Progress, ShouldStop, with_progress
from wafer_viewer.numerics.frame_sequence import place_sharpness
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.dataset.writer import DatasetWriter
from wafer_viewer.store.images.image_files import NOTHING_WRITTEN, Paths
from wafer_viewer.store.images.stack_source import ImportSource, SourceField, order_doubt, read_source
from wafer_viewer.store.io.atomic_files import atomic_write, require_space
from wafer_viewer.store.records.manifest import forget_marks, sign_scan

MAX_OVERLAP = 0.5
OVERLAP_FRACTION = 0.1
"""Overlap of neighbouring fields where it is not given."""
MIN_WAVELENGTH_UM, MAX_WAVELENGTH_UM = 0.2, 2.0


def open_stack(
    src: Paths,
    z_step_um: float | None = None,
    pixel_um: float | None = None,
    z_start_um: float = 0.0,
    progress: Progress | None = None,
    should_stop: ShouldStop | None = None,
    *,
    numerical_aperture: float | None = None,
    wavelength_um: float | None = None,
    channel: str | None = None,
    time: str | None = None,
    position: str | None = None,
    only: str | None = None,
    as_listed: bool = False,
    overrule: bool = False,
) -> FieldStack:
    """Read a folder of images, a multi-page TIFF or a list of files.

    The images are read into memory as one field, lowest frame first.

    Parameters
    ----------
    src : str, Path or sequence of them
        Folder of images, image file (with all pages of a multi-page TIFF), or several of them. The files of a folder
        are sorted by the numbers of their names: 2 before 10, -5 before 2.5, 9999 before the 0001 of a counter that
        began anew. A list keeps its order.
    z_step_um : float, optional
        Distance between frames in um, required where neither the files nor their names say it. A negative value means
        that the images were taken downward; their order is reversed.
    pixel_um : float, optional
        Pixel size on the sample in um, over 0, required where the files do not say it.
    z_start_um : float, default 0.0
        Height of the lowest frame in um.
    progress : callable, optional
        Receives the completed fraction, 0 to 1.
    should_stop : callable, optional
        Returns True if the work should stop.
    numerical_aperture : float, optional
        Numerical aperture of the objective in air, between 0 and 1. Its depth of field bounds the width of focus
        curves. Without it the pixel size sets the bound, and heights near walls cannot always be tested.
    wavelength_um : float, optional
        Wavelength of the light in um, from 0.2 to 2. Default: 0.55 um.
    channel, time, position : str, optional
        Name of the one to take, or its number from 0, where the files have several.
    only : str, optional
        Pattern of the file names to take, such as ``img_*.png``.
    as_listed : bool, default False
        Take all files in the order given, or in natural order from a folder, without a look for gaps, copies and files
        that are no frames.
    overrule : bool, default False
        Take the given values where the files state others.

    Returns
    -------
    FieldStack
        Images [k, row, col], uint8 or uint16, with z in um, rising; the field has number 1 and its centre at (0, 0).
        It has no calibration, so that its lengths are uncalibrated. It is simulated if any of the files says so. The
        slot of a missing number is empty. `notes` tell what was found in the files.

    Raises
    ------
    DatasetError
        When the step or the pixel size is unknown or invalid, or differs from what the files state; the aperture or the
        wavelength is out of range; a path does not exist or is no image; the names leave the order open, or number two
        things; there are several channels, times or positions and none is chosen; fewer than three images are found; an
        image is damaged, or differs in size or depth from those before it; or the work is stopped.

    Notes
    -----
    Colour is converted to luminance with the weights of ITU-R BT.709 [1]_ on the stored values; 8 and 16 bits are
    preserved. The depth of field is wavelength / NA^2 + pixel size / NA.

    References
    ----------
    .. [1] Recommendation ITU-R BT.709, Parameter values for the HDTV standards for production and international
       programme exchange.
    """
    options = ImageOptions(
        z_step_um=z_step_um,
        pixel_um=pixel_um,
        numerical_aperture=numerical_aperture,
        wavelength_um=wavelength_um,
        channel=channel,
        time=time,
        position=position,
        only=only,
        as_listed=as_listed,
        overrule=overrule,
    )
    return stack_of(src, options, z_start_um, progress, should_stop)


def stack_of(
    src: Paths,
    options: ImageOptions,
    z_start_um: float = 0.0,
    progress: Progress | None = None,
    should_stop: ShouldStop | None = None,
) -> FieldStack:
    """Read images as one field; see `open_stack`. options: values and choices of the user."""
    source = read_source(src, options)
    field = _only_field(source)
    slots = [slot[0] for slot in field.slots]
    _require_frames(sum(plane is not None for plane in slots), "the source")
    images = _read_all(slots, progress, should_stop)
    if not source.order_is_stated:
        _require_supported((plane, image) for plane, image in zip(slots, images, strict=True) if plane is not None)
    z_um = field.z_um or source.z_step_um.value * np.arange(len(slots), dtype=np.float64)
    return FieldStack(
        field=Field(number=1, row=0, col=0, x_um=0.0, y_um=0.0, z_start_um=z_start_um),
        images=images,
        z_um=z_start_um + np.asarray(z_um, np.float64),
        present=np.array([plane is not None for plane in slots]),
        pixel_um=source.pixel_um.value,
        checksum=hashlib.sha256(b"".join(b"%08x" % zlib.crc32(image.data) for image in images)).hexdigest(),
        source=_source_name(src),
        simulated=source.simulated,
        exposure_us=next(iter(source.exposures_us), np.nan),
        depth_of_field_um=_depth_um(source.numerical_aperture, options.wavelength_um, source.pixel_um.value),
        notes=source.notes,
    )


def _require_supported(frames: Iterable[tuple[ImagePlane, Image]]) -> None:
    """Raise DatasetError when the images contradict the order that their names give them."""
    seen = [(plane.name, place_sharpness(image)) for plane, image in frames]
    if len({len(sharpness) for _, sharpness in seen}) > 1:  # of several sizes, which is refused elsewhere
        return
    doubt = order_doubt([name for name, _ in seen], np.stack([sharpness for _, sharpness in seen]))
    if doubt is not None:
        raise DatasetError(f"{doubt} {NOTHING_WRITTEN}")


def _only_field(source: ImportSource) -> SourceField:
    """Return the field of a source. Raises DatasetError where a choice of position or exposure is missing."""
    if len(source.fields) > 1:
        names = ", ".join(field.name for field in source.fields[:8])
        raise DatasetError(
            f"The images have {len(source.fields)} positions: {names}. Choose one with --position, or import them all "
            "as a dataset."
        )
    field = next(iter(source.fields))
    if len(field.slots[0]) > 1:
        raise DatasetError(
            f"The images have {len(field.slots[0])} exposures of each frame: import them as a dataset, which fuses "
            "them."
        )
    return field


def _say_nothing(_: str) -> None: ...


def import_dataset(
    srcs: Paths,
    out: str | Path,
    z_step_um: float | None = None,
    pixel_um: float | None = None,
    pattern: str | None = None,
    overlap_fraction: float = OVERLAP_FRACTION,
    progress: Progress | None = None,
    should_stop: ShouldStop | None = None,
    *,
    numerical_aperture: float | None = None,
    wavelength_um: float | None = None,
    channel: str | None = None,
    time: str | None = None,
    position: str | None = None,
    only: str | None = None,
    as_listed: bool = False,
    overrule: bool = False,
    columns: int | None = None,
    order: GridOrder = "rows",
    corner: Corner = "top-left",
    mirror: Mirror = "none",
    places: str | Path | None = None,
) -> Dataset:
    """Copy images into a new dataset of one or more fields.

    The dataset appears only once it is complete.

    Parameters
    ----------
    srcs : str, Path or sequence of them
        Folder of images, image file (with all pages of a multi-page TIFF), or several of them.
    out : str or Path
        Folder of the new dataset; it must not exist.
    z_step_um : float, optional
        Distance between frames in um, required where neither the files nor their names say it. A negative value means
        that the images were taken downward; their order is reversed.
    pixel_um : float, optional
        Pixel size on the sample in um, over 0, required where the files do not say it.
    pattern : str, optional
        Pattern of the file names with the parts ``{row}``, ``{col}``, ``{k}`` (frame) and ``{e}`` (exposure), as in
        ``r{row}_c{col}_k{k}.tif``: the images form a grid of fields, row 0 at the top. Without ``{k}`` the frames are
        the pages of each file. ``{e}`` separates the exposures of a bracket; their times are not needed. A pattern
        with a slash is matched to the path relative to the given folder, otherwise to the file name. ``{z}`` instead of
        ``{k}`` is the z of a frame in um, ``{n}`` instead of row and column a running number of the fields. Default:
        all images form one field, or one for each position that the files state.
    overlap_fraction : float, default 0.1
        Overlap of neighbouring fields as a fraction of a field, in x and y, from 0 to 0.5.
    progress : callable, optional
        Receives the completed fraction, 0 to 1.
    should_stop : callable, optional
        Returns True if the work should stop.
    numerical_aperture : float, optional
        Numerical aperture of the objective in air, between 0 and 1; see `open_stack`.
    wavelength_um : float, optional
        Wavelength of the light in um, from 0.2 to 2. Default: 0.55 um.
    channel, time, position, only : str, optional
        See `open_stack`; all positions become fields where none is chosen.
    as_listed, overrule : bool, default False
        See `open_stack`.
    columns : int, optional
        Columns of a grid whose fields have running numbers. Default: one row.
    order : {"rows", "columns", "snake-rows", "snake-columns"}, default "rows"
        Along which lines the running numbers go; in a snake every second line runs back.
    corner : {"top-left", "top-right", "bottom-left", "bottom-right"}, default "top-left"
        Where they begin.
    mirror : {"none", "x", "y", "both"}, default "none"
        Axes whose direction is reversed, where a grid comes out mirrored.
    places : str or Path, optional
        Table of the places of the fields: TileConfiguration of Fiji, global positions of MIST, position list of
        Micro-Manager, or CSV whose header names ``file``, ``n``, or ``row`` and ``col``, and ``x_um``, ``y_um`` (stage,
        y up) or ``x_px``, ``y_px`` (mosaic, y down).

    Returns
    -------
    Dataset
        The new dataset, open. It has no calibration, so that its lengths are uncalibrated. It is simulated if any of
        the files says so.

    Raises
    ------
    DatasetError
        With nothing written, for everything that `open_stack` rejects, for an invalid pattern, a file that does not
        match it or two files of the same frame, for an overlap above 50 %, for a target that exists, cannot be written
        to or has not enough space, and when the work is stopped.

    Notes
    -----
    The lowest frame of every field is at z = 0. A frame that other fields have and a field lacks is recorded as
    missing.
    """
    options = ImageOptions(
        z_step_um=z_step_um,
        pixel_um=pixel_um,
        numerical_aperture=numerical_aperture,
        wavelength_um=wavelength_um,
        pattern=pattern,
        channel=channel,
        time=time,
        position=position,
        only=only,
        as_listed=as_listed,
        overrule=overrule,
        columns=columns,
        order=order,
        corner=corner,
        mirror=mirror,
        places=None if places is None else Path(places),
    )
    return dataset_of(srcs, Path(out), options, overlap_fraction, progress, should_stop)


def dataset_of(
    srcs: Paths,
    target: Path,
    options: ImageOptions,
    overlap_fraction: float = OVERLAP_FRACTION,
    progress: Progress | None = None,
    should_stop: ShouldStop | None = None,
    warn: Callable[[str], None] = _say_nothing,
) -> Dataset:
    """Copy images into a new dataset; see `import_dataset`.

    options: values and choices of the user. warn: called with one sentence for each finding in the files.
    """
    wavelength_um = options.wavelength_um
    _depth_um(_given(options.numerical_aperture), wavelength_um, 1.0)
    _require_overlap(overlap_fraction)
    _require_free(target)
    source = read_source(srcs, options)
    for note in source.notes:
        warn(note)
    _require_stacks(source)
    for field in source.fields:
        name = field.name if len(source.fields) > 1 or options.pattern is not None else "the source"
        _require_frames(sum(None not in slot for slot in field.slots), name)
    if not source.order_is_stated:
        _require_supported((plane, plane.read()) for plane in _first_exposure(next(iter(source.fields))))
    first = next(plane for field in source.fields for plane in _planes(field)).read()
    job = _job(source, first, overlap_fraction)
    pixel_um = source.pixel_um.value
    plan = _plan(job, first, pixel_um, _depth_um(source.numerical_aperture, wavelength_um, pixel_um))
    require_space(target.parent, plan.n_frames * first.nbytes, target.name)
    with (
        atomic_write(target) as temporary,
        DatasetWriter.create(
            temporary,
            plan,
            job,
            simulated=source.simulated,
            imported_from=_source_name(srcs) + (f", taken {source.taken}" if source.taken else ""),
            setup=OpticalSetup(objective=source.objective),
            bits=8 * first.dtype.itemsize,
        ) as writer,
    ):
        for note in source.notes:
            writer.fault(note)
        _copy(source.fields, writer, progress, should_stop)
    forget_marks(target)
    sign_scan(target)
    return Dataset.open(target)


def _planes(field: SourceField) -> Iterator[ImagePlane]:
    return (plane for slot in field.slots for plane in slot if plane is not None)


def _first_exposure(field: SourceField) -> Iterator[ImagePlane]:
    return (slot[0] for slot in field.slots if slot[0] is not None)


def _given(value: float | None) -> Stated[float] | None:
    return None if value is None else Stated(value, "given")


@dataclass(slots=True)
class _UniformFormat:
    """Check that all images have the size and depth of the first one."""

    first: Image | None = None
    n_before: int = 0

    def checked(self, picture: ImagePlane) -> Image:
        image = picture.read()
        first = image if self.first is None else self.first
        if _kind(image) != _kind(first):
            before = "the one before it is" if self.n_before == 1 else f"the {self.n_before} before it are"
            raise DatasetError(
                f"Import stopped at {picture.name}: it is {_kind(image)}, {before} {_kind(first)}. {NOTHING_WRITTEN} "
                "Take the file out or import it as a stack of its own."
            )
        self.first, self.n_before = first, self.n_before + 1
        return image


def _read_all(slots: Sequence[ImagePlane | None], progress: Progress | None, should_stop: ShouldStop | None) -> Image:
    """Read the images of the slots; those of empty ones are black."""
    uniform = _UniformFormat()
    first = uniform.checked(next(plane for plane in slots if plane is not None))
    dtype: np.dtype[Any] = first.dtype
    images = np.zeros((len(slots), *first.shape), dtype)
    rest = [(k, plane) for k, plane in enumerate(slots) if plane is not None]
    images[rest[0][0]] = first
    for k, plane in with_progress(rest[1:], len(rest) - 1, "Reading the images", progress, should_stop):
        images[k] = uniform.checked(plane)
    return images


def _copy(
    fields: Iterable[SourceField], writer: DatasetWriter, progress: Progress | None, should_stop: ShouldStop | None
) -> None:
    uniform = _UniformFormat()
    slots = list(_slots(fields, writer.record.plan))
    for shot, field, z_um, plane in with_progress(slots, len(slots), "The import", progress, should_stop):
        if plane is None:
            writer.missed(shot, shot.k, "there was no such image")
        else:
            writer.frame(_frame(shot, field, z_um, plane, uniform.checked(plane)))
    writer.finish()


def _slots(sources: Iterable[SourceField], plan: ScanPlan) -> Iterator[tuple[Shot, Field, float, ImagePlane | None]]:
    for field, source in zip(plan.fields, sources, strict=True):
        for k, slot in enumerate(source.slots):
            z_um = plan.sweep.z_um(field, k) if source.z_um is None else source.z_um[k]
            for exposure, plane in enumerate(slot):
                yield Shot(field.number, k, exposure), field, z_um, plane


def _frame(shot: Shot, field: Field, z_um: float, plane: ImagePlane, image: Image) -> Frame:
    return Frame(
        shot=shot,
        pulse_count=shot.k,
        x_um=field.x_um,
        y_um=field.y_um,
        z_um=z_um,
        exposure_us=plane.exposure_us or UNKNOWN_EXPOSURE_US,
        device_time_us=round(plane.time_us or 0),
        status=FrameStatus.OK,
        image=image,
    )


def _job(source: ImportSource, first: Image, overlap_fraction: float) -> Job:
    slots = source.fields[0].slots
    return Job(
        fields=placed_fields(source, first, overlap_fraction),
        sweep=FocusSweep(z_step_um=source.z_step_um.value, n_frames=len(slots)),
        exposures_us=source.exposures_us or (UNKNOWN_EXPOSURE_US,) * len(slots[0]),
    )


def placed_fields(source: ImportSource, first: Image, overlap_fraction: float) -> tuple[Field, ...]:
    """Return the fields where the files say that they lie, else on a grid by their names, else at 0.

    first: an image, for its size. overlap_fraction: of neighbouring fields, where the files do not say their places.
    """
    pixel_um = source.pixel_um.value
    grid = FieldGrid(
        rows=1,
        cols=1,
        field_width_um=first.shape[1] * pixel_um,
        field_height_um=first.shape[0] * pixel_um,
        overlap_x_fraction=overlap_fraction,
        overlap_y_fraction=overlap_fraction,
    )
    return tuple(_placed(source.fields, grid))


def _placed(fields: Sequence[SourceField], grid: FieldGrid) -> Iterator[Field]:
    cells = [field.cell or (0, n) for n, field in enumerate(fields)]
    top, left = min(row for row, _ in cells), min(col for _, col in cells)
    stated = len(fields) > 1 and all(field.x_um is not None and field.y_um is not None for field in fields)
    if stated:
        cells, top, left = _cells_of_places(fields, grid), 0, 0
    for number, (field, (row, col)) in enumerate(zip(fields, cells, strict=True), 1):
        x_um, y_um = (col - left) * grid.pitch_x_um, -(row - top) * grid.pitch_y_um
        if stated and field.x_um is not None and field.y_um is not None:
            x_um, y_um = field.x_um, field.y_um
        z_start_um = field.z_um[0] if field.z_um is not None else 0.0
        yield Field(number=number, row=row - top, col=col - left, x_um=x_um, y_um=y_um, z_start_um=z_start_um)


def _cells_of_places(fields: Sequence[SourceField], grid: FieldGrid) -> list[tuple[int, int]]:
    """Return row and column of stated places: those closer than half a field are in the same row or column."""
    rows = _ranks([-(field.y_um or 0.0) for field in fields], grid.field_height_um / 2)
    cols = _ranks([field.x_um or 0.0 for field in fields], grid.field_width_um / 2)
    return list(zip(rows, cols, strict=True))


def _ranks(places_um: Sequence[float], apart_um: float) -> list[int]:
    """Return the number of the cluster that each place is in, from the lowest."""
    ordered = np.sort(np.asarray(places_um))
    begins = ordered[np.concatenate(([True], np.diff(ordered) > apart_um))]
    return [int(np.searchsorted(begins, place, "right")) - 1 for place in places_um]


def _plan(job: Job, first: Image, pixel_um: float, depth_um: float) -> ScanPlan:
    return ScanPlan(
        fields=job.fields,
        sweep=job.sweep,
        exposures_us=job.exposures_us,
        strategy=IMPORT,
        legs=(),
        predicted_s=0.0,
        prices=(),
        rows=first.shape[0],
        cols=first.shape[1],
        pixel_um=pixel_um,
        depth_of_field_um=depth_um,
    )


def _depth_um(aperture: Stated[float] | None, wavelength_um: float | None, pixel_um: float) -> float:
    """Return the depth of field in um; 0 if no aperture in air is known."""
    if wavelength_um is not None and not MIN_WAVELENGTH_UM <= wavelength_um <= MAX_WAVELENGTH_UM:
        raise DatasetError(
            f"The wavelength is {wavelength_um:g} um: it must lie from {MIN_WAVELENGTH_UM} to {MAX_WAVELENGTH_UM} um."
        )
    if aperture is None:
        return 0.0
    if not 0 < aperture.value < 1:
        if aperture.source != "given":  # of immersion, or no aperture: nothing is derived from it
            return 0.0
        raise DatasetError(
            f"The numerical aperture is {aperture.value:g}: in air it lies between 0 and 1, as in 10x/0.28."
        )
    return depth_of_field_um(aperture.value, pixel_um, wavelength_um or WAVELENGTH_UM)


def _require_overlap(fraction: float) -> None:
    if not 0 <= fraction <= MAX_OVERLAP:
        raise DatasetError(f"The overlap is {fraction:.0%} of a field: it must be between 0 % and {MAX_OVERLAP:.0%}.")


def _require_free(target: Path) -> None:
    if target.exists():
        raise DatasetError(f"{target} exists already. {NOTHING_WRITTEN} Choose another name.")


ONE_IMAGE = "each field has one image, and heights need a stack: make one picture of them with stitch-images."


def _require_stacks(source: ImportSource) -> None:
    if source.is_tiled:
        raise DatasetError(f"Import stopped: {ONE_IMAGE} {NOTHING_WRITTEN}")


def _require_frames(n_frames: int, source: str) -> None:
    if n_frames < MIN_FRAMES:
        raise DatasetError(
            f"Import stopped: {source} has {n_frames} frames and at least {MIN_FRAMES} are needed to find a focus peak."
            f" {NOTHING_WRITTEN} Give the whole stack."
        )


def _kind(image: Image) -> str:
    return f"{image.shape[1]} x {image.shape[0]} px, {8 * image.dtype.itemsize} bit"


def _source_name(src: Paths) -> str:
    return Path(src).name if isinstance(src, str | Path) else ", ".join(Path(one).name for one in src)
