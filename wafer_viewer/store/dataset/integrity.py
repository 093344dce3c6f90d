"""Integrity of a dataset: the checksum of every file, and the digests that identify it.

Frames are verified by `Dataset.check`, which compares them with the journal. A file of a kind that is not listed here
is reported as unknown, so that a new kind of file cannot go unchecked unnoticed.
"""

from __future__ import annotations

import hashlib
import re
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.progress import Progress, ShouldStop, with_progress
from wafer_viewer.store.dataset.frame_lines import INDEX
from wafer_viewer.store.dataset.result import DRAWING, FINDINGS, MOSAIC, POSES, SURFACES, Result
from wafer_viewer.store.dataset.scan_record import FRAMES, JOURNAL, JournalReader
from wafer_viewer.store.io.atomic_files import files_below, natural_sort_key, size
from wafer_viewer.store.io.checksums import (
    Checksum,
    archive_state,
    damaged,
    line_state,
    remedy,
    require_json,
    text_state,
)
from wafer_viewer.store.io.file_lock import ANNOUNCEMENT
from wafer_viewer.store.io.format_version import with_version
from wafer_viewer.store.mosaic import zarr_shards
from wafer_viewer.store.mosaic.missing_shards import missing, missing_files
from wafer_viewer.store.mosaic.statistics import facts_state
from wafer_viewer.store.mosaic.zarr_mosaic import ZarrMosaic
from wafer_viewer.store.mosaic.zarr_shards import Shards
from wafer_viewer.store.records.manifest import MANIFEST, deviations, without_manifest

Examine = Callable[[Path], Checksum]
UNKNOWN = "Unknown files"
STITCHED = "Stitched surfaces"
MANIFESTS = "Manifests"


@dataclass(frozen=True, slots=True)
class FileRole:
    """Kind of file: title, path pattern in a dataset folder, and checksum test."""

    title: str
    pattern: re.Pattern[str]
    examine: Examine | None
    """None if no number depends on the files, or another check covers them."""


@dataclass(frozen=True, slots=True)
class KindReport:
    """Files of one kind by the state of their checksum; damaged: one sentence per file, with the remedy."""

    title: str
    n_good: int
    n_without: int
    damaged: tuple[str, ...]


def check_files(
    dataset: Path, progress: Progress | None = None, should_stop: ShouldStop | None = None
) -> tuple[KindReport, ...]:
    """Verify the checksums of all files of a dataset except its frames.

    Parameters
    ----------
    dataset
        The folder ``NAME.wafer``; its contents may be unreadable.
    progress, should_stop
        Called with the completed fraction, and polled for a stop request.

    Returns
    -------
    tuple of KindReport
        In the order of `KINDS`, without kinds that have no files; unknown files last.

    Raises
    ------
    DatasetError
        When the folder does not exist or the work is stopped.
    """
    if not dataset.is_dir():
        raise DatasetError(f"{dataset} does not exist: check the path.")
    files = sorted(files_below(dataset), key=lambda path: natural_sort_key(str(path)))
    states: dict[str, list[Checksum | str]] = defaultdict(list)
    for path in with_progress(files, len(files), "The check", progress, should_stop):
        kind = kind_of(path.relative_to(dataset).as_posix())
        if kind is None:
            states[UNKNOWN].append(Checksum.NONE)
        elif kind.examine is not None:
            states[kind.title].append(_state(path, kind.examine))
    for mosaic in sorted(dataset.glob("results/*/mosaic.zarr")):
        states[STITCHED] += _missing(mosaic)
    for _, faults in deviations(dataset):
        states[MANIFESTS] += faults or (Checksum.GOOD,)
    states[MANIFESTS] += [Checksum.NONE] * without_manifest(dataset)
    order = [*dict.fromkeys(kind.title for kind in KINDS), UNKNOWN]
    return tuple(_report(title, states[title]) for title in order if states.get(title))


def kind_of(path: str) -> FileRole | None:
    """Return the kind of a file by its path in the dataset folder, None if unknown."""
    return next((kind for kind in KINDS if kind.pattern.fullmatch(path)), None)


