"""Planes of folders that are one image: OME-Zarr and NDTiff."""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.focus_stack import Image
from wafer_viewer.model.acquisition.image_source import ImagePlane, Stated, Statements
from wafer_viewer.model.errors import DatasetError, parser_errors_as
from wafer_viewer.store.images.image_files import NOTHING_WRITTEN, as_grey, damaged, require_planes, states_simulated
from wafer_viewer.store.images.image_series import UNITS_UM, Place, Series, Where, planes_in, stated_number
from wafer_viewer.store.io.guarded_reading import MEND, MOST_PIXELS, limit, read_content, require_pixels

# --- OME-Zarr 0.4 and 0.5


def planes_of_zarr(path: Path) -> tuple[ImagePlane, ...]:
    """Return the planes of an OME-Zarr folder; the images of a collection or of a plate are positions.

    Raises DatasetError when it holds no image, or is damaged.
    """
    import zarr

    planes: list[ImagePlane] = []
    with parser_errors_as(partial(damaged, path.name)):
        root = zarr.open_group(str(path), mode="r")
        paths = tuple(_zarr_images(root))
        text = json.dumps(dict(root.attrs)) + _zarr_header(path)
        for name in paths:
            group = root[name] if name else root
            planes += _planes_of_multiscale(path, name, group, len(paths) > 1, len(planes), text)
    return tuple(planes)


def _zarr_header(path: Path) -> str:
    """Return the OME-XML that some programs keep beside the images, else nothing."""
    header = path / "OME" / "METADATA.ome.xml"
    return read_content(header).decode("utf-8", "replace") if header.is_file() else ""


def _ome(group: Any) -> dict[str, Any]:
    """Return the OME attributes of a group: under a key since 0.5, among all others before."""
    attributes = dict(group.attrs)
    return attributes.get("ome", attributes)


def _zarr_images(root: Any) -> Iterator[str]:
    """Yield the paths of the images below a group. Raises DatasetError when there are none."""
    about = _ome(root)
    if "multiscales" in about:
        yield ""
    elif "plate" in about:
        for well in about["plate"]["wells"]:
            for image in _ome(root[well["path"]])["well"]["images"]:
                yield f"{well['path']}/{image['path']}"
    else:
        listed = _ome(root["OME"]).get("series") if "OME" in root else None
        names = listed or sorted((name for name in root.group_keys() if name.isdigit()), key=int)
        if not names:
            raise DatasetError(
                f"Import stopped at {Path(str(root.store_path.store)).name}: it is a Zarr folder without OME images. "
                f"{NOTHING_WRITTEN} Give the folder of an OME-Zarr image."
            )
        yield from names


def _planes_of_multiscale(
    path: Path, name: str, group: Any, several: bool, first: int, text: str
) -> Iterator[ImagePlane]:
    about = _ome(group)
    scales = about["multiscales"][0]
    array = group[scales["datasets"][0]["path"]]
    axes = [str(axis["name"] if isinstance(axis, dict) else axis).upper() for axis in scales["axes"]]
    if axes[-2:] != ["Y", "X"]:
        raise DatasetError(f"Import stopped at {path.name}: its axes are {', '.join(axes)}. {NOTHING_WRITTEN}")
    require_pixels(path.name, *array.shape[-2:])
    if math.prod(array.chunks) > limit(_MOST_CHUNKS * MOST_PIXELS):
        raise DatasetError(f"{path.name} states chunks of {math.prod(array.chunks)} pixels: {MEND}.")
    sizes = dict(zip(axes[:-2], array.shape, strict=False))
    channels = about.get("omero", {}).get("channels", [])
    lengths = _zarr_lengths(axes, scales)
    series = Series(
        _zarr_statements(lengths),
        name if several else "",
        [str(channel.get("label") or f"channel {n}") for n, channel in enumerate(channels)],
        partial(_zarr_own, _zarr_centre(lengths, *array.shape[-2:])),
        simulated=states_simulated(text + json.dumps(about)),
    )
    read = partial(_read_zarr, path, f"{name}/{scales['datasets'][0]['path']}")
    yield from planes_in(path, sizes, series, read, first)


