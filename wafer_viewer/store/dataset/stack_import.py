"""Import of external stacks: opened for one reconstruction, or imported as a dataset.

The only acquisition metadata are those given by the user, so the stacks have no calibration and their lengths are
uncalibrated. A file that says that it is simulated makes its stack and its dataset simulated.
"""

from __future__ import annotations

import hashlib
import re
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from wafer_viewer.model.acquisition.calibration import WAVELENGTH_UM, depth_of_field_um
from wafer_viewer.model.acquisition.focus_stack import FieldStack, Frame, FrameStatus, Image
from wafer_viewer.model.acquisition.plan import MIN_FRAMES, Field, FieldGrid, FocusSweep, ScanPlan, Shot
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.job import Job
from wafer_viewer.model.progress import Progress, ShouldStop, with_progress
from wafer_viewer.store.dataset.dataset import Dataset
from wafer_viewer.store.dataset.image_files import (
    NOTHING_WRITTEN,
    READERS,
    ImageFile,
    Paths,
    image_files,
    pictures,
    pictures_of,
)
from wafer_viewer.store.dataset.writer import DatasetWriter
from wafer_viewer.store.io.atomic_files import atomic_write, require_space
from wafer_viewer.store.records.manifest import forget_marks, sign_scan

Cell = tuple[int, int]
"""(row, col) as numbered in the files."""
Slot = tuple[ImageFile | None, ...]
"""Images taken at one z: one per exposure, None where it is missing."""
_PARTS = {"row", "col", "k", "e"}


def stacks_by_cell(src: Paths, pattern: str | None) -> dict[Cell, list[Slot]]:
    """Return the slots of each field in order of k, all with the same number of exposures in numerical order.

    Without a pattern all images form one field with one exposure; a pattern without ``{k}`` uses the pages of each
    file. A pattern with a slash is matched to the path relative to the given folder, otherwise to the file name.

    Raises
    ------
    DatasetError
        If a file does not match the pattern, or two files are the same frame.
    """
    if pattern is None:
        return {(0, 0): [(picture,) for picture in pictures(src)]}
    expression = compile_pattern(pattern)
    stacks: dict[Cell, dict[tuple[int, int], ImageFile]] = {}
    for path, name in _named_files(src, "/" in pattern):
        cell, frames = _frames_of(path, name, expression, pattern)
        stack = stacks.setdefault(cell, {})
        if twice := stack.keys() & frames.keys():
            why = f"frame {min(twice)[0]} of row {cell[0]}, column {cell[1]} is there twice"
            raise DatasetError(_stopped(name, why, "Take one out."))
        stack |= frames
    ks, es = (sorted({key[i] for stack in stacks.values() for key in stack}) for i in (0, 1))
    return {cell: [tuple(stacks[cell].get((k, e)) for e in es) for k in ks] for cell in sorted(stacks)}


def compile_pattern(pattern: str) -> re.Pattern[str]:
    """Return the pattern as a regular expression with a named group for each part.

    The parts are row, col, k and e; a single field with several exposures needs neither row nor col.

    Raises
    ------
    DatasetError
        If the pattern does not identify the field of a file, or has unknown or repeated parts.
    """
    parts = re.split(r"\{(\w+)\}", pattern)
    names = parts[1::2]
    distinguishable = {"row", "col"} <= set(names) or ("e" in names and not {"row", "col"} & set(names))
    if not distinguishable or not set(names) <= _PARTS or len(names) != len(set(names)):
        raise DatasetError(
            f"The pattern {pattern!r} does not say which field a file is: it needs {{row}} and {{col}}, "
            "{k} where each frame is a file, and {e} where each z was taken in several exposures, once each, "
            "as in 'r{row}_c{col}_k{k}.tif'."
        )
    pieces = [rf"(?P<{part}>\d+)" if i % 2 else re.escape(part) for i, part in enumerate(parts)]
    return re.compile("".join(pieces), re.IGNORECASE)


def _named_files(src: Paths, deep: bool) -> list[tuple[Path, str]]:
    """Return the files, each with the name that is matched to the pattern."""
    folders = [Path(one) for one in ([src] if isinstance(src, str | Path) else src)]
    if not deep:
        return [(path, path.name) for path in image_files(src)]
    below = [(p, folder) for folder in folders for p in sorted(folder.rglob("*")) if p.suffix.lower() in READERS]
    if not below:
        mend = "Give the folder that the pattern starts from."
        raise DatasetError(_stopped(str(folders[0]), "the folder holds no images", mend))
    return [(path, path.relative_to(folder).as_posix()) for path, folder in below]