def is_mosaic_good(mosaic: Path) -> bool:
    """Return whether no file of a mosaic is damaged; all of them are read."""
    prefix = f"results/x/{mosaic.name}"
    for path in files_below(mosaic):
        kind = kind_of(f"{prefix}/{path.relative_to(mosaic).as_posix()}")
        if kind is not None and kind.examine is not None and isinstance(_state(path, kind.examine), str):
            return False
    return not _missing(mosaic)


def _missing(mosaic: Path) -> list[Checksum | str]:
    """Return one sentence for each deleted file of a mosaic; none while a mosaic is incomplete."""
    if (mosaic.parent / DRAWING).exists():
        return []
    try:
        return [str(missing(path)) for path in dict.fromkeys(missing_files(ZarrMosaic.open(mosaic)))]
    except DatasetError:
        return []  # the damaged file is reported separately


def _report(title: str, states: list[Checksum | str]) -> KindReport:
    faults = tuple(state for state in states if isinstance(state, str))
    return KindReport(title, states.count(Checksum.GOOD), states.count(Checksum.NONE), faults)


def _state(path: Path, examine: Examine) -> Checksum | str:
    """Return the state of a checksum, or for a damaged file the sentence with its path and remedy."""
    try:
        state = examine(path)
    except DatasetError as fault:
        return str(fault)
    except OSError as fault:
        return f"{path} cannot be read: {fault.strerror}."
    return str(damaged(path)) if state is Checksum.DAMAGED else state


def _json_state(path: Path) -> Checksum:
    content = path.read_bytes()
    state = text_state(content)
    if state is not Checksum.DAMAGED:
        require_json(content, str(path))
    return state


def _journal_state(path: Path) -> Checksum:
    """Return GOOD only if every line has a checksum and the last line is complete."""
    content, reader = path.read_bytes(), JournalReader(path)
    *lines, rest = content.split(b"\n")
    for number, line in enumerate(lines, 1):
        try:
            _require_good_line(path, number, line)
        except DatasetError:
            if number < len(lines) and _is_ignored(reader, number):
                raise DatasetError(
                    f"{path} has damaged lines from line {number} on, of a pass that never ended, which are ignored: "
                    "continue the scan."
                ) from None
            raise
    for _ in reader.new_lines():  # the digests of the passes
        pass
    if rest:
        raise DatasetError(f"{path} ends within a line, which is ignored: continue the scan, or {remedy(path)}.")
    return Checksum.NONE if any(line_state(line) is Checksum.NONE for line in lines) else Checksum.GOOD


def _require_good_line(path: Path, number: int, line: bytes) -> None:
    if line_state(line) is Checksum.DAMAGED:
        raise DatasetError(f"{path} is damaged in line {number}, its checksum differs: {remedy(path)}.")
    require_json(line, f"{path}, line {number},")


def _is_ignored(reader: JournalReader, number: int) -> bool:
    """Return whether a journal is read without its lines from a damaged one on."""
    try:
        return sum(1 for _ in reader.new_lines()) == number - 1
    except DatasetError:
        return False


def _shard_state(path: Path) -> Checksum:
    Shards(np.dtype(np.uint8), 0, zarr_shards.CHUNK, zarr_shards.SHARD).require_good(path)
    return Checksum.GOOD


def _kind(title: str, pattern: str, examine: Examine | None) -> FileRole:
    return FileRole(title, re.compile(pattern), examine)