_MOST_CHUNKS = 4


def _read_zarr(path: Path, array: str, name: str, where: Where) -> Image:
    import zarr

    with parser_errors_as(partial(damaged, name)):
        values: Any = zarr.open_array(str(path), path=array.strip("/"), mode="r")
        return as_grey(np.asarray(values[tuple(where.values())]), name)


@dataclass(frozen=True, slots=True)
class _Lengths:
    """Scale and translation along each axis, in um, without axes in other units; no translation if none is stated."""

    scale: Mapping[str, float]
    translation: Mapping[str, float]


def _zarr_lengths(axes: Sequence[str], scales: Mapping[str, Any]) -> _Lengths:
    units = [UNITS_UM.get(str(axis.get("unit")), 0.0) if isinstance(axis, dict) else 0.0 for axis in scales["axes"]]
    steps, begin = np.ones(len(axes)), np.zeros(len(axes))
    changes = [
        *scales["datasets"][0].get("coordinateTransformations", ()),
        *scales.get("coordinateTransformations", ()),
    ]
    for change in changes:
        factor = np.asarray(change.get("scale", np.ones(len(axes))), np.float64)
        steps, begin = steps * factor, begin * factor + np.asarray(change.get("translation", 0.0), np.float64)
    in_um = {axis: n for n, axis in enumerate(axes) if units[n]}
    placed = any("translation" in change for change in changes)
    return _Lengths(
        {axis: float(steps[n] * units[n]) for axis, n in in_um.items()},
        {axis: float(begin[n] * units[n]) for axis, n in in_um.items()} if placed else {},
    )


def _zarr_statements(lengths: _Lengths) -> Statements:
    def stated(axis: str) -> Stated[float] | None:
        value = lengths.scale.get(axis)
        return Stated(value, f"OME-Zarr scale {axis.lower()}") if value else None

    return Statements(pixel_um=stated("X"), pixel_y_um=stated("Y"), z_step_um=stated("Z"))


def _zarr_centre(lengths: _Lengths, rows: int, cols: int) -> dict[str, float]:
    """Return the centre of an image in um, y up; nothing where no place is stated."""
    if not {"X", "Y"} <= lengths.translation.keys():
        return {}
    return {
        "x_um": lengths.translation["X"] + (cols - 1) / 2 * lengths.scale["X"],
        "y_um": -(lengths.translation["Y"] + (rows - 1) / 2 * lengths.scale["Y"]),
    }


def _zarr_own(centre: Mapping[str, float], _: Place) -> Mapping[str, float]:
    return centre


# --- NDTiff, of Micro-Manager 2 and Pycro-Manager

NDTIFF_INDEX = "NDTiff.index"
_LENGTH, _ENTRY = struct.Struct("<I"), struct.Struct("<8I")
_TYPES = {0: ("u1", 1), 1: ("<u2", 1), 2: ("u1", 3), **dict.fromkeys((3, 4, 5, 6), ("<u2", 1))}
"""Type and number of values of a pixel by the number in the index; 3 to 6 have 10, 12, 14 and 11 bits."""


@dataclass(frozen=True, slots=True)
class _Entry:
    """One image in the index of an NDTiff folder: where its pixels and its words lie in a file."""

    axes: Mapping[str, Any]
    file: Path
    offset: int
    cols: int
    rows: int
    kind: int
    words_offset: int
    words_length: int

    def words(self) -> dict[str, Any]:
        """Return what is said of the image."""
        with self.file.open("rb") as file:
            file.seek(self.words_offset)
            return json.loads(file.read(min(self.words_length, _MOST_WORDS)))


_MOST_WORDS = 1_000_000
"""Bytes that are read of what is said of an image."""


