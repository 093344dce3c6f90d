"""CRC-32C checksums embedded in the files: they remain valid in a copy; and append-only logs whose lines carry one.

A JSON text and a line of a log end with the member ``"crc32c"``: eight hex digits over all bytes before them. An
``.npz`` ends with ``crc32c=`` and such digits as the comment of the archive. Shards and chunks of a mosaic have the
codec ``crc32c`` of Zarr. Files without a checksum, of schema 1, of another program or written by hand, are read as they
are. Any single flipped bit is detected, also in the checksum itself.

A torn last line, as after a power failure, is ignored and truncated before the next entry.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import zipfile
from collections.abc import Hashable, Sequence
from enum import Enum
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import numpy as np

from wafer_viewer.model.errors import DatasetError, detail, parser_errors_as
from wafer_viewer.model.file_contents import DATASET_ENDING
from wafer_viewer.model.spec import Spec, decode, encode
from wafer_viewer.store.io.atomic_files import flush, os_errors_as_dataset_errors, to_disk, write_text
from wafer_viewer.store.io.guarded_reading import read_content

SURFACES = "surfaces"
"""Folder of the field surfaces in a result."""
MOST_RECORD_BYTES = 2_000_000_000
"""Largest JSON text of a dataset: ten times the record of a scan of a million fields."""
_KEY = b'"crc32c":'
_NEARLY_KEY = re.compile(b"|".join(_KEY[:i] + b"." + _KEY[i + 1 :] for i in range(len(_KEY))), re.DOTALL)
"""The key with any one byte damaged."""
_LINE_KEY, _LINE_END = b'"crc32c":"', b'"}'
_SEAL = re.compile(rb',?\s*"crc32c": ?"([0-9a-f]{8})"[ \n}]*$')
_TAIL_BYTES = 64
_COMMENT = re.compile(rb"crc32c=([0-9a-f]{8})$")
_COMMENT_BYTES = 15
_END_OF_ARCHIVE, _END_BYTES = b"PK\5\6", 22
_PIECE_BYTES = 1 << 24
FileMark = tuple[Path, int, int, int]
"""File and its state: path, inode, size, modification time in ns."""
S = TypeVar("S", bound=Spec)


class Checksum(Enum):
    """State of the checksum of a file or a line."""

    GOOD = "good"
    DAMAGED = "damaged"
    NONE = "no checksum"


def crc32c(content: bytes, before: int = 0) -> int:
    """Return the CRC-32C of some bytes; `before`: the CRC of the preceding bytes."""
    import google_crc32c

    return google_crc32c.extend(before, content)


def closing_bytes(before: int, after: bytes, wanted: int) -> bytes:
    """Return four bytes that, between bytes of CRC-32C `before` and the bytes `after`, make the CRC-32C `wanted`.

    The CRC is affine in the bits of the four bytes, so 32 linear equations modulo 2 give them.
    """

    def crc(bits: int) -> int:
        return crc32c(after, crc32c(bits.to_bytes(4, "little"), before))

    basis: dict[int, tuple[int, int]] = {}

    def reduced(value: int, bits: int) -> tuple[int, int]:
        while value.bit_length() in basis:
            of_basis, its_bits = basis[value.bit_length()]
            value, bits = value ^ of_basis, bits ^ its_bits
        return value, bits

    zero = crc(0)
    for bits in (1 << i for i in range(32)):
        value, combined = reduced(crc(bits) ^ zero, bits)
        basis[value.bit_length()] = value, combined
    return reduced(wanted ^ zero, 0)[1].to_bytes(4, "little")


# ------------------------------------------------------------------------------------------------ JSON


def sealed_text(text: str) -> str:
    """Return an indented JSON object with its checksum as the last member."""
    body = text.rstrip().removesuffix("}").rstrip()
    start = f'{body}{"" if body == "{" else ","}\n  "crc32c": "'
    return f'{start}{crc32c(start.encode()):08x}"\n}}'


def sealed_line(line: bytes) -> bytes:
    """Return a JSON object on one line with its checksum as the last member."""
    start = line.removesuffix(b"}") + b',"crc32c":"'
    return b'%s%08x"}' % (start, crc32c(start))


def sealed_node(node: dict[str, Any]) -> str:
    """Return the ``zarr.json`` of a group or an array with its checksum as the last attribute."""
    plain = {name: value for name, value in node.items() if name != "attributes"}
    attributes = {name: value for name, value in node.get("attributes", {}).items() if name != "crc32c"}
    text = json.dumps({**plain, "attributes": {**attributes, "crc32c": "0" * 8}}, indent=2)
    start, end = text[: text.rindex("0" * 8)], text[text.rindex("0" * 8) + 8 :]
    return f"{start}{crc32c(start.encode()):08x}{end}"


def text_state(content: bytes) -> Checksum:
    """Return the checksum state of a JSON text."""
    tail = max(0, len(content) - _TAIL_BYTES)
    if (seal := _SEAL.search(content, tail)) is not None:
        return _compared(seal[1], crc32c(content[: seal.start(1)]))
    return Checksum.DAMAGED if _NEARLY_KEY.search(content, tail) else Checksum.NONE


def lines_are_good(lines: Sequence[bytes]) -> bool:
    """Return whether every log line has a checksum, and the right one; half a microsecond each.

    False tells nothing about a single line, for which `line_state` is asked.
    """
    import google_crc32c

    crc = google_crc32c.extend
    return all(
        line[-20:-10] == _LINE_KEY and line[-2:] == _LINE_END and line[-10:-2] == b"%08x" % crc(0, line[:-10])
        for line in lines
    )


def line_state(line: bytes) -> Checksum:
    """Return the checksum state of a log line."""
    key = line[-20:-10]
    if key == _LINE_KEY and line[-2:] == _LINE_END:
        return _compared(line[-10:-2], crc32c(line[:-10]))
    nearly = key[:5] == _LINE_KEY[:5] or key[5:] == _LINE_KEY[5:]  # one damaged byte leaves the other half
    return Checksum.DAMAGED if nearly else Checksum.NONE


def strip_checksum(content: bytes) -> bytes:
    """Return a JSON text without its checksum, which is not tested."""
    seal = _SEAL.search(content, max(0, len(content) - _TAIL_BYTES))
    return content if seal is None else content[: seal.start()] + b"}"


def save_json(path: Path, spec: Spec) -> None:
    """Write a spec with its checksum, atomically."""
    write_text(path, sealed_text(encode(spec, "json")))


def load_json(path: Path, kind: type[S]) -> S:
    """Read a spec. Raises DatasetError when the file cannot be read or its checksum differs."""
    return decode(verified_text(path), kind, str(path), "json")


def require_good_json(path: Path) -> None:
    """Raise DatasetError when the file exists and its checksum differs, to protect user input from overwriting."""
    if path.exists():
        verified_text(path)


class KnownGood:
    """Bounded cache of file states that this process has verified; a changed file has a new state."""

    def __init__(self, most: int = 8192) -> None:
        self._most = most
        self._keys: dict[Hashable, None] = {}

    def __contains__(self, key: Hashable) -> bool:
        return key in self._keys

    def add(self, key: Hashable) -> None:
        """Add a key, and drop the oldest ones above the limit."""
        while len(self._keys) >= self._most:
            self._keys.pop(next(iter(self._keys)), None)
        self._keys[key] = None


_good_archives = KnownGood()


def verified_text(path: Path) -> bytes:
    """Return the JSON text of a file without its checksum. Raises DatasetError if unreadable or damaged."""
    content = read_content(path, most=MOST_RECORD_BYTES)
    if text_state(content) is Checksum.DAMAGED:
        raise damaged(path)
    return strip_checksum(content)


def require_json(content: bytes, name: str) -> None:
    """Raise DatasetError for anything that is not JSON."""
    with parser_errors_as(lambda fault: DatasetError(f"{name} is not JSON{detail(fault)}: restore it from a copy.")):
        msgspec.json.decode(content)


# ------------------------------------------------------------------------------------------------ archives


def seal_archive(path: Path) -> None:
    """Append the checksum of a closed ``.npz`` as the comment of the archive."""
    with path.open("r+b") as file:
        file.seek(-2, os.SEEK_END)
        file.write(_COMMENT_BYTES.to_bytes(2, "little"))
        file.write(b"crc32c=")
    crc = crc_of_file(path, path.stat().st_size)
    with path.open("ab") as file:
        file.write(b"%08x" % crc)


def stored_checksum(path: Path) -> int:
    """Return the checksum in an ``.npz``, untested, as a number that identifies its content.

    Raises DatasetError when it has none.
    """
    with path.open("rb") as file:
        file.seek(max(0, path.stat().st_size - _COMMENT_BYTES))
        comment = _COMMENT.search(file.read())
    if comment is None:
        raise DatasetError(f"{path} has no checksum: {remedy(path)}.")
    return int(comment[1], 16)


def archive_state(path: Path) -> Checksum:
    """Return the checksum state of an ``.npz``; reads the entire file."""
    n_bytes = path.stat().st_size
    with path.open("rb") as file:
        file.seek(max(0, n_bytes - _END_BYTES))
        tail = file.read()
    if (comment := _COMMENT.search(tail)) is not None:
        return _compared(comment[1], crc_of_file(path, n_bytes - len(comment[1])))
    plain = tail.startswith(_END_OF_ARCHIVE) and tail.endswith(b"\0\0")
    return Checksum.NONE if plain or _END_OF_ARCHIVE not in tail + _before(path, n_bytes) else Checksum.DAMAGED


def require_good_archive(path: Path) -> None:
    """Raise DatasetError when the checksum of an ``.npz`` differs; an unchanged file is read once.

    A file without a checksum of its own has those of its zip members.
    """
    key = file_mark(path)
    if key in _good_archives:
        return
    state = archive_state(path)
    if state is Checksum.DAMAGED or (state is Checksum.NONE and not _are_members_good(path)):
        raise damaged(path)
    _good_archives.add(key)


def _are_members_good(path: Path) -> bool:
    """Return whether the CRC-32 of every uncompressed member fits; compressed ones are verified when they are read.

    Mapped arrays bypass the checks of the zip library. Raises BadZipFile when the file is no archive.
    """
    with zipfile.ZipFile(path) as archive:
        return all(_is_good(archive, m) for m in archive.infolist() if m.compress_type == zipfile.ZIP_STORED)


def _is_good(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> bool:
    with archive.open(member) as file:
        try:
            while file.read(_PIECE_BYTES):
                pass
        except zipfile.BadZipFile:  # raised at the end of a member
            return False
    return True


def file_mark(path: Path) -> FileMark:
    """Return a file and its state, which differs after each write."""
    stat = path.stat()
    return path, stat.st_ino, stat.st_size, stat.st_mtime_ns


def _before(path: Path, n_bytes: int) -> bytes:
    """Return the bytes before the end record, as many as a checksum comment has."""
    with path.open("rb") as file:
        file.seek(max(0, n_bytes - _END_BYTES - _COMMENT_BYTES))
        return file.read(_COMMENT_BYTES)


def crc_of_file(path: Path, n_bytes: int) -> int:
    """Return the CRC-32C of the first bytes of a file."""
    if not n_bytes:
        return 0
    mapped, crc = np.memmap(path, np.uint8, "r", shape=(n_bytes,)), 0
    for start in range(0, n_bytes, _PIECE_BYTES):
        crc = crc32c(mapped[start : start + _PIECE_BYTES], crc)  # pyright: ignore[reportArgumentType]
    return crc


def _compared(digits: bytes, crc: int) -> Checksum:
    return Checksum.GOOD if digits == b"%08x" % crc else Checksum.DAMAGED


# ------------------------------------------------------------------------------------------------ what to do about it


def file_sha256(path: Path) -> str:
    """Return the SHA-256 of a small file, hex. Raises DatasetError when it cannot be read."""
    with os_errors_as_dataset_errors(path):
        return hashlib.sha256(path.read_bytes()).hexdigest()


def damaged(path: Path) -> DatasetError:
    """Return the error for a file whose checksum differs, with its path and the remedy."""
    return DatasetError(f"{path} is damaged, its checksum differs: {remedy(path)}.")


def remedy(path: Path) -> str:
    """Return the remedy for a damaged file of a dataset, as the end of a sentence."""
    dataset = next((p.name for p in path.parents if p.suffix == DATASET_ENDING), "NAME.wafer")
    parts = path.parts
    result = parts[len(parts) - parts[::-1].index("results")] if "results" in parts[:-1] else "default"
    flag = f" --result '{result}'" if result != "default" else ""
    again = f"wafer-viewer stitch {dataset}{flag}"
    if result.startswith("difference-"):
        return "compare the two surfaces again"
    if any(part.endswith(".zarr") for part in parts) and _is_of_surface_file(path):
        return "remove the dataset and import its surface file again"
    if any(part.endswith(".zarr") for part in parts) or path.name == "poses.npz":
        return f"stitch the fields again ({again})"
    if path.parent.name == SURFACES or path.name in ("recipe.json", "settled.json"):
        return f"make the surface again ({again} --again)"
    if path.name == "verdict.json":
        judge = f"wafer-viewer measure verdict {dataset}{flag}"
        return f"restore it from a copy, or remove it to have the wafer judged again ({judge})"
    if path.parent.name == "frames":
        return _remedy_of_frames(path, dataset)
    if path.name.endswith(".golden.npz"):
        return "make it again or use an older version"
    return _OTHER_MENDS.get(path.name, "restore it from a copy")


def _remedy_of_frames(path: Path, dataset: str) -> str:
    record = path.parent.parent / "scan.json"
    if record.is_file() and _IMPORTED.search(record.read_bytes()):
        return "restore it from a copy, or import its images again"
    again = f"wafer-viewer scan PLAN.toml -o {dataset}"
    return f"restore it from a copy, or continue the scan, which takes damaged frames again ({again})"


def _is_of_surface_file(path: Path) -> bool:
    """Return whether a file is in a dataset that was imported from a surface file, and so has no frames."""
    dataset = next((parent for parent in path.parents if parent.suffix == DATASET_ENDING), None)
    return dataset is not None and dataset.is_dir() and not (dataset / "frames").exists()


_IMPORTED = re.compile(rb'"imported_from": ?"[^"]')
_OTHER_MENDS = {
    "scan.json": "restore it from a copy; where you changed it by hand, take its last member, crc32c, out",
    "findings.json": "restore it from a copy, or remove it and measure again",
    "defects.json": "restore it from a copy, or remove it and inspect again",
    "notebook.json": "restore it from a copy, or remove it: saved views and judgements are in it",
    "journal.index.npz": "remove it: it is made again from the journal",
    "surface.json": "remove it: it is made again from the stitched surface",
}


def append_bytes(path: Path, line: bytes) -> None:
    """Append a line to a log, in the place of a torn last one. Raises DatasetError when it cannot be written.

    The line then does not count.
    """
    with os_errors_as_dataset_errors(path):
        is_new = not path.exists()
        path.touch()
        os.truncate(path, len(complete_lines(path)))
        with path.open("ab", buffering=0) as file:
            if file.write(line) != len(line):
                raise DatasetError(f"{path} cannot be written: the disk is full: free some space.")
            flush(file.fileno())
        if is_new:
            to_disk(path.parent)


def complete_lines(path: Path) -> bytes:
    """Return the lines of a log without a torn last one; empty if there is no log.

    Raises DatasetError when it cannot be read.
    """
    if not path.exists():
        return b""
    text = read_content(path, most=MOST_RECORD_BYTES)
    return text[: text.rfind(b"\n") + 1]
