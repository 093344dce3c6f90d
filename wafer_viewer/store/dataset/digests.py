"""Digests that identify a dataset: SHA-256 over the files that its numbers come from; a copy has the same."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

from wafer_viewer.store.dataset.result import FINDINGS, MOSAIC, POSES, SURFACES, Result
from wafer_viewer.store.dataset.scan_record import JOURNAL
from wafer_viewer.store.io.atomic_files import natural_sort_key, size

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
    found = ((what, of, [file for place in places for file in _files(place)]) for what, of, places in sets)
    return tuple(_digest(what, of, path, files) for what, of, files in found if files)


def _files(place: Path) -> list[Path]:
    """Return a file, or all files in a folder in natural order of their names."""
    if place.is_dir():
        return sorted(
            (path for path in place.rglob("*") if path.is_file()), key=lambda path: natural_sort_key(str(path))
        )
    return [place] if place.exists() else []


def _digest(what: str, of: str, folder: Path, files: list[Path]) -> Digest:
    """Return the digest over names, sizes and contents, in order."""
    sizes = [path.stat().st_size for path in files]
    too_large = sum(sizes) > MOST_BYTES
    digest = hashlib.sha256()
    for path, n_bytes in zip(files, sizes, strict=True):
        digest.update(f"{path.relative_to(folder).as_posix()}\n{n_bytes}\n".encode())
        if not too_large:
            _add(digest, path)
    told = f"{of}; names and sizes alone, because they are {size(sum(sizes))}" if too_large else of
    return Digest(what, told, digest.hexdigest())


def _add(digest: hashlib._Hash, path: Path) -> None:
    with path.open("rb") as file:
        while piece := file.read(PIECE):
            digest.update(piece)