def planes_of_ndtiff(path: Path) -> tuple[ImagePlane, ...]:
    """Return the planes of an NDTiff folder. Raises DatasetError when it is damaged."""
    with parser_errors_as(partial(damaged, path.name)):
        entries = list(_entries(path))
        require_planes(path.name, len(entries))
        summary = _summary(entries[0].file)
        names = {axis: list(dict.fromkeys(one.axes[axis] for one in entries)) for axis in entries[0].axes}
        return tuple(_plane_of(n, one, names, summary) for n, one in enumerate(entries))


def _entries(path: Path) -> Iterator[_Entry]:
    content, at = read_content(path / NDTIFF_INDEX), 0

    def text() -> str:
        nonlocal at
        (length,) = _LENGTH.unpack_from(content, at)
        at += _LENGTH.size + length
        return content[at - length : at].decode()

    while at + _LENGTH.size < len(content) and _LENGTH.unpack_from(content, at)[0]:
        axes, file = json.loads(text()), path / Path(text()).name
        offset, cols, rows, kind, _, words_offset, words_length, _ = _ENTRY.unpack_from(content, at)
        at += _ENTRY.size
        require_pixels(file.name, rows, cols)
        yield _Entry(axes, file, offset, cols, rows, kind, words_offset, words_length)


def _summary(file: Path) -> dict[str, Any]:
    """Return what the head of a file says of all its images."""
    with file.open("rb") as content:
        length = int.from_bytes(content.read(28)[24:], "little")
        return json.loads(content.read(min(length, _MOST_WORDS)))


def _plane_of(number: int, one: _Entry, names: Mapping[str, Sequence[Any]], summary: Mapping[str, Any]) -> ImagePlane:
    words = one.words()

    def value(*keys: str, factor: float = 1.0) -> float | None:
        found = next((stated_number(words[key]) for key in keys if key in words), None)
        return None if found is None else found * factor

    def named(axis: str) -> str:
        own = one.axes.get(axis)
        several = len(names.get(axis, ())) > 1
        return "" if own is None or not several else own if isinstance(own, str) else f"{axis} {own}"

    pixel = value("PixelSizeUm", "PixelSize_um") or stated_number(summary.get("PixelSize_um"))
    step = stated_number(summary.get("z-step_um"))
    z, at = one.axes.get("z", 0), ", ".join(f"{axis} {own}" for axis, own in one.axes.items())
    name = f"{one.file.parent.name}, {at}"
    return ImagePlane(
        name=name,
        path=one.file.parent,
        page=number,
        read=partial(_read_ndtiff, one, name),
        position=", ".join(filter(None, map(named, ("position", "row", "column")))),
        channel=named("channel"),
        time=named("time"),
        k=z if isinstance(z, int) else names["z"].index(z),
        z_um=value("ZPositionUm", "ZPosition_um_Intended"),
        x_um=value("XPositionUm", "XPosition_um_Intended"),
        y_um=value("YPositionUm", "YPosition_um_Intended"),
        exposure_us=value("Exposure-ms", "Exposure", factor=1e3),
        time_us=value("ElapsedTime-ms", factor=1e3),
        simulated=states_simulated(json.dumps([words, summary])),
        says=Statements(
            pixel_um=Stated(pixel, "NDTiff PixelSizeUm") if pixel else None,
            z_step_um=Stated(step, "NDTiff z-step_um") if step else None,
        ),
    )


def _read_ndtiff(one: _Entry, name: str) -> Image:
    with parser_errors_as(partial(damaged, name)), one.file.open("rb") as file:
        kind, n_values = _TYPES[one.kind]
        file.seek(one.offset)
        content = file.read(one.rows * one.cols * n_values * np.dtype(kind).itemsize)
        values: NDArray[Any] = np.frombuffer(content, kind)
        return as_grey(values.reshape((one.rows, one.cols, n_values)[: 3 if n_values > 1 else 2]), name)