def _frames_of(
    path: Path, name: str, expression: re.Pattern[str], pattern: str
) -> tuple[Cell, dict[tuple[int, int], ImageFile]]:
    """Return the field of a file, and its images by (k, exposure)."""
    match = expression.fullmatch(name)
    if match is None:
        why = f"its name does not fit the pattern {pattern!r}"
        raise DatasetError(_stopped(name, why, "Take the file out or change the pattern."))
    numbers, pages = {part: int(digits) for part, digits in match.groupdict().items()}, pictures_of(path)
    cell, exposure = (numbers.get("row", 0), numbers.get("col", 0)), numbers.get("e", 0)
    if "k" not in numbers:
        return cell, {(k, exposure): picture for k, picture in enumerate(pages)}
    if len(pages) > 1:
        why = f"it has {len(pages)} pages and the pattern says one frame a file"
        raise DatasetError(_stopped(name, why, "Leave out {k}."))
    return cell, {(numbers["k"], exposure): pages[0]}


def _stopped(name: str, why: str, mend: str) -> str:
    return f"Import stopped at {name}: {why}. {NOTHING_WRITTEN} {mend}"


UNKNOWN_EXPOSURE_US = 1.0
"""Placeholder exposure time in us for images without one.

It is the same for all exposures of a bracket, so that their ratio carries no information: fusion then measures the
brightness ratio and never uses an invented one.
"""
MAX_OVERLAP = 0.5
MIN_WAVELENGTH_UM, MAX_WAVELENGTH_UM = 0.2, 2.0
Stacks = dict[Cell, list[Slot]]
P = TypeVar("P", ImageFile, Slot)


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
) -> FieldStack:
    """Read a folder of images, a multi-page TIFF or a list of files.

    The images are read into memory as one field, lowest frame first.

    Parameters
    ----------
    src : str, Path or sequence of them
        Folder of images, image file (with all pages of a multi-page TIFF), or several of them. Files are sorted in
        natural order: 2 before 10.
    z_step_um : float
        Distance between frames in um, required. A negative value means that the images were taken downward; their
        order is reversed.
    pixel_um : float
        Pixel size on the sample in um, required, over 0.
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

    Returns
    -------
    FieldStack
        Images [k, row, col], uint8 or uint16, with z in um, rising; the field has number 1 and its centre at (0, 0).
        It has no calibration, so that its lengths are uncalibrated. It is simulated if any of the files says so.

    Raises
    ------
    DatasetError
        When the step or the pixel size is missing or invalid, the aperture or the wavelength is out of range, a path
        does not exist or is no image, fewer than three images are found, an image is damaged, is neither 8 nor 16 bits,
        or differs in size or depth from those before it, or the work is stopped.

    Notes
    -----
    Colour is converted to luminance with the weights of ITU-R BT.709 [1]_ on the stored values; 8 and 16 bits are
    preserved. The depth of field is wavelength / NA^2 + pixel size / NA.

    References
    ----------
    .. [1] Recommendation ITU-R BT.709, Parameter values for the HDTV standards for production and international
       programme exchange.
    """
    step_um, pixel = _required(z_step_um, pixel_um)
    images_in_z = _in_ascending_z(pictures(src), step_um)
    _require_frames(len(images_in_z), "the source")
    images = _read_all(images_in_z, progress, should_stop)
    return FieldStack(
        field=Field(number=1, row=0, col=0, x_um=0.0, y_um=0.0, z_start_um=z_start_um),
        images=images,
        z_um=z_start_um + abs(step_um) * np.arange(len(images_in_z), dtype=np.float64),
        present=np.ones(len(images_in_z), bool),
        pixel_um=pixel,
        checksum=hashlib.sha256(b"".join(b"%08x" % zlib.crc32(image.data) for image in images)).hexdigest(),
        source=_source_name(src),
        simulated=any(picture.simulated for picture in images_in_z),
        depth_of_field_um=_depth_um(numerical_aperture, wavelength_um, pixel),
    )


