"""A disk whose power is cut: everything that a program does to a folder, and what a file system may leave of it.

A `Recording` notes the writes, truncations, renames and waits of this process below a folder. A `Disk` replays the
first of them and then loses its power. What was waited for is there. Of the rest, each write of a file may have
survived or not, or some sectors of it, with zeros in the gaps; of each folder the first some changes of names, in their
order. This is weaker than what ext4, XFS and NTFS promise.
"""

from __future__ import annotations

import builtins
import io
import os
import random
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

SECTOR = 512
CUTS = ("nothing more", "all", "torn", "torn", "sizes alone")
"""What is left of the writes that were not waited for."""


@dataclass
class Operation:
    """One change of a file or a folder, by paths below the recorded folder."""

    kind: str
    path: str
    at: int = 0
    content: bytes = b""
    to: str = ""


class Recording:
    """Operations below a folder, in order, and the marks that a test set between them."""

    def __init__(self, root: Path) -> None:
        self.root, self.operations = root, list[Operation]()
        self.marks: list[tuple[int, Any]] = []
        self._of_descriptor: dict[int, str] = {}

    def mark(self, value: Any) -> None:
        """Note that something is true from here on."""
        self.marks.append((len(self.operations), value))

    def name_of(self, path: Any) -> str | None:
        """Return the path below the folder, None for others."""
        if isinstance(path, int):
            return self._of_descriptor.get(path)
        place = Path(os.fsdecode(path)).absolute()
        return place.relative_to(self.root).as_posix() if place.is_relative_to(self.root) else None

    def add(self, kind: str, path: str, **details: Any) -> None:
        self.operations.append(Operation(kind, path, **details))

    def opened(self, descriptor: int, name: str | None, *, made: bool, emptied: bool) -> None:
        self._of_descriptor.pop(descriptor, None)
        if name is None:
            return
        self._of_descriptor[descriptor] = name
        if made:
            self.add("make", name)
        if emptied:
            self.add("truncate", name, at=0)


class _File(io.FileIO):
    """An unbuffered file that notes what is written."""

    recording: Recording
    name_below: str

    def write(self, content: Any) -> int:
        content = bytes(content)
        at = os.fstat(self.fileno()).st_size if "a" in self.mode else self.tell()
        n = super().write(content)
        self.recording.add("write", self.name_below, at=at, content=content[:n])
        return n

    def truncate(self, size: int | None = None) -> int:
        n = super().truncate(size)
        self.recording.add("truncate", self.name_below, at=n)
        return n


@contextmanager
def recorded(root: Path) -> Generator[Recording]:
    """Record what this process does below a folder by Python's own files and functions."""
    recording = Recording(root)
    with pytest.MonkeyPatch.context() as patch:
        for module in (io, builtins):
            patch.setattr(module, "open", _opening(recording, io.open))
        for name, wrap in _WRAPPED.items():
            patch.setattr(os, name, wrap(recording, getattr(os, name)))
        yield recording


def _opening(recording: Recording, plain: Callable[..., Any]) -> Callable[..., Any]:
    def opening(file: Any, mode: str = "r", buffering: int = -1, *args: Any, **kwargs: Any) -> Any:
        name = recording.name_of(file)
        if name is None or not set(mode) & set("wax+"):
            return plain(file, mode, buffering, *args, **kwargs)
        made = not isinstance(file, int) and not Path(file).exists()
        raw = _File(file, mode.replace("b", "").replace("t", ""))
        raw.recording, raw.name_below = recording, name
        recording.opened(raw.fileno(), name, made=made, emptied="w" in mode and not made)
        if buffering == 0:
            return raw
        buffered = io.BufferedRandom(raw) if "+" in mode else io.BufferedWriter(raw)
        return buffered if "b" in mode else io.TextIOWrapper(buffered, *args, **kwargs)

    return opening


def _os_open(recording: Recording, plain: Callable[..., int]) -> Callable[..., int]:
    def opening(path: Any, flags: int, *args: Any, **kwargs: Any) -> int:
        name, made = recording.name_of(path), not Path(path).exists()
        descriptor = plain(path, flags, *args, **kwargs)
        recording.opened(descriptor, name, made=made, emptied=bool(flags & os.O_TRUNC))
        return descriptor

    return opening


def _os_write(recording: Recording, plain: Callable[..., int]) -> Callable[..., int]:
    def write(descriptor: int, content: bytes) -> int:
        at = os.lseek(descriptor, 0, os.SEEK_CUR) if recording.name_of(descriptor) else 0
        n = plain(descriptor, content)
        if (name := recording.name_of(descriptor)) is not None:
            recording.add("write", name, at=at, content=bytes(content[:n]))
        return n

    return write


def _noting(kind: str) -> Callable[[Recording, Callable[..., Any]], Callable[..., Any]]:
    def wrap(recording: Recording, plain: Callable[..., Any]) -> Callable[..., Any]:
        def call(path: Any, *args: Any, **kwargs: Any) -> Any:
            if kwargs.get("dir_fd") is not None or kwargs.get("src_dir_fd") is not None:
                raise AssertionError(f"{kind} of {path} relative to a folder is not recorded")
            value = plain(path, *args, **kwargs)
            if (name := recording.name_of(path)) is None:
                return value
            if kind == "rename":
                recording.add(kind, name, to=recording.name_of(args[0]) or "")
            elif kind == "truncate":
                recording.add(kind, name, at=args[0])
            elif kind == "allocate":
                recording.add(kind, name, at=sum(args))
            elif kind == "wait":
                recording.add("wait for names" if (recording.root / name).is_dir() else "wait", name)
            else:
                recording.add(kind, name)
            return value

        return call

    return wrap


