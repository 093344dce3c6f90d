"""Guarded reading of ``.npz`` archives: every array is checked against its file before memory is taken for it."""

from __future__ import annotations

import math
import struct
import zipfile
from collections.abc import Callable, Generator
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.errors import WaferViewerError, parser_errors_as
from wafer_viewer.store.io.checksums import require_good_archive
from wafer_viewer.store.io.guarded_reading import require_unpacked

_LOCAL_HEADER = struct.Struct("<26xHH")
"""End of the local header of a zip member: lengths of its name and of its extra field."""
_PIECE_BYTES = 1 << 24
_MOST_MEMBERS = 1000


class Archive:
    """Arrays of an open ``.npz`` by name; each method raises KeyError when the archive has no such array.

    Use it under `open_archive`, which makes the program's own error of what the libraries raise.
    """

    def __init__(self, path: Path, archive: zipfile.ZipFile, file: IO[bytes]) -> None:
        self._path, self._archive, self._file = path, archive, file
        self._members = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}
        self._require_modest()

    def __contains__(self, name: str) -> bool:
        return name in self._members

    @cached_property
    def _whole(self) -> NDArray[np.uint8]:
        """Bytes of the file; all its arrays share one mapping, for each mapping takes a file descriptor."""
        return np.asarray(np.memmap(self._path, np.uint8, "c"))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the arrays, in the order of the file."""
        return tuple(self._members)

    def mapped(self, name: str) -> NDArray[Any]:
        """Return an array, memory-mapped copy-on-write; a compressed one is read."""
        member = self._members[name]
        if member.compress_type != zipfile.ZIP_STORED:
            return self.array(name)
        self._file.seek(member.header_offset)
        name_bytes, extra_bytes = _LOCAL_HEADER.unpack(self._file.read(_LOCAL_HEADER.size))
        begin = self._file.seek(name_bytes + extra_bytes, 1)
        shape, dtype = _checked_header(self._file, name, member.file_size)
        if begin + member.file_size > self._path.stat().st_size:
            raise ValueError(f"{name} ends after the file")
        if 0 in shape:
            return np.empty(shape, dtype)
        values = self._whole[self._file.tell() :][: dtype.itemsize * math.prod(shape)]
        return values.view(dtype).reshape(shape)

    def array(self, name: str) -> NDArray[Any]:
        """Read an array into memory; the checksum of the archive's member is verified."""
        member = self._members[name]
        with self._archive.open(member) as file:
            shape, dtype = _checked_header(file, name, member.file_size)
            values = np.empty(shape, dtype)
            target: Any = values.reshape(-1).view(np.uint8).data if values.size else b""
            for start in range(0, len(target), _PIECE_BYTES):
                piece = file.read(min(_PIECE_BYTES, len(target) - start))
                target[start : start + len(piece)] = piece
            if file.read(1):  # the member is verified at its end
                raise ValueError(f"{name} is longer than its header states")
        return values

    def number(self, name: str) -> float:
        """Return a single number."""
        return float(self._single(name))

    def text(self, name: str) -> str:
        """Return a single text."""
        return str(self._single(name))

    def _single(self, name: str) -> Any:
        values = self.array(name)
        if values.size != 1:
            raise ValueError(f"{name} is not a single value")
        return values.item()

    def _require_modest(self) -> None:
        """Raise for an archive that unpacks to far more than its file."""
        if len(self._members) > _MOST_MEMBERS:
            raise ValueError(f"it holds more than {_MOST_MEMBERS} arrays")
        require_unpacked(self._path, self._path.stat().st_size, sum(m.file_size for m in self._members.values()))


@contextmanager
def open_archive(
    path: Path, refusal: Callable[[Exception], WaferViewerError], *, verify: bool = True
) -> Generator[Archive]:
    """Open an ``.npz`` for reading; whatever is raised until it is closed becomes the error of `refusal`.

    verify: verify the checksum of the file, or those of its members, once per process as long as it does not change.
    """
    with parser_errors_as(refusal):
        if verify:
            require_good_archive(path)
        with path.open("rb") as file, zipfile.ZipFile(file) as archive:
            yield Archive(path, archive, file)


def _checked_header(file: IO[bytes], name: str, n_bytes: int) -> tuple[tuple[int, ...], np.dtype[Any]]:
    """Read shape and dtype of an array; n_bytes: the size of its member, header included."""
    version = np.lib.format.read_magic(file)
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, fortran, dtype = read(file)
    if dtype.hasobject:
        raise ValueError(f"{name} holds objects of Python")
    if any(type(n) is not int or n < 0 for n in shape) or (fortran and len(shape) > 1):
        raise ValueError(f"{name} has an unusual layout")
    n_items = 1
    for n in shape:
        n_items *= n
    if n_items * dtype.itemsize > n_bytes:
        raise ValueError(f"{name} is shorter than its header states")
    return shape, dtype
