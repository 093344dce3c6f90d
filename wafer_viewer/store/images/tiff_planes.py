"""Planes of TIFF files with what they say of themselves: OME, ImageJ, Micro-Manager, Zeiss LSM, MetaMorph STK, plain.

The axes are those of tifffile's series; the lengths are read from the words of each program. A file without such words
is a stack of its pages.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.focus_stack import Image
from wafer_viewer.model.acquisition.image_source import ImagePlane, Stated, Statements
from wafer_viewer.model.errors import DatasetError, parser_errors_as
from wafer_viewer.store.images.image_files import (
    NOTHING_WRITTEN,
    as_grey,
    damaged,
    read_page,
    require_planes,
    states_simulated,
)
from wafer_viewer.store.images.image_series import (
    TIMES_US,
    UNITS_UM,
    ImageAxes,
    Place,
    Series,
    length_um,
    plane_at,
    stated_number,
)
from wafer_viewer.store.io.guarded_reading import opened_tiff, require_pixels, tiff_page

if TYPE_CHECKING:
    from tifffile import TiffFile, TiffPageSeries

_MICRO_MANAGER = 51123
"""TIFF tag of Micro-Manager with the words on each page, as JSON."""


def planes_of_tiff(path: Path) -> tuple[ImagePlane, ...]:
    """Return the planes of a TIFF file in its own order; a plane that the file announces and lacks is left out.

    Raises DatasetError when the file is damaged, or has more pages than the limit.
    """
    with parser_errors_as(partial(damaged, path.name)), opened_tiff(path) as file:
        require_planes(path.name, len(file.pages))
        if not len(file.pages):
            return ()
        by_imagej = str((file.imagej_metadata or {}).get("Info", ""))
        simulated = states_simulated(f"{file.pages.first.description}\n{by_imagej}")
        planes = tuple(replace(plane, simulated=simulated) for plane in _planes(path, file))
        is_float = file.pages.first.dtype is not None and file.pages.first.dtype.kind == "f"
    return _scaled(planes) if is_float and len(planes) > 1 else planes


class _FloatScale:
    """Linear scale of floating-point planes to 16 bits, the same for all planes of a file; found when it is asked."""

    def __init__(self, planes: Sequence[ImagePlane]) -> None:
        self._planes = planes

    @cached_property
    def span(self) -> tuple[float, float]:
        """Least and greatest value of all planes. Raises DatasetError when a plane holds no number."""
        low, high = math.inf, -math.inf
        for plane in self._planes:
            values = _float_values(plane)
            finite = values[np.isfinite(values)]
            if not finite.size:
                raise DatasetError(
                    f"Import stopped at {plane.name}: it holds no number. {NOTHING_WRITTEN} Export it again."
                )
            low, high = min(low, float(finite.min())), max(high, float(finite.max()))
        return low, high

    def read(self, plane: ImagePlane) -> Image:
        """Return a plane as 16 bits; what is no number is 0."""
        low, high = self.span
        share = (np.nan_to_num(_float_values(plane), nan=low) - low) / max(high - low, 1e-30)
        return np.rint(share.clip(0, 1) * 65535).astype(np.uint16)


def _scaled(planes: tuple[ImagePlane, ...]) -> tuple[ImagePlane, ...]:
    """Return planes of floating-point values that are read as 16 bits."""
    scale = _FloatScale(planes)
    note = f"The floating-point values of {planes[0].path.name} were scaled to 16 bits, all planes alike."
    says = replace(planes[0].says, notes=(*planes[0].says.notes, note))
    return tuple(replace(plane, says=says, read=partial(scale.read, plane)) for plane in planes)


def _float_values(plane: ImagePlane) -> NDArray[np.float64]:
    with parser_errors_as(partial(damaged, plane.name)), opened_tiff(plane.path) as file:
        page = tiff_page(file, plane.page, plane.name)
        if page.samplesperpixel != 1:
            raise DatasetError(
                f"Import stopped at {plane.name}: it has {page.samplesperpixel} floating-point values a pixel. "
                f"{NOTHING_WRITTEN} Save it as a grey image."
            )
        return np.asarray(page.asarray(), np.float64)


def _planes(path: Path, file: TiffFile) -> Iterator[ImagePlane]:
    if _page_words(file, 0):
        yield from _of_micro_manager(path, file)
        return
    series = _worded_series(file)
    if series is None:
        yield from _of_pages(path, file)
        return
    several = len(series) > 1
    for number, (one, words) in enumerate(series):
        position = words.position if several and words.position else f"position {number}" if several else ""
        yield from _of_series(path, file, number, one, replace(words, position=position))


def _worded_series(file: TiffFile) -> list[tuple[TiffPageSeries, Series]] | None:
    """Return the series of a file whose program says what their axes are, else None."""
    if file.is_ome and (words := _ome_words(file)) is not None:
        return list(zip(file.series, words, strict=False)) if len(words) == len(file.series) else None
    if file.is_imagej:
        return [(file.series[0], Series(_imagej_statements(file)))]
    if file.is_lsm:
        return [(file.series[0], Series(_lsm_statements(file)))]
    if file.is_stk:
        return [(file.series[0], Series(_stk_statements(file)))]
    if file.is_shaped and len(file.series) == 1 and set(file.series[0].axes) & {"Z", "C", "T"}:
        return [(file.series[0], Series(Statements()))]
    return None


def _of_pages(path: Path, file: TiffFile) -> Iterator[ImagePlane]:
    """Yield the pages of a file of which nothing is said, as planes along z."""
    for page in range(len(file.pages)):
        yield _plane(path, page, len(file.pages), Place(k=page), Series(Statements()))


def _of_series(path: Path, file: TiffFile, number: int, series: TiffPageSeries, words: Series) -> Iterator[ImagePlane]:
    """Yield the planes of one series; of exposures the channel is no axis."""
    axes = ImageAxes({axis: size for axis, size in zip(series.axes, series.shape, strict=True) if axis not in "YXS"})
    n_planes = math.prod(axes.sizes.values())
    pages = list(series.pages)
    contiguous = len(pages) != n_planes
    if contiguous and series.dataoffset is None:
        raise ValueError("its pages do not fit its axes")
    for plane, (_, place) in enumerate(axes.places()):
        if contiguous:
            read = partial(_read_contiguous, path, number, plane, n_planes)
            yield _plane(path, plane, n_planes, place, words, axes.several, read)
        elif (page := pages[plane]) is not None:
            source = Path(page.parent.filehandle.path)
            yield _plane(source, page.index, len(page.parent.pages), place, words, axes.several)


def _plane(
    path: Path,
    page: int,
    n_pages: int,
    place: Place,
    words: Series,
    several: frozenset[str] = frozenset(),
    read: Callable[[], Image] | None = None,
) -> ImagePlane:
    name = path.name if n_pages == 1 else f"{path.name}, page {page + 1}"
    return plane_at(place, words, several, name, path, page, read or partial(read_page, path, page, name))


def _read_contiguous(path: Path, series: int, plane: int, n_planes: int) -> Image:
    """Read a plane of a file that keeps all planes behind one page: MetaMorph STK and large files of ImageJ."""
    name = f"{path.name}, plane {plane + 1}"
    with parser_errors_as(partial(damaged, name)), opened_tiff(path) as file:
        one = file.series[series]
        rows, cols = one.keyframe.imagelength, one.keyframe.imagewidth
        require_pixels(name, rows, cols)
        size = rows * cols * one.keyframe.samplesperpixel
        begin = (one.dataoffset or 0) + plane * size * one.dtype.itemsize
        file.filehandle.seek(begin)
        content = file.filehandle.read(size * one.dtype.itemsize)
        values: NDArray[Any] = np.frombuffer(content, one.dtype.newbyteorder(file.byteorder), size)
        return as_grey(values.reshape(one.keyframe.shape), name)


def _stated(value: float | None, source: str) -> Stated[float] | None:
    return None if value is None else Stated(value, source)


# --- OME


def _ome_words(file: TiffFile) -> list[Series] | None:
    """Return what the OME-XML says of each image; None if it is no OME-XML."""
    text = file.ome_metadata or ""
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        return None
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError:
        return None
    ours = root.get("Creator", "").startswith("Wafer Viewer")
    objectives = {one.get("ID", ""): one for one in root.iterfind(".//{*}Objective")}
    words: list[Series] = []
    for image in root.iterfind("{*}Image"):
        pixels = image.find("{*}Pixels")
        if pixels is None:
            return None
        settings = image.find("{*}ObjectiveSettings")
        objective = objectives.get(settings.get("ID", "") if settings is not None else "")
        if objective is None and len(objectives) == 1:
            objective = next(iter(objectives.values()))
        channels = [channel.get("Name") or f"channel {n}" for n, channel in enumerate(pixels.iterfind("{*}Channel"))]
        words.append(
            Series(
                _ome_statements(image, pixels, objective),
                image.get("Name", ""),
                channels,
                partial(_own_of_ome, dict(_ome_planes(image, pixels))),
                exposures=ours,
            )
        )
    return words or None


def _ome_statements(
    image: ElementTree.Element, pixels: ElementTree.Element, objective: ElementTree.Element | None
) -> Statements:
    def size(axis: str) -> Stated[float] | None:
        unit = pixels.get(f"PhysicalSize{axis}Unit", "µm")
        return _stated(length_um(pixels.get(f"PhysicalSize{axis}"), unit), f"OME PhysicalSize{axis}")

    aperture = None if objective is None else objective.get("LensNA")
    model = "" if objective is None else objective.get("Model") or ""
    taken = image.findtext("{*}AcquisitionDate") or ""
    return Statements(
        pixel_um=size("X"),
        pixel_y_um=size("Y"),
        z_step_um=size("Z"),
        numerical_aperture=_stated(stated_number(aperture), "OME LensNA"),
        objective=Stated(model, "OME Objective") if model else None,
        taken=Stated(taken, "OME AcquisitionDate") if taken else None,
    )


def _ome_planes(
    image: ElementTree.Element, pixels: ElementTree.Element
) -> Iterator[tuple[tuple[int, int, int], dict[str, float]]]:
    label = image.find("{*}StageLabel")
    common = {} if label is None else _ome_place(label, "{}", "z_um")
    for plane in pixels.iterfind("{*}Plane"):
        own = common | _ome_place(plane, "Position{}")
        for name, attribute in (("exposure_us", "ExposureTime"), ("time_us", "DeltaT")):
            unit, value = TIMES_US.get(plane.get(f"{attribute}Unit", "s")), stated_number(plane.get(attribute))
            if unit is not None and value is not None:
                own[name] = value * unit
        yield (int(plane.get("TheZ", 0)), int(plane.get("TheC", 0)), int(plane.get("TheT", 0))), own


def _own_of_ome(by_place: Mapping[tuple[int, int, int], dict[str, float]], place: Place) -> dict[str, float]:
    return by_place.get((place.k, place.channel, place.time), {})


def _ome_place(element: ElementTree.Element, name: str, without: str = "") -> dict[str, float]:
    """Return the place that the attributes of an element state; 0 is a place."""
    found: dict[str, float] = {}
    for axis in "XYZ":
        attribute = name.format(axis)
        factor = UNITS_UM.get(element.get(f"{attribute}Unit", "µm"))
        number = stated_number(element.get(attribute))
        if factor is not None and number is not None and f"{axis.lower()}_um" != without:
            found[f"{axis.lower()}_um"] = number * factor
    return found


# --- ImageJ, LSM, STK


def _imagej_statements(file: TiffFile) -> Statements:
    words = file.imagej_metadata or {}
    unit = words.get("unit", "")
    tags = file.pages.first.tags
    along_x, along_y = (_imagej_pixel_um(tags.get(name), unit) for name in ("XResolution", "YResolution"))
    return Statements(
        pixel_um=_stated(along_x, "ImageJ resolution"),
        pixel_y_um=_stated(along_y, "ImageJ resolution"),
        z_step_um=_stated(length_um(words.get("spacing"), unit), "ImageJ spacing"),
    )


def _imagej_pixel_um(tag: Any, unit: str) -> float | None:
    """Return a pixel of a resolution in pixels a unit."""
    if tag is None:
        return None
    count, length = tag.value
    return length_um(length / count, unit) if count else None


def _lsm_statements(file: TiffFile) -> Statements:
    words = file.lsm_metadata or {}
    x, y, z = (length_um(words.get(f"VoxelSize{axis}"), "m") for axis in "XYZ")
    return Statements(
        pixel_um=_stated(x, "LSM VoxelSizeX"),
        pixel_y_um=_stated(y, "LSM VoxelSizeY"),
        z_step_um=_stated(z, "LSM VoxelSizeZ"),
    )


def _stk_statements(file: TiffFile) -> Statements:
    words = file.stk_metadata or {}
    unit = str(words.get("CalibrationUnits", ""))
    x, y = (length_um(words.get(f"{axis}Calibration"), unit) for axis in "XY")
    steps = np.ravel(np.asarray(words.get("ZDistance", ()), np.float64))
    step = float(steps[0]) if len(steps) and np.ptp(steps) == 0 and steps[0] != 0 else None
    return Statements(
        pixel_um=_stated(x, "STK XCalibration"),
        pixel_y_um=_stated(y, "STK YCalibration"),
        z_step_um=_stated(step, "STK ZDistance"),
    )


# --- Micro-Manager


def _page_words(file: TiffFile, page: int) -> dict[str, Any]:
    tag = file.pages[page].aspage().tags.get(_MICRO_MANAGER)
    if tag is None:
        return {}
    words = json.loads(tag.value) if isinstance(tag.value, str | bytes) else tag.value
    return words if isinstance(words, dict) else {}


def _of_micro_manager(path: Path, file: TiffFile) -> Iterator[ImagePlane]:
    summary = (file.micromanager_metadata or {}).get("Summary", {}) if file.is_micromanager else {}
    words = [_page_words(file, page) for page in range(len(file.pages))]
    axes = ("Position", "Channel", "Frame", "Slice")
    places = [tuple(_index(own, axis) for axis in axes) for own in words]
    names = [str(_first(own, "PositionName", default="")) for own in words]
    n_positions, n_channels, n_times, n_slices = (len({at[n] for at in places}) for n in range(4))
    step = stated_number(_first(summary, "z-step_um", default=None)) if n_slices > 1 else None
    for page, (own, at) in enumerate(zip(words, places, strict=True)):
        pixel = stated_number(_first(own, "PixelSizeUm", "PixelSize_um", default=summary.get("PixelSize_um")))
        says = Statements(
            pixel_um=_stated(pixel or None, "Micro-Manager PixelSizeUm"),
            z_step_um=_stated(step or None, "Micro-Manager z-step_um"),
        )
        exposure_ms, elapsed_ms = (stated_number(own.get(name)) for name in ("Exposure-ms", "ElapsedTime-ms"))
        name = path.name if len(words) == 1 else f"{path.name}, page {page + 1}"
        yield ImagePlane(
            name=name,
            path=path,
            page=page,
            read=partial(read_page, path, page, name),
            position=names[page] or (f"position {at[0]}" if n_positions > 1 else ""),
            channel=str(_first(own, "Channel", default=f"channel {at[1]}")) if n_channels > 1 else "",
            time=f"time {at[2]}" if n_times > 1 else "",
            k=at[3],
            z_um=stated_number(_first(own, "ZPositionUm", default=None)),
            x_um=stated_number(_first(own, "XPositionUm", default=None)),
            y_um=stated_number(_first(own, "YPositionUm", default=None)),
            exposure_us=None if exposure_ms is None else 1e3 * exposure_ms,
            time_us=None if elapsed_ms is None else 1e3 * elapsed_ms,
            says=says,
        )


def _index(words: Mapping[str, Any], axis: str) -> int:
    """Return the number of a page on an axis: PositionIndex, or Slice as older versions write it."""
    number = _first(words, f"{axis}Index", axis, default=0)
    return number if isinstance(number, int) else 0


def _first(words: Mapping[str, Any], *names: str, default: Any) -> Any:
    """Return the first of several spellings that is there."""
    return next((words[name] for name in names if words.get(name) is not None), default)