_RESULT = r"results/[^/]+/"
KINDS = (
    _kind("Scan record", r"scan\.json", _json_state),
    _kind("Flat field", r"flat-field\.json", _json_state),
    _kind("Journal", re.escape(JOURNAL), _journal_state),
    _kind("Index of the journal", re.escape(INDEX), archive_state),
    _kind("Recipes", _RESULT + r"(recipe|settled)\.json", _json_state),
    _kind("Surfaces of fields", _RESULT + r"surfaces/[^/]+\.npz", archive_state),
    _kind("Poses", _RESULT + r"poses(-being-drawn)?\.npz", archive_state),
    _kind(STITCHED, _RESULT + r"mosaic\.zarr/(.+/)?zarr\.json", _json_state),
    _kind(STITCHED, _RESULT + r"mosaic\.zarr/facts/c/\d+/\d+/0", facts_state),
    _kind(STITCHED, _RESULT + r"mosaic\.zarr/\w+/\d+/c/\d+/\d+", _shard_state),
    _kind("Summaries of surfaces", _RESULT + r"surface\.json", _json_state),
    _kind("Results", _RESULT + r"(findings|defects|verdict|comparison)\.json", _json_state),
    _kind("Notebooks", _RESULT + r"notebook\.json", _json_state),
    _kind(MANIFESTS, rf"({_RESULT})?{re.escape(MANIFEST)}", None),  # compared with the files that they list
    _kind("Frames", rf"{FRAMES}/[^/]+\.tif", None),  # compared with the journal
    _kind("Pictures of results", _RESULT + r"thumbnails/\d+\.jpg", None),  # for viewing only, never measured
    _kind(
        "Lock", rf"lock({ANNOUNCEMENT})?", None
    ),  # names the process that writes; the lock of the operating system counts
    _kind("Left by a process that ended", r"(.+/)?\.[^/]+\.part(\.old)?(/.*)?", None),  # never read
)


SCAN, VERDICT, NOTEBOOK = "scan.json", "verdict.json", "notebook.json"
HELD = "the frames themselves are checked against the journal's crc32 of each by wafer-viewer check"
PIECE = 1 << 20
MOST_BYTES = 20e9
"""Size limit in bytes; of larger file sets only names and sizes are hashed, so that a report does not take minutes."""


@dataclass(frozen=True, slots=True)
class Digest:
    """SHA-256 of some files of a dataset, and a description of them."""

    what: str
    of: str
    sha256: str


def digests_of_scan(dataset: Path) -> tuple[Digest, ...]:
    """Return the digest of the record and the journal, which holds a checksum of every frame."""
    return (_digest("Frames", f"{SCAN} and {JOURNAL}; {HELD}", dataset, [dataset / SCAN, dataset / JOURNAL]),)


def digests_of_result(result: Result) -> tuple[Digest, ...]:
    """Return the digests of the surfaces, the results, the verdict and the judgements; missing files are omitted."""
    path, of_result = result.path, f"of result {result.name}"
    sets = (
        ("Fields", f"{SURFACES} {of_result}", [path / SURFACES]),
        ("Surface", f"{MOSAIC} and {POSES} {of_result}", [path / MOSAIC, path / POSES]),
        ("Results", FINDINGS, [path / FINDINGS]),
        ("Verdict", VERDICT, [path / VERDICT]),
        ("Judgements", NOTEBOOK, [path / NOTEBOOK]),
    )
    sets_of_files = ((what, of, [file for place in places for file in _files(place)]) for what, of, places in sets)
    return tuple(_digest(what, of, path, files) for what, of, files in sets_of_files if files)


def _files(place: Path) -> list[Path]:
    """Return a file, or all files in a folder in natural order of their names."""
    if place.is_dir():
        return sorted(files_below(place), key=lambda path: natural_sort_key(str(path)))
    return [place] if place.exists() else []


def _digest(what: str, subject: str, folder: Path, files: list[Path]) -> Digest:
    """Return the digest over names, sizes and contents, in order."""
    sizes = [path.stat().st_size for path in files]
    too_large = sum(sizes) > MOST_BYTES
    digest = hashlib.sha256()
    for path, n_bytes in zip(files, sizes, strict=True):
        digest.update(f"{path.relative_to(folder).as_posix()}\n{n_bytes}\n".encode())
        if not too_large:
            _add(digest, path)
    scope = f"{subject}; names and sizes alone, because they are {size(sum(sizes))}" if too_large else subject
    return Digest(what, scope, digest.hexdigest())


def _add(digest: hashlib._Hash, path: Path) -> None:
    """Add a file; the record with a fixed format version, which changes no number of the scan."""
    if path.name == SCAN:
        digest.update(with_version(path.read_bytes(), 1))
        return
    with path.open("rb") as file:
        while piece := file.read(PIECE):
            digest.update(piece)
