"""Manifests: SHA-256 of every file of a scan or of a result that a number depends on, signed.

A CRC tells damage; whoever changes a file can give it the right one. ``manifest.json`` of a dataset has the digests of
``scan.json``, the flat field and the journal as far as it was written when the scan was left. That of a result has
those of the recipe, surfaces, poses and mosaic, taken when the surface is complete, and of the records beside them,
such as measurements and the verdict, each taken when it is saved. It names the scan and the result, so that files of
another one do not pass, and is signed with the key of the data folder. A mark beside the key tells that there is a
manifest. It also has how many records each signed log of the data folder held, so that a removed log is noticed.

What it cannot prove: files that are replaced together with their manifest by an older state of both are valid, a
manifest that is removed with its mark was never there, and who has the key can sign anything.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import ClassVar, TypeVar

import msgspec

from wafer_viewer.model.errors import DatasetError, WaferViewerError
from wafer_viewer.model.spec import Spec, encode, replace
from wafer_viewer.store.io.atomic_files import files_below, make_folder, remove, write_text
from wafer_viewer.store.io.checksums import (
    SURFACES,
    FileMark,
    file_mark,
    load_json,
    remedy,
    save_json,
    sealed_text,
    strip_checksum,
)
from wafer_viewer.store.io.file_lock import locked
from wafer_viewer.store.io.format_version import raise_schema
from wafer_viewer.store.records.signed_log import (
    KEPT_IN,
    KEY_FILE,
    KNOWN_KEYS,
    is_signed,
    log_lengths,
    public_key,
    signing_key,
    trusted_keys,
)

A = TypeVar("A")
B = TypeVar("B")
S = TypeVar("S", bound=Spec)
MANIFEST = "manifest.json"
MARKS, LOCK = "manifests", "manifests.lock"
SCAN_FILES = ("scan.json", "flat-field.json", "journal.jsonl")
JOURNAL = "journal.jsonl"
MADE = ("recipe.json", "settled.json", "poses.npz", SURFACES, "mosaic.zarr")
"""Files and folders of a result that are made together."""
RECORDS = ("findings.json", "defects.json", "verdict.json", "notebook.json", "comparison.json", "surface.json")
"""Files of a result that are saved one by one."""
DERIVED = "surface.json"
"""Record that is made again when it is missing or not as it was saved."""
_MOST_THREADS = 8
_THREADS_FROM_BYTES = 1 << 26
"""Bytes to hash from which threads are worth it: a tenth of a second on one core."""
_PIECE_BYTES = 1 << 20
_VERSION_KEY = b'"schema_version"'


class Covered(Spec, frozen=True, kw_only=True, omit_defaults=True):
    """Contents of a file that a manifest covers.

    sha256: hex; n_bytes: size; mtime_ns: when it was written, to take over digests of files that did not change since;
    before: sha256 of the content that a save is about to replace, empty between saves.
    """

    error: ClassVar[type[WaferViewerError]] = DatasetError
    sha256: str
    n_bytes: int
    mtime_ns: int = 0
    before: str = ""


class Manifest(Spec, frozen=True, kw_only=True):
    """Files of a scan or of a result by their paths in it, signed.

    of: name of the result, empty for the scan; scan: SHA-256 of the record of the scan; complete: whether everything
    that is made together is covered; logs: least number of records of each signed log of the data folder; key,
    signature: hex, empty in a folder where no key can be kept.
    """

    error: ClassVar[type[WaferViewerError]] = DatasetError
    of: str
    scan: str
    complete: bool
    files: dict[str, Covered]
    logs: dict[str, int] = msgspec.field(default_factory=dict[str, int])
    key: str
    signature: str


@dataclass(frozen=True, slots=True)
class _Place:
    """Folder with a manifest: that of a result, or of a dataset."""

    folder: Path

    @property
    def dataset(self) -> Path:
        return self.folder.parents[1] if self.folder.parent.name == "results" else self.folder

    @property
    def of(self) -> str:
        return "" if self.dataset == self.folder else self.folder.name

    @property
    def data_folder(self) -> Path:
        return self.dataset.absolute().parent

    @property
    def path(self) -> Path:
        return self.folder / MANIFEST

    @property
    def mark(self) -> Path:
        return _marks(self.dataset) / (self.of or "scan.json")

    @property
    def is_of_dataset(self) -> bool:
        return (self.dataset / "scan.json").is_file()

    def read(self) -> Manifest | None:
        """Return the manifest, None if there is none. Raises DatasetError when it is missing or was altered."""
        if self.path.is_file():
            found = _signed(file_mark(self.path))
            if found.of != self.of or found.scan != _scan_digest(file_mark(self.dataset / "scan.json")):
                raise self.altered(f"it is of another scan or result than {self.folder}")
            return found
        if self.mark.exists():
            raise self.altered("it is missing")
        return None

    def present(self) -> Manifest:
        """Return the manifest to be changed, a new one if there is none and no record needs it."""
        if not self.path.is_file() and not any((self.folder / name).is_file() for name in RECORDS):
            return self.new()
        found = self.read()
        return self.new() if found is None else replace(found, logs=self.logs_of(found))

    def logs_of(self, manifest: Manifest | None) -> dict[str, int]:
        """Return the logs that a manifest names, none of those of another folder, from which the dataset was copied."""
        return manifest.logs if manifest is not None and self.mark.exists() else {}

    def require_trusted(self, manifest: Manifest) -> None:
        """Raise DatasetError for a manifest that is not signed with a key of the data folder, though it was once.

        One without a mark is of another folder, from which the dataset was copied.
        """
        trusted = trusted_keys(self.data_folder) if self.mark.exists() else frozenset[str]()
        if trusted and manifest.key not in trusted:
            raise DatasetError(
                f"{self.path} is signed with the key {manifest.key or '(none)'}, which is not the key of this folder: "
                f"if you trust it, write it into {self.data_folder / KNOWN_KEYS}; else restore the dataset from a copy."
            )

    def altered(self, why: str) -> DatasetError:
        return DatasetError(
            f"{self.path} was altered: {why}: restore it from a copy; if you trust the files as they are, remove it "
            f"and {self.mark}."
        )

    def write(self, manifest: Manifest) -> None:
        """Sign and write a manifest, with the logs as long as they are now, or once were."""
        raise_schema(self.dataset)
        once, now = manifest.logs, log_lengths(self.data_folder)
        logs = {name: max(once.get(name, 0), now.get(name, 0)) for name in sorted(once.keys() | now.keys())}
        manifest = replace(manifest, logs=logs)
        key, signature = _signature(self.data_folder, _signed_bytes(manifest))
        save_json(self.path, replace(manifest, key=key, signature=signature))
        if key and not self.mark.exists() and not self.dataset.name.startswith("."):
            make_folder(self.mark.parent)
            write_text(self.mark, "")

    def new(self) -> Manifest:
        """Return a manifest of the records that there are."""
        scan = _scan_digest(file_mark(self.dataset / "scan.json"))
        there = {name: _covered(self.folder / name) for name in RECORDS if (self.folder / name).is_file()}
        return Manifest(of=self.of, scan=scan, complete=False, files=there if self.of else {}, key="", signature="")


# -------------------------------------------------------------------------------------------------------------- signing


def sign_scan(dataset: Path) -> None:
    """Write the manifest of a scan.

    Raises DatasetError when the scan was altered since the manifest before, or it cannot be written.
    """
    place = _Place(dataset)
    with _locked(place):
        before = place.read()
        if before is not None:
            place.require_trusted(before)
            for _, fault in _deviations(place, before):
                raise DatasetError(fault)
        files = {name: _covered(dataset / name) for name in SCAN_FILES if (dataset / name).is_file()}
        if before is None or before.files != files:
            place.write(replace(place.new(), complete=True, files=files, logs=place.logs_of(before)))


def sign_result(result: Path, *, fresh: bool = False) -> None:
    """Write the manifest of a complete result; digests of files that did not change are taken over.

    fresh: the folder is new as a whole, and a manifest of an earlier one does not count. Raises DatasetError when the
    manifest before was altered, or it cannot be written.
    """
    place = _Place(result)
    if not place.is_of_dataset:
        return
    names = list(_made(result))
    if fresh:
        remove(place.path)
        remove(place.mark)
    with _locked(place):
        before = place.present()
        if place.path.is_file():
            place.require_trusted(before)
    known = before.files if before.complete else {}
    n_bytes = sum((result / name).stat().st_size for name in names)
    made = dict(zip(names, _mapped(lambda name: _covered(result / name, known.get(name)), names, n_bytes), strict=True))
    with _locked(place):
        now = place.present()
        records = {name: covered for name, covered in now.files.items() if name in RECORDS}
        if not (now.complete and now.files == {**made, **records} and now.signature):
            place.write(replace(now, complete=True, files={**made, **records}))


def save_record(path: Path, spec: Spec, *, anew: bool = False) -> None:
    """Save a record of a result with its checksum, atomically, and its digest in the manifest of the result.

    anew: it was made without the record that it replaces. Raises DatasetError when the manifest was altered, or the
    record that is replaced and not made anew.
    """
    text = sealed_text(encode(spec, "json"))
    with _noted(path, text.encode(), anew=anew):
        write_text(path, text)


def save_record_text(path: Path, text: str) -> None:
    """Save a record that is a JSON text with its checksum and was made anew, as `save_record` does."""
    with _noted(path, text.encode(), anew=True):
        write_text(path, text)


@contextmanager
def _noted(path: Path, content: bytes, *, anew: bool) -> Generator[None]:
    """Note in a manifest the digest of a record that is written meanwhile."""
    place = _Place(path.parent)
    if not (place.of and place.is_of_dataset):
        yield
        return
    with _locked(place):
        now = place.present()
        if place.path.is_file():
            place.require_trusted(now)
        old = now.files.get(path.name)
        new = Covered(sha256=hashlib.sha256(content).hexdigest(), n_bytes=len(content))
        if old is not None and path.is_file():
            if not anew:
                _require_covered(place, path, old)
            there = _sha256(path)
            before = there if there in (old.sha256, old.before) else old.sha256
            place.write(_with(now, path.name, replace(new, before=before)))
        else:
            place.write(_with(now, path.name, new))
        yield
        if old is not None:
            place.write(_with(now, path.name, new))


def _with(manifest: Manifest, name: str, covered: Covered) -> Manifest:
    return replace(manifest, files={**manifest.files, name: covered})


def _marks(dataset: Path) -> Path:
    """Return the folder of the marks of a dataset, beside the key."""
    return dataset.absolute().parent / KEPT_IN / MARKS / dataset.name


def forget_marks(dataset: Path) -> None:
    """Remove the marks of a dataset of that name that is there no more."""
    remove(_marks(dataset))


# ------------------------------------------------------------------------------------------------------------ verifying


def load_record(path: Path, kind: type[S], *, trusted: bool = False) -> S:
    """Read a record of a result. Raises DatasetError when it is damaged, or not the one that was saved.

    trusted: the manifest must also be signed with a key that the data folder trusts, if it ever was.
    """
    record = load_json(path, kind)
    require_as_saved(path, trusted=trusted)
    return record


def require_as_saved(path: Path, *, trusted: bool = False) -> None:
    """Raise DatasetError when a record of a result is not the one that was saved, as far as there is a manifest."""
    place = _Place(path.parent)
    if not (place.of and place.is_of_dataset) or (manifest := place.read()) is None:
        return
    if trusted:
        place.require_trusted(manifest)
    _require_covered(place, path, manifest.files.get(path.name))


def _require_covered(place: _Place, path: Path, covered: Covered | None) -> None:
    if covered is None:
        raise DatasetError(f"{path} was added: {place.path} does not list it: {remedy(path)}.")
    if _sha256(path) not in (covered.sha256, covered.before):
        raise DatasetError(_differs(place, path))


def deviations(dataset: Path) -> Iterator[tuple[Path, tuple[str, ...]]]:
    """Yield each manifest of a dataset, with a sentence for each file that is not as it was signed.

    Files that are damaged by their own checksum are among them.
    """
    folders = [dataset, *sorted(p for p in (dataset / "results").glob("*") if p.is_dir() and p.name[0] != ".")]
    for place in map(_Place, folders):
        try:
            manifest = place.read() if place.is_of_dataset else None
        except DatasetError as fault:
            yield place.path, (str(fault),)
            continue
        if manifest is not None:
            yield place.path, tuple(_faults(place, manifest))


def keys_of(dataset: Path) -> tuple[str, ...]:
    """Return the public keys, hex, that the manifests of a dataset are signed with; unreadable ones are left out."""
    keys: list[str] = []
    for path in (dataset / MANIFEST, *sorted(dataset.glob(f"results/*/{MANIFEST}"))):
        with suppress(DatasetError):
            keys += [load_json(path, Manifest).key] if path.is_file() else []
    return tuple(keys)


def least_log_lengths(dataset: Path) -> dict[str, int]:
    """Return how many records each log of the data folder has at least, by the manifests that were signed in it."""
    least: dict[str, int] = {}
    for place in map(_Place, (dataset, *sorted((dataset / "results").glob("*")))):
        with suppress(DatasetError):
            if place.mark.exists() and (manifest := place.read()) is not None:
                place.require_trusted(manifest)
                for name, n in manifest.logs.items():
                    least[name] = max(n, least.get(name, 0))
    return least


def without_manifest(dataset: Path) -> int:
    """Return the number of results that have none."""
    return sum(p.is_dir() and p.name[0] != "." and not (p / MANIFEST).exists() for p in (dataset / "results").glob("*"))


def _faults(place: _Place, manifest: Manifest) -> Iterator[str]:
    try:
        place.require_trusted(manifest)
    except DatasetError as fault:
        yield str(fault)
    yield from (fault for _, fault in _deviations(place, manifest))


def _deviations(place: _Place, manifest: Manifest) -> Iterator[tuple[str, str]]:
    """Yield path and sentence of each file that is not as the manifest has it, and of those that it does not list."""
    there = set(_made(place.folder)) if place.of and manifest.complete else set[str]()
    there |= {name for name in RECORDS if place.of and (place.folder / name).is_file()}
    listed = list(manifest.files.items())
    states = _mapped(lambda item: _state(place, *item), listed, sum(covered.n_bytes for _, covered in listed))
    yield from ((name, fault) for (name, _), fault in zip(listed, states, strict=True) if fault)
    for name in sorted(there - manifest.files.keys()):
        path = place.folder / name
        yield name, f"{path} was added: {place.path} does not list it: {remedy(path)}."


def _state(place: _Place, name: str, covered: Covered) -> str:
    """Return what is wrong with a file, an empty text if nothing is."""
    path = place.folder / name
    if not path.is_file():
        return "" if name == DERIVED else f"{path} is missing, and {place.path} lists it: {remedy(path)}."
    if name == JOURNAL and path.stat().st_size < covered.n_bytes:
        return f"{path} was altered: lines at its end were removed: {remedy(path)}."
    found = _sha256(path, covered.n_bytes) if name == JOURNAL else _sha256(path)
    return "" if found in (covered.sha256, covered.before) else _differs(place, path)


def _differs(place: _Place, path: Path) -> str:
    return (
        f"{path} was altered, or made again and not completed: {place.path} has another digest of it: {remedy(path)}."
    )


# ---------------------------------------------------------------------------------------------------------------- parts


def _made(result: Path) -> Iterator[str]:
    """Yield the files that are made together, by their paths in a result."""
    for name in MADE:
        path = result / name
        found = sorted(files_below(path)) if path.is_dir() else [path] if path.is_file() else []
        for file in found:
            parts = file.parts[len(result.parts) :]
            if not any(part.startswith(".") for part in parts):
                yield "/".join(parts)


def _mapped(function: Callable[[A], B], items: Sequence[A], n_bytes: int) -> Iterator[B]:
    """Yield a function of each item, in threads if they read so many bytes that these pay."""
    if n_bytes < _THREADS_FROM_BYTES:
        yield from map(function, items)
        return
    with ThreadPoolExecutor(min(_MOST_THREADS, os.cpu_count() or 1)) as threads:
        yield from threads.map(function, items)


def _covered(path: Path, known: Covered | None = None) -> Covered:
    """Return the digest of a file; that which is known if neither its size nor its time changed."""
    stat = path.stat()
    if known is not None and (known.n_bytes, known.mtime_ns) == (stat.st_size, stat.st_mtime_ns):
        return known
    return Covered(sha256=_sha256(path, stat.st_size), n_bytes=stat.st_size, mtime_ns=stat.st_mtime_ns)


def _sha256(path: Path, n_bytes: int | None = None) -> str:
    """Return the SHA-256 of a file or its first bytes; of a scan's record that which compression does not change."""
    if path.name == "scan.json":
        return _scan_digest(file_mark(path))
    digest, left = hashlib.sha256(), n_bytes
    with path.open("rb") as file:
        while piece := file.read(_PIECE_BYTES if left is None else min(_PIECE_BYTES, left)):
            digest.update(piece)
            left = None if left is None else left - len(piece)
    return digest.hexdigest()