_WRAPPED = {
    "open": _os_open,
    "write": _os_write,
    "mkdir": _noting("make folder"),
    "rename": _noting("rename"),
    "replace": _noting("rename"),
    "unlink": _noting("remove"),
    "remove": _noting("remove"),
    "rmdir": _noting("remove"),
    "truncate": _noting("truncate"),
    "ftruncate": _noting("truncate"),
    "posix_fallocate": _noting("allocate"),
    "fsync": _noting("wait"),
}


# ------------------------------------------------------------------------------------------------------------ the disk


@dataclass
class _Content:
    """A file: its bytes on the disk, those that are seen, and the operations between the two."""

    on_disk: bytes = b""
    seen: bytearray = field(default_factory=bytearray)
    since: list[Operation] = field(default_factory=list[Operation])


@dataclass
class _Folder:
    """A folder: the names on the disk, those that are seen, and the changes between the two."""

    on_disk: dict[str, Any] = field(default_factory=dict[str, Any])
    seen: dict[str, Any] = field(default_factory=dict[str, Any])
    since: list[dict[str, Any]] = field(default_factory=list[dict[str, Any]])


class Disk:
    """A disk after some operations."""

    def __init__(self) -> None:
        self.root = _Folder()

    def apply(self, operation: Operation) -> None:
        """Carry out an operation."""
        folder, name = self._place(operation.path)
        match operation.kind:
            case "make":
                self._change(folder, {**folder.seen, name: _Content()})
            case "make folder":
                self._change(folder, {**folder.seen, name: _Folder()})
            case "remove":
                self._change(folder, {k: v for k, v in folder.seen.items() if k != name})
            case "rename":
                target, new = self._place(operation.to)
                assert target is folder, "the program renames within a folder only"
                rest = {k: v for k, v in folder.seen.items() if k != name}
                self._change(folder, {**rest, new: folder.seen[name]})
            case "wait for names":
                of = folder.seen[name] if name else folder
                of.on_disk, of.since = of.seen, []
            case "wait":
                content = folder.seen[name]
                content.on_disk, content.since = bytes(content.seen), []
            case _:
                content = folder.seen[name]
                _carry_out(content.seen, operation)
                content.since.append(operation)

    def left_after_cut(self, cut: str, rng: random.Random) -> dict[str, bytes | None]:
        """Return the files that are there after a cut, by path; None for a folder."""
        return dict(_left(self.root, "", cut, rng))

    def _place(self, path: str) -> tuple[Any, str]:
        *folders, name = path.split("/") if path != "." else [""]
        found = self.root
        for part in folders:
            found = found.seen[part]
        return found, name

    def _change(self, folder: _Folder, names: dict[str, Any]) -> None:
        folder.seen = names
        folder.since.append(names)


def _carry_out(content: bytearray, operation: Operation) -> None:
    end = operation.at + len(operation.content)
    if operation.kind == "truncate":
        del content[operation.at :]
    if len(content) < end:
        content.extend(bytes(end - len(content)))
    if operation.kind == "write":
        content[operation.at : end] = operation.content


def _left(folder: _Folder, path: str, cut: str, rng: random.Random) -> Iterator[tuple[str, bytes | None]]:
    names = folder.on_disk
    if folder.since:
        states = [folder.on_disk, *folder.since]
        names = states[{"nothing more": 0, "all": -1}.get(cut, rng.randrange(len(states)))]
    for name, what in names.items():
        if isinstance(what, _Folder):
            yield f"{path}{name}", None
            yield from _left(what, f"{path}{name}/", cut, rng)
        else:
            yield f"{path}{name}", _content_left(what, cut, rng)


def _content_left(content: _Content, cut: str, rng: random.Random) -> bytes:
    if cut == "nothing more":
        return content.on_disk
    if cut == "all":
        return bytes(content.seen)
    left = bytearray(content.on_disk)
    for operation in content.since:
        if operation.kind != "write":
            if rng.random() < 0.5:
                _carry_out(left, operation)
        elif cut == "sizes alone":
            if (n := operation.at + len(operation.content) - len(left)) > 0:
                left.extend(bytes(n))
        elif (choice := rng.randrange(3)) == 0:
            _carry_out(left, operation)
        elif choice == 1:
            for start in range(0, len(operation.content), SECTOR):
                if rng.random() < 0.5:
                    piece = operation.content[start : start + SECTOR]
                    _carry_out(left, Operation("write", operation.path, operation.at + start, piece))
    return bytes(left)


def write_out(left: dict[str, bytes | None], root: Path) -> None:
    """Write what a disk has into a fresh folder."""
    for name, content in left.items():
        if content is None:
            (root / name).mkdir(parents=True)
        else:
            (root / name).write_bytes(content)