def import_dataset(
    srcs: Paths,
    out: str | Path,
    z_step_um: float | None = None,
    pixel_um: float | None = None,
    pattern: str | None = None,
    overlap_fraction: float = 0.1,
    progress: Progress | None = None,
    should_stop: ShouldStop | None = None,
    *,
    numerical_aperture: float | None = None,
    wavelength_um: float | None = None,
) -> Dataset:
    """Copy images into a new dataset of one or more fields.

    The dataset appears only once it is complete.

    Parameters
    ----------
    srcs : str, Path or sequence of them
        Folder of images, image file (with all pages of a multi-page TIFF), or several of them.
    out : str or Path
        Folder of the new dataset; it must not exist.
    z_step_um : float
        Distance between frames in um, required. A negative value means that the images were taken downward; their
        order is reversed.
    pixel_um : float
        Pixel size on the sample in um, required, over 0.
    pattern : str, optional
        Pattern of the file names with the parts ``{row}``, ``{col}``, ``{k}`` (frame) and ``{e}`` (exposure), as in
        ``r{row}_c{col}_k{k}.tif``: the images form a grid of fields, row 0 at the top. Without ``{k}`` the frames are
        the pages of each file. ``{e}`` separates the exposures of a bracket; their times are not needed. A pattern
        with a slash is matched to the path relative to the given folder, otherwise to the file name. Default: all
        images form one field.
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
    target = Path(out)
    step_um, pixel = _required(z_step_um, pixel_um)
    depth_um = _depth_um(numerical_aperture, wavelength_um, pixel)
    _require_overlap(overlap_fraction)
    _require_free(target)
    stacks = {cell: _in_ascending_z(stack, step_um) for cell, stack in stacks_by_cell(srcs, pattern).items()}
    for cell, stack in stacks.items():
        source = "the source" if pattern is None else f"the field in row {cell[0]}, column {cell[1]}"
        _require_frames(sum(None not in slot for slot in stack), source)
    first = next(p for stack in stacks.values() for slot in stack for p in slot if p is not None).read()
    job = _job(stacks, first, abs(step_um), pixel, overlap_fraction)
    plan = _plan(job, first, pixel, depth_um)
    require_space(target.parent, plan.n_frames * first.nbytes, target.name)
    with atomic_write(target) as temporary:
        bits = 8 * first.dtype.itemsize
        source, simulated = _source_name(srcs), _is_simulated(stacks)
        with DatasetWriter.create(temporary, plan, job, simulated=simulated, imported_from=source, bits=bits) as writer:
            _copy(stacks, writer, progress, should_stop)
    forget_marks(target)
    sign_scan(target)
    return Dataset.open(target)


@dataclass(slots=True)
class _UniformFormat:
    """Check that all images have the size and depth of the first one."""

    first: Image | None = None
    n_before: int = 0

    def checked(self, picture: ImageFile) -> Image:
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


def _read_all(pictures: list[ImageFile], progress: Progress | None, should_stop: ShouldStop | None) -> Image:
    uniform = _UniformFormat()
    first = uniform.checked(pictures[0])
    dtype: np.dtype[Any] = first.dtype
    images = np.empty((len(pictures), *first.shape), dtype)
    images[0] = first
    for k, picture in enumerate(
        with_progress(pictures[1:], len(pictures) - 1, "Reading the images", progress, should_stop), 1
    ):
        images[k] = uniform.checked(picture)
    return images


def _copy(stacks: Stacks, writer: DatasetWriter, progress: Progress | None, should_stop: ShouldStop | None) -> None:
    uniform = _UniformFormat()
    slots = list(_slots(stacks, writer.record.plan))
    for shot, field, picture in with_progress(slots, len(slots), "The import", progress, should_stop):
        if picture is None:
            writer.missed(shot, shot.k, "there was no such image")
        else:
            writer.frame(_frame(shot, field, writer.record.plan.sweep, uniform.checked(picture)))
    writer.finish()


def _is_simulated(stacks: Stacks) -> bool:
    """Return whether any image was not taken of a real sample."""
    images = (image for stack in stacks.values() for slot in stack for image in slot)
    return any(image is not None and image.simulated for image in images)


def _slots(stacks: Stacks, plan: ScanPlan) -> Iterator[tuple[Shot, Field, ImageFile | None]]:
    for field, stack in zip(plan.fields, stacks.values(), strict=True):
        for k, slot in enumerate(stack):
            for exposure, picture in enumerate(slot):
                yield Shot(field.number, k, exposure), field, picture


def _frame(shot: Shot, field: Field, sweep: FocusSweep, image: Image) -> Frame:
    return Frame(
        shot=shot,
        pulse_count=shot.k,
        x_um=field.x_um,
        y_um=field.y_um,
        z_um=sweep.z_um(field, shot.k),
        exposure_us=UNKNOWN_EXPOSURE_US,
        device_time_us=0,
        status=FrameStatus.OK,
        image=image,
    )


def _job(stacks: Stacks, first: Image, z_step_um: float, pixel_um: float, overlap_fraction: float) -> Job:
    grid = FieldGrid(
        rows=1,
        cols=1,
        field_width_um=first.shape[1] * pixel_um,
        field_height_um=first.shape[0] * pixel_um,
        overlap_x_fraction=overlap_fraction,
        overlap_y_fraction=overlap_fraction,
    )
    one = next(iter(stacks.values()))
    return Job(
        fields=tuple(_fields(sorted(stacks), grid)),
        sweep=FocusSweep(z_step_um=z_step_um, n_frames=len(one)),
        exposures_us=(UNKNOWN_EXPOSURE_US,) * len(one[0]),
    )


def _fields(cells: list[Cell], grid: FieldGrid) -> Iterator[Field]:
    """Yield a field for each cell; rows and columns are counted from 0, independent of the file numbers."""
    top, left = min(row for row, _ in cells), min(col for _, col in cells)
    for number, (row, col) in enumerate(cells, 1):
        x_um, y_um = (col - left) * grid.pitch_x_um, -(row - top) * grid.pitch_y_um
        yield Field(number=number, row=row - top, col=col - left, x_um=x_um, y_um=y_um, z_start_um=0.0)


def _plan(job: Job, first: Image, pixel_um: float, depth_um: float) -> ScanPlan:
    return ScanPlan(
        fields=job.fields,
        sweep=job.sweep,
        exposures_us=job.exposures_us,
        strategy="import",
        legs=(),
        predicted_s=0.0,
        prices=(),
        rows=first.shape[0],
        cols=first.shape[1],
        pixel_um=pixel_um,
        depth_of_field_um=depth_um,
    )


def _in_ascending_z(stack: list[P], z_step_um: float) -> list[P]:
    return stack[::-1] if z_step_um < 0 else stack


def _required(z_step_um: float | None, pixel_um: float | None) -> tuple[float, float]:
    if z_step_um is None:
        raise DatasetError("The z step is missing: give it with --z-step-um, the images do not say it.")
    if pixel_um is None:
        raise DatasetError("The pixel size is missing: give it with --pixel-um, the images do not say it.")
    if z_step_um == 0 or not np.isfinite(z_step_um):
        raise DatasetError(
            f"The z step is {z_step_um:g} um: give the distance between frames, under 0 if taken downward."
        )
    if not 0 < pixel_um < np.inf:
        raise DatasetError(f"The pixel size is {pixel_um:g} um: it must be over 0.")
    return z_step_um, pixel_um


def _depth_um(numerical_aperture: float | None, wavelength_um: float | None, pixel_um: float) -> float:
    """Return the depth of field in um; 0 if no aperture is given."""
    if wavelength_um is not None and not MIN_WAVELENGTH_UM <= wavelength_um <= MAX_WAVELENGTH_UM:
        raise DatasetError(
            f"The wavelength is {wavelength_um:g} um: it must lie from {MIN_WAVELENGTH_UM} to {MAX_WAVELENGTH_UM} um."
        )
    if numerical_aperture is None:
        return 0.0
    if not 0 < numerical_aperture < 1:
        raise DatasetError(
            f"The numerical aperture is {numerical_aperture:g}: in air it lies between 0 and 1, as in 10x/0.28."
        )
    return depth_of_field_um(numerical_aperture, pixel_um, wavelength_um or WAVELENGTH_UM)


def _require_overlap(fraction: float) -> None:
    if not 0 <= fraction <= MAX_OVERLAP:
        raise DatasetError(f"The overlap is {fraction:.0%} of a field: it must be between 0 % and {MAX_OVERLAP:.0%}.")


def _require_free(target: Path) -> None:
    if target.exists():
        raise DatasetError(f"{target} exists already. {NOTHING_WRITTEN} Choose another name.")


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