@lru_cache(maxsize=16)
def _scan_digest(mark: FileMark) -> str:
    """Return the digest of the record of a scan without its checksum and its format version, which compression sets."""
    text = strip_checksum(mark[0].read_bytes())
    at = text.find(_VERSION_KEY)
    end = text.find(b",", at)
    return hashlib.sha256(text[:at] + text[end:] if at >= 0 else text).hexdigest()


@lru_cache(maxsize=64)
def _signed(mark: FileMark) -> Manifest:
    """Return a manifest in a state of its file. Raises DatasetError when its signature does not fit."""
    manifest = load_json(mark[0], Manifest)
    if manifest.signature and not is_signed(_signed_bytes(manifest), manifest.key, manifest.signature):
        raise _Place(mark[0].parent).altered("its signature does not fit its contents")
    return manifest


def _signed_bytes(manifest: Manifest) -> bytes:
    files, logs = sorted(manifest.files.items()), sorted(manifest.logs.items())
    parts = (MANIFEST, manifest.of, manifest.scan, manifest.complete, files)
    return msgspec.json.encode((*parts, logs) if logs else parts)


def _signature(data_folder: Path, content: bytes) -> tuple[str, str]:
    """Return public key and signature, hex; empty texts where there is no key and none can be kept."""
    try:
        key = signing_key(data_folder)
    except DatasetError:
        if (data_folder / KEPT_IN / KEY_FILE).exists():
            raise
        return "", ""
    return public_key(key), key.sign(content).hex()


@contextmanager
def _locked(place: _Place) -> Generator[None]:
    """Keep other processes from changing manifests of the data folder, where anything can be kept in it."""
    with ExitStack() as held:
        kept_in = place.data_folder / KEPT_IN
        with suppress(DatasetError):
            make_folder(kept_in)
        if os.access(kept_in, os.W_OK):
            held.enter_context(locked(kept_in / LOCK))
        yield
