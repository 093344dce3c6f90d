"""What a dataset is known by: SHA-256 over the files that its numbers come from; a copy has the same."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from wafer_viewer.store.files import natural
from wafer_viewer.store.record import JOURNAL
from wafer_viewer.store.result import FINDINGS, MOSAIC, POSES, Result

SCAN, VERDICT, NOTEBOOK = "scan.json", "verdict.json", "notebook.json"
HELD = "the frames themselves are held against the journal's crc32 of each by wafer-viewer check"
PIECE = 1 << 20


@dataclass(frozen=True, slots=True)
class Digest:
    """SHA-256 of some files of a dataset, and which they are."""

    what: str
    of: str
    sha256: str


def digests_of_scan(dataset: Path) -> tuple[Digest, ...]:
    """Of the record and the journal, which holds a checksum of every frame."""
    return (_digest("Frames", f"{SCAN} and {JOURNAL}; {HELD}", dataset, [dataset / SCAN, dataset / JOURNAL]),)


def digests_of_result(result: Result) -> tuple[Digest, ...]:
    """Of the stitched surface, and of what was measured and thought of it; what is not there is left out."""
    surface = sorted((p for p in result.mosaic_path.rglob("*") if p.is_file()), key=lambda p: natural(str(p)))
    surface += [path for name in (POSES,) if (path := result.path / name).exists()]
    found = (
        [_digest("Surface", f"{MOSAIC} and {POSES} of result {result.name}", result.path, surface)] if surface else []
    )
    for what, name in (("Results", FINDINGS), ("Verdict", VERDICT), ("Judgements", NOTEBOOK)):
        if (path := result.path / name).exists():
            found.append(_digest(what, name, result.path, [path]))
    return tuple(found)


def _digest(what: str, of: str, folder: Path, files: Iterable[Path]) -> Digest:
    """Over names and contents, in order."""
    digest = hashlib.sha256()
    for path in files:
        digest.update(f"{path.relative_to(folder).as_posix()}\n{path.stat().st_size}\n".encode())
        with path.open("rb") as file:
            while piece := file.read(PIECE):
                digest.update(piece)
    return Digest(what, of, digest.hexdigest())
