"""GWY, Gwyddion's native format: containers of named components, layers as channels.

Lengths are in m, y points downward, and (xoff, yoff) is the top left corner. Heights keep full precision. Implemented
here and not with gwyfile, which copies the unread remainder for each component. Source: Gwyddion user guide, 'GWY file
format'.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeGuard

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.errors import DatasetError, parser_errors_as
from wafer_viewer.model.surface.height_map import HeightMap, Provenance
from wafer_viewer.store.formats.reader_support import (
    OURS,
    UNITS_UM,
    ReadOptions,
    about,
    heights_only,
    on_square_pixels,
    parse_metadata,
    provenance_of,
    require_some,
    scaled,
    title,
)
from wafer_viewer.store.formats.surface_strips import Strips

MAGIC = b"GWYP"
_DEEPEST = 16
_MOST_COMPONENTS = 100_000
"""Components and texts of a file; Gwyddion writes a few hundred, and each takes a microsecond."""
_SIZES = {"b": 1, "c": 1, "i": 4, "q": 8, "d": 8}
_FORMS = {"b": "<?", "c": "<c", "i": "<i", "q": "<q", "d": "<d"}
_ARRAYS = {"C": "u1", "I": "<i4", "Q": "<i8", "D": "<f8"}
Tree = dict[str, Any]


def parsed(content: NDArray[np.uint8]) -> Tree:
    """Parse the container of a file. Raises ValueError or struct.error when the file ends too early."""
    return _Parser(content).container()


class _Parser:
    """Component parser; arrays are views of the file. Raises ValueError or struct.error when it ends too early."""

    def __init__(self, content: NDArray[np.uint8]) -> None:
        self._content, self._position, self._n_texts = content, len(MAGIC), 0

    def container(self) -> Tree:
        """Return the container of the file."""
        return self._object(len(self._content), 0)

    def _object(self, limit: int, depth: int) -> Tree:
        if depth > _DEEPEST:
            raise ValueError("objects lie too deep in each other")
        self._text()
        (n_bytes,) = struct.unpack("<I", self._bytes(4))
        end = self._position + n_bytes
        if end > limit:
            raise ValueError("an object ends after the file")
        values: Tree = {}
        while self._position < end:
            name, kind = self._text(), self._bytes(1).decode("ascii")
            values[name] = self._value(kind, end, depth)
        return values

    def _value(self, kind: str, end: int, depth: int) -> Any:
        if kind == "o":
            return self._object(end, depth + 1)
        if kind == "s":
            return self._text()
        if kind in _SIZES:
            return struct.unpack(_FORMS[kind], self._bytes(_SIZES[kind]))[0]
        (n_items,) = struct.unpack("<I", self._bytes(4))
        if kind in _ARRAYS:
            dtype = np.dtype(_ARRAYS[kind])
            return np.frombuffer(self._view(n_items * dtype.itemsize), dtype)
        if kind == "S":
            return [self._text() for _ in range(n_items)]
        if kind == "O":
            return [self._object(end, depth + 1) for _ in range(n_items)]
        raise ValueError(f"a component is of an unknown kind {kind!r}")

    def _text(self) -> str:
        self._n_texts += 1
        if self._n_texts > _MOST_COMPONENTS:
            raise ValueError("it has too many components")
        end = self._position
        while not (ends := np.flatnonzero(self._content[end : end + 256] == 0)).size:
            end += 256
            if end >= len(self._content):
                raise ValueError("a text has no end")
        end += int(ends[0])
        text = bytes(self._content[self._position : end]).decode()
        self._position = end + 1
        return text

    def _bytes(self, n: int) -> bytes:
        return bytes(self._view(n))

    def _view(self, n: int) -> NDArray[np.uint8]:
        if self._position + n > len(self._content):
            raise ValueError("the file ends too early")
        view = self._content[self._position : self._position + n]
        self._position += n
        return view


_M = 1e-6
_LARGEST_BYTES = 2**32 - 1
"""Largest object in bytes: its size is a 32-bit number."""


@dataclass(frozen=True, slots=True)
class Channel:
    """Layer as a channel: title, unit, scale factor, and whether it has gaps."""

    layer: str
    title: str
    unit: str = ""
    scale: float = 1.0
    has_gaps: bool = False


CHANNELS = (
    Channel("z_um", "Heights", "m", _M, has_gaps=True),
    Channel("z_raw_um", "Measured heights", "m", _M, has_gaps=True),
    Channel("confidence", "Confidence"),
    Channel("all_in_focus", "All in focus"),
    Channel("origin", "Origin"),
)
UNCERTAINTY = Channel("u_um", "Standard uncertainty", "m", _M, has_gaps=True)
"""Channel of a surface that has it."""


@dataclass(frozen=True, slots=True)
class _Numbers:
    """Values of a layer, stored as 64-bit floats, or its mask of missing values."""

    channel: Channel
    is_mask: bool = False


def write_gwy(strips: Strips, path: Path) -> None:
    """Write all layers as channels, or only the heights if all would exceed the 4 GB limit of the format.

    Raises DatasetError if the heights alone exceed it.
    """
    parts = _parts(strips, CHANNELS[:1] if lost_layers(strips) else _channels(strips))
    if _size(strips, parts) > _LARGEST_BYTES:
        raise DatasetError(f"{path.name} would pass the 4 GB of a GWY file: take X3P, or fewer points with --every 2.")
    arrays = [part for part in parts if isinstance(part, _Numbers)]
    with path.open("wb") as file:
        file.write(MAGIC + b"GwyContainer\0" + struct.pack("<I", _size(strips, parts)))
        for part in parts:
            if isinstance(part, bytes):
                file.write(part)
                continue
            for data in _data(strips, part, arrays.index(part), len(arrays)):
                file.write(data)


def lost_layers(strips: Strips) -> str:
    """Return a sentence if only the heights of a surface fit into the 4 GB limit, otherwise an empty text."""
    fits = _size(strips, _parts(strips, _channels(strips))) <= _LARGEST_BYTES
    return "" if fits else "All layers would pass the 4 GB of a GWY file: it holds heights only."


def _channels(strips: Strips) -> tuple[Channel, ...]:
    return (*CHANNELS, UNCERTAINTY) if strips.has_uncertainty else CHANNELS


def read_gwy(path: Path, options: ReadOptions) -> HeightMap:
    """Read all layers of a Wafer Viewer file, else the heights only. Raises DatasetError if there are no heights."""
    with path.open("rb") as file:
        is_gwy = file.read(len(MAGIC)) == MAGIC
    if not is_gwy:
        raise options.refuse("is not a GWY file: give a file that Gwyddion or Wafer Viewer wrote.")
    damaged = options.refuse("is cut off or damaged: copy it again, or save it again in Gwyddion.")
    with parser_errors_as(lambda _: damaged):
        tree = parsed(np.memmap(path, np.uint8, "r"))
    channels = {int(key.split("/")[1]): tree[key] for key in tree if _is_channel(key, tree[key])}
    titles = {tree.get(f"/{n}/data/title"): n for n in channels}
    number = titles.get(CHANNELS[0].title, next((n for n in sorted(channels) if _is_length(channels[n])), None))
    if number is None:
        raise options.refuse(
            "has no channel of heights, with a unit of length: give its unit in Gwyddion, and save it."
        )
    texts: Tree = {**tree.get(f"/{number}/meta", {})}
    metadata = parse_metadata(embedded := texts.pop(OURS, None))
    came_from = provenance_of(metadata, embedded, *(text for text in texts.values() if isinstance(text, str)))
    if len(channels) > 1 and metadata is None:
        options.notes.append(
            f"Its channel '{tree.get(f'/{number}/data/title', number)}' was read, one of {len(channels)}."
        )
    return _surface(tree, channels, titles, number, came_from, options)


def _surface(
    tree: Tree,
    channels: dict[int, Tree],
    titles: dict[Any, int],
    number: int,
    came_from: Provenance | None,
    options: ReadOptions,
) -> HeightMap:
    field = channels[number]
    options.require_heights_up(str(tree.get(f"/{number}/data/title", "")))
    unit_um = options.lateral_um(_unit(field, "si_unit_xy"))
    rows, cols = _shape(field)
    pitches = (None, None) if unit_um is None else (field["xreal"] / cols * unit_um, field["yreal"] / rows * unit_um)
    dx_um, dy_um = options.pitches_um(*pitches)
    x0_um, y0_um = (field.get(name, 0.0) * (unit_um or 0.0) for name in ("xoff", "yoff"))
    z_um, pixel_um = on_square_pixels(options, _heights(tree, number, channels, options), dx_um, dy_um)
    place = pixel_um, x0_um + dx_um / 2, -y0_um - dy_um / 2
    wanted = [titles.get(channel.title) for channel in CHANNELS]
    if came_from is None or None in wanted or any(_shape(channels[n]) != z_um.shape for n in wanted if n is not None):
        return heights_only(options, z_um, *place, came_from)
    confidence, grey, origin = (channels[n] for n in wanted[2:] if n is not None)
    require_some(options, np.isfinite(z_um))
    greys, of_u = grey["data"].reshape(rows, cols), titles.get(UNCERTAINTY.title)
    return HeightMap(
        z_um=z_um,
        z_raw_um=_heights(tree, wanted[1] or 0, channels, options),
        confidence=scaled(options, confidence["data"].reshape(rows, cols), 1.0),
        all_in_focus=greys.astype(np.uint16 if greys.max(initial=0) > 255 else np.uint8),
        origin=origin["data"].reshape(rows, cols).astype(np.uint8),
        pixel_um=place[0],
        x0_um=place[1],
        y0_um=place[2],
        provenance=came_from,
        u_um=None if of_u is None else _heights(tree, of_u, channels, options),
    )


def _heights(tree: Tree, number: int, channels: dict[int, Tree], options: ReadOptions) -> NDArray[np.float32]:
    """Return the heights of a channel; pixels under its mask are NaN."""
    field = channels[number]
    is_ours = OURS in tree.get(f"/{number}/meta", {})
    z_scale = options.z_scale_um(_unit(field, "si_unit_z"))
    z_um = scaled(options, field["data"].reshape(_shape(field)), z_scale, is_ours=is_ours)
    mask = tree.get(f"/{number}/mask")
    if _is_field(mask) and _shape(mask) == _shape(field):
        z_um[mask["data"].reshape(_shape(field)) > 0] = np.nan
        if not is_ours:
            options.notes.append("What lies under its mask counts as unmeasured.")
    return z_um


def _is_channel(key: str, value: Any) -> bool:
    parts = key.split("/")
    return len(parts) == 3 and parts[1].isdigit() and parts[2] == "data" and _is_field(value)


def _is_field(value: Any) -> TypeGuard[Tree]:
    if not isinstance(value, dict) or not {"xres", "yres", "xreal", "yreal", "data"} <= value.keys():
        return False
    rows, cols = _shape(value)
    return rows > 0 and cols > 0 and value["data"].size == rows * cols


def _shape(field: Tree) -> tuple[int, int]:
    return int(field["yres"]), int(field["xres"])


def _unit(field: Tree, name: str) -> str | None:
    unit = field.get(name)
    return (unit.get("unitstr") or None) if isinstance(unit, dict) else None


def _is_length(field: Tree) -> bool:
    return (_unit(field, "si_unit_z") or "m") in UNITS_UM


def _parts(strips: Strips, channels: tuple[Channel, ...]) -> list[bytes | _Numbers]:
    """Return the components of the container, in order."""
    parts: list[bytes | _Numbers] = []
    metadata = _object("GwyContainer", _string("Title", title(strips.surface)) + _string(OURS, about(strips)))
    for number, channel in enumerate(channels):
        parts += _field(strips, f"/{number}/data", _Numbers(channel))
        if channel.has_gaps:
            parts += _field(strips, f"/{number}/mask", _Numbers(channel, is_mask=True))
        parts.append(_string(f"/{number}/data/title", channel.title))
        parts.append(_named(f"/{number}/data/visible", "b") + struct.pack("<?", number == 0))
        parts.append(_named(f"/{number}/meta", "o") + metadata)
    return parts


def _field(strips: Strips, key: str, numbers: _Numbers) -> list[bytes | _Numbers]:
    """Return a GwyDataField: the bytes before its values, and the values."""
    (rows, cols), pixel_m, surface = strips.shape, strips.pixel_um * _M, strips.surface
    unit = "" if numbers.is_mask else numbers.channel.unit
    inside = b"".join(_named(name, "i") + struct.pack("<i", n) for name, n in (("xres", cols), ("yres", rows)))
    lengths = {
        "xreal": cols * pixel_m,
        "yreal": rows * pixel_m,
        "xoff": (surface.x0_um - strips.pixel_um / 2) * _M,
        "yoff": -(surface.y0_um + strips.pixel_um / 2) * _M,
    }
    inside += b"".join(_named(name, "d") + struct.pack("<d", length) for name, length in lengths.items())
    for name, unit_name in (("si_unit_xy", "m"), ("si_unit_z", unit)):
        inside += _named(name, "o") + _object("GwySIUnit", _string("unitstr", unit_name))
    inside += _named("data", "D") + struct.pack("<I", rows * cols)
    n_bytes = len(inside) + 8 * rows * cols
    head = _named(key, "o") + b"GwyDataField\0" + struct.pack("<I", min(n_bytes, _LARGEST_BYTES))
    return [head + inside, numbers]


def _data(strips: Strips, numbers: _Numbers, part: int, of: int) -> Iterator[bytes]:
    """Yield the values of a layer; gaps get the first height of their strip and are set in the mask."""
    channel, before = numbers.channel, 0.0
    for layer in strips.layer(channel.layer, part, of):
        finite = np.isfinite(layer) if channel.has_gaps else np.True_
        if numbers.is_mask:
            yield (~finite).astype("<f8").tobytes()
            continue
        values = layer.astype("<f8") * channel.scale
        if channel.has_gaps:
            before = float(values[finite][0]) if finite.any() else before
            values[~finite] = before
        yield values.tobytes()


def _size(strips: Strips, parts: list[bytes | _Numbers]) -> int:
    rows, cols = strips.shape
    return sum(len(part) if isinstance(part, bytes) else 8 * rows * cols for part in parts)


def _named(name: str, kind: str) -> bytes:
    return name.encode() + b"\0" + kind.encode()


def _string(name: str, text: str) -> bytes:
    return _named(name, "s") + text.encode() + b"\0"


def _object(name: str, inside: bytes) -> bytes:
    return name.encode() + b"\0" + struct.pack("<I", len(inside)) + inside
