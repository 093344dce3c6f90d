"""Folder listings for the file dialog, in pages with previews, on separate threads, restricted to the roots.

The roots are the data folder, the home folder of the user that runs the program, and those given at the start. A path
is inside a root only if it is after its symbolic links are resolved, so a link cannot lead outside.
"""

from __future__ import annotations

import logging
import os
import shutil
import threading
from collections import OrderedDict
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import msgspec

from wafer_viewer.model.errors import DatasetError, parser_errors_as
from wafer_viewer.model.file_contents import DATASET_ENDING
from wafer_viewer.model.file_formats import READ
from wafer_viewer.model.image_formats import READ as IMAGE_ENDINGS
from wafer_viewer.session.core.commands import query
from wafer_viewer.session.session_restore import KEPT_IN

Order = Literal["date", "name", "size"]
KindName = Literal[
    "dataset", "images", "plan", "job", "certificate", "classes", "klarf", "inspected", "wafers", "surface", "study",
    "golden", "any",
]  # fmt: skip
PAGE = 200
"""Number of entries listed at first; more are listed on request."""
MOST_ENTRIES = 20_000
"""Maximum number of entries read from a folder, in disk order; typing a name still reaches the rest."""
MOST_COUNTED = 1000
COUNTED_FOLDERS = 60
"""Number of folders per page whose images are counted, up to `MOST_COUNTED` each."""
KEPT_LOOKS = 400
KEPT_RECENT = 6
RECENT = Path(KEPT_IN) / "recent.json"
log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class FileKind:
    """Kind of file that a dialog accepts: name endings, whether plain folders and several files can be chosen."""

    title: str
    endings: tuple[str, ...]
    takes_folder: bool = False
    several: bool = False


KLARF_ENDINGS = (".klarf", ".klf", ".kla", ".txt", *(f".{n:03d}" for n in range(10)))
FILE_KINDS: dict[KindName, FileKind] = {
    "dataset": FileKind("Datasets and surface files", (DATASET_ENDING, *READ)),
    "images": FileKind("Images and surface files", (*IMAGE_ENDINGS, *READ), takes_folder=True, several=True),
    "plan": FileKind("Plans", (".toml",)),
    "job": FileKind("Released jobs", (".toml",)),
    "certificate": FileKind("Certificates", (".toml", ".xml")),
    "classes": FileKind("Class tables", (".toml",)),
    "klarf": FileKind("KLARF files", KLARF_ENDINGS),
    "inspected": FileKind("Datasets and KLARF files", (DATASET_ENDING, *KLARF_ENDINGS)),
    "wafers": FileKind("Datasets", (DATASET_ENDING,), takes_folder=True),
    "surface": FileKind("Datasets and surface files", (DATASET_ENDING, *READ)),
    "golden": FileKind("Golden dies", (".golden.npz",)),
    "study": FileKind("Tables and folders of scans", (".csv",), takes_folder=True),
    "any": FileKind("All files", ("",)),
}
"""File kinds by name; recently chosen paths are stored under the same names."""


@dataclass(frozen=True, slots=True)
class Root:
    """Folder below which every path can be chosen, with its name on the page."""

    name: str
    path: Path


@dataclass(frozen=True, slots=True)
class FileEntry:
    """Entry of a folder. is_folder: opening it lists it. why_not: why it cannot be chosen, empty if it can."""

    path: Path
    kind: str
    is_folder: bool
    can_choose: bool
    size_bytes: int | None
    modified_s: float
    note: str = ""
    why_not: str = ""


@dataclass(frozen=True, slots=True)
class Listing:
    """Part of a folder listing.

    n_matching: number of entries that match the request; n_hidden: number of files of other kinds. completion: the
    longest path on which all entries with the typed prefix agree. parent is None in a root.
    """

    folder: Path
    parent: Path | None
    entries: tuple[FileEntry, ...]
    n_matching: int
    n_hidden: int
    is_cut: bool
    free_bytes: int
    completion: str
    recent: tuple[Path, ...]


class Browsing:
    """Folder listings and previews, from any thread; slow answers are futures.

    Parameters
    ----------
    data_folder : Path
        The folder of the datasets, the first root; recently chosen paths are stored in it.
    more : tuple of Path
        Other roots, as given on the command line.
    home : Path or None
        The user's home folder; None leaves it out.

    Raises
    ------
    DatasetError
        When one of `more` is not a folder.
    """

    def __init__(self, data_folder: Path, more: tuple[Path, ...] = (), home: Path | None = Path("~")) -> None:
        given = tuple(path.expanduser().absolute() for path in more)
        for path in given:
            if not path.is_dir():
                raise DatasetError(f"--browse {path} is not a folder: name one that is there.")
        home_folder = home.expanduser().absolute() if home is not None else None
        named = [("Data folder", data_folder.absolute()), ("Home", home_folder), *((path.name, path) for path in given)]
        roots = [Root(name or str(path), path) for name, path in named if path is not None and path.is_dir()]
        self.roots = tuple(root for n, root in enumerate(roots) if root.path not in {r.path for r in roots[:n]})
        self._recent_file = data_folder / RECENT
        self._writing = threading.Lock()
        self._looks: OrderedDict[tuple[Path, float], bytes] = OrderedDict()
        self._listing = ThreadPoolExecutor(2, thread_name_prefix="listing")
        self._looking = ThreadPoolExecutor(1, thread_name_prefix="previews")

    def close(self) -> None:
        """End the threads; queued requests are cancelled."""
        self._listing.shutdown(wait=False, cancel_futures=True)
        self._looking.shutdown(wait=False, cancel_futures=True)

    # --- what may be chosen

    @query
    def allowed(self, path: Path) -> bool:
        """Return whether a path is inside a root after its symbolic links are resolved.

        The folder of tokens, passwords and keys is in none.
        """
        try:
            real = Path(os.path.realpath(path))
        except OSError:
            return False
        if KEPT_IN in real.parts:
            return False
        return any(real.is_relative_to(os.path.realpath(root.path)) for root in self.roots)

    @query
    def path_of(self, text: str, folder: Path) -> Path:
        """Return the absolute path of a typed text, relative to the displayed `folder`; ~ is the home folder.

        Raises DatasetError if the text is empty or the path leads out of the roots.
        """
        if not text.strip():
            raise DatasetError("No path is given: type one, or choose from the list.")
        path = Path(os.path.normpath(folder / Path(text.strip()).expanduser()))
        if not self.allowed(path):
            names = ", ".join(str(root.path) for root in self.roots)
            raise DatasetError(
                f"{path} lies outside of the folders that this viewer may show ({names}): "
                f"copy it there, or start the viewer with --browse {path.parent}."
            )
        return path

    @query
    def existing(self, text: str, folder: Path) -> Path:
        """Return the path of a typed text. Raises DatasetError if nothing exists there."""
        path = self.path_of(text, folder)
        if not path.exists():
            raise DatasetError(f"{path} does not exist: check the path.")
        return path

    # --- folders

    @query
    def list_folder(
        self, folder: Path, kind: FileKind, *, prefix: str = "", order: Order = "date", limit: int = PAGE
    ) -> Future[Listing]:
        """List a folder: its subfolders first, then the matching files, the newest first.

        Parameters
        ----------
        folder : Path
            A folder inside a root.
        kind : FileKind
            The kind of files to list.
        prefix : str
            The beginning of the names to list; case is ignored.
        order : {"date", "name", "size"}
            Sort order of files; folders follow it as well, except for size.
        limit : int
            Maximum number of entries to return.

        Returns
        -------
        Future of Listing
            DatasetError if the folder is outside of the roots, does not exist or may not be read.
        """
        return self._listing.submit(self._list, folder, kind, prefix, order, limit)

    def _list(self, folder: Path, kind: FileKind, prefix: str, order: Order, limit: int) -> Listing:
        folder = self.existing(str(folder), folder)
        if not folder.is_dir():
            raise DatasetError(f"{folder} is not a folder: choose one that is.")
        every, is_cut = self._scan(folder, prefix)
        found = [entry for entry in (_entry(item, kind) for item in every) if entry is not None]
        found.sort(key=_key(order))
        some = tuple(_counted(found[:limit], kind))
        roots = {root.path for root in self.roots}
        parent = folder.parent if folder not in roots and self.allowed(folder.parent) else None
        return Listing(
            folder=folder,
            parent=parent,
            entries=some,
            n_matching=len(found),
            n_hidden=len(every) - len(found),
            is_cut=is_cut,
            free_bytes=shutil.disk_usage(folder).free,
            completion=_completion(folder, prefix, found),
            recent=self._recent(kind),
        )

    def _scan(self, folder: Path, prefix: str) -> tuple[list[os.DirEntry[str]], bool]:
        """Return the entries of a folder that may be shown, and whether the list was cut.

        Hidden files need a typed dot.
        """
        found: list[os.DirEntry[str]] = []
        try:
            with os.scandir(folder) as items:
                for item in items:
                    begins = item.name.casefold().startswith(prefix.casefold())
                    if not begins or (item.name.startswith(".") and not prefix.startswith(".")):
                        continue
                    linked_or_hidden = item.is_symlink() or item.name.startswith(".")
                    if linked_or_hidden and not (self.allowed(Path(item.path)) and Path(item.path).exists()):
                        continue
                    if len(found) == MOST_ENTRIES:
                        return found, True
                    found.append(item)
        except PermissionError:
            raise DatasetError(f"{folder} may not be read by this user: choose another folder.") from None
        except OSError as fault:
            raise DatasetError(f"{folder} cannot be listed ({fault.strerror}): choose another folder.") from fault
        return found, False

    # --- small pictures

    @query
    def look(self, path: Path) -> Future[bytes]:
        """Return a preview of a file as JPEG bytes; empty bytes if there is nothing to show."""
        return self._looking.submit(self._look, path)

    def _look(self, path: Path) -> bytes:
        from wafer_viewer.store.dataset.preview import preview

        if not self.allowed(path):
            return b""
        try:
            key = path, path.stat().st_mtime
        except OSError:
            return b""
        if key not in self._looks:
            self._looks[key] = preview(path)
            if len(self._looks) > KEPT_LOOKS:
                self._looks.popitem(last=False)
        self._looks.move_to_end(key)
        return self._looks[key]

    # --- recent files

    @query
    def remember(self, kind: KindName, path: Path) -> None:
        """Store a chosen path, so that it is offered first the next time."""
        from wafer_viewer.store.io.atomic_files import write_text

        with self._writing:
            recent = self._remembered()
            others = [other for other in recent.get(kind, []) if other != str(path)]
            recent[kind] = [str(path), *others][:KEPT_RECENT]
            try:
                self._recent_file.parent.mkdir(exist_ok=True)
                write_text(self._recent_file, msgspec.json.encode(recent).decode())
            except (DatasetError, OSError) as fault:
                log.warning("What was taken last is not remembered: %s", fault)

    def _remembered(self) -> dict[str, list[str]]:
        from wafer_viewer.store.io.guarded_reading import read_content

        with suppress(DatasetError), parser_errors_as(lambda _: DatasetError("The file cannot be read.")):
            return msgspec.json.decode(read_content(self._recent_file), type=dict[str, list[str]])
        return {}

    def _recent(self, kind: FileKind) -> tuple[Path, ...]:
        name = next((name for name, known in FILE_KINDS.items() if known is kind), None)
        paths = (Path(text) for text in self._remembered().get(name or "", ()))
        return tuple(path for path in paths if self.allowed(path) and path.exists())


def saved_as(browsing: Browsing, text: str, folder: Path, ending: str) -> Path:
    """Return the path of a file to be saved, with the ending added if the typed name has none.

    Raises DatasetError if the name is empty, the folder does not exist or is inside a dataset, or the path leads out of
    the roots.
    """
    if not text.strip():
        raise DatasetError("The file has no name: type one.")
    path = browsing.path_of(text, folder)
    if not path.parent.is_dir():
        raise DatasetError(f"The folder {path.parent} does not exist: choose one from the list.")
    if any(folder.name.endswith(DATASET_ENDING) for folder in path.parents):
        raise DatasetError(f"{path.parent} lies inside of a dataset, whose files are its own: choose another folder.")
    return path if path.name.lower().endswith(ending.lower()) else path.with_name(f"{path.name}{ending}")


def _entry(item: os.DirEntry[str], kind: FileKind) -> FileEntry | None:
    """Return a list entry; None for a file that does not match."""
    try:
        status, is_folder = item.stat(), item.is_dir()
    except OSError:
        return None
    path, ending = Path(item.path), Path(item.name).suffix.lower()
    fits = any(item.name.lower().endswith(one) for one in kind.endings)
    is_dataset = is_folder and ending == DATASET_ENDING
    if (is_dataset or not is_folder) and not fits:
        return None
    opens = is_folder and not is_dataset
    mode = os.R_OK | (os.X_OK if is_folder else 0)
    return FileEntry(
        path=path,
        kind="Dataset" if is_dataset else "Folder" if is_folder else kind_of(ending),
        is_folder=opens,
        can_choose=not opens or kind.takes_folder,
        size_bytes=None if is_folder else status.st_size,
        modified_s=status.st_mtime,
        why_not="" if os.access(path, mode) else "No permission to read",
    )


def kind_of(ending: str) -> str:
    """Return the display name of a file kind by its ending."""
    if ending in (".tif", ".tiff"):
        return "TIFF"
    if ending in IMAGE_ENDINGS:
        return f"{ending[1:].upper()} image"
    if ending in READ:
        return f"{ending[1:].upper()} surface"
    return ending[1:].upper() or "File"


def _key(order: Order) -> Callable[[FileEntry], tuple[bool, float, list[str | int]]]:
    from wafer_viewer.store.io.atomic_files import natural_sort_key

    def key(entry: FileEntry) -> tuple[bool, float, list[str | int]]:
        name = natural_sort_key(entry.path.name)
        if order == "name" or (order == "size" and entry.is_folder):
            return not entry.is_folder, 0.0, name
        value = entry.modified_s if order == "date" else float(entry.size_bytes or 0)
        return not entry.is_folder, -value, name

    return key


def _counted(entries: list[FileEntry], kind: FileKind) -> Iterator[FileEntry]:
    """Yield the entries; folders get the number of images in them if images are requested."""
    n_remaining = COUNTED_FOLDERS if kind is FILE_KINDS["images"] else 0
    for entry in entries:
        if entry.is_folder and n_remaining and not entry.why_not:
            n_remaining -= 1
            yield replace(entry, note=_n_images(entry.path))
        else:
            yield entry


def _n_images(folder: Path) -> str:
    n = 0
    try:
        with os.scandir(folder) as items:
            for n_checked, item in enumerate(items):
                n += item.name.lower().endswith(IMAGE_ENDINGS) and not item.name.startswith(".")
                if n_checked == MOST_COUNTED:
                    return f"over {n} images" if n else ""
    except OSError:
        return ""
    return "" if n == 0 else f"{n} image{'' if n == 1 else 's'}"


def _completion(folder: Path, prefix: str, entries: list[FileEntry]) -> str:
    """Return the common beginning of all names, as completion of the typed text.

    A single folder ends with a separator.
    """
    if not prefix or not entries:
        return ""
    names = [entry.path.name for entry in entries]
    common = os.path.commonprefix(names)  # noqa: RUF071 - of names, letter by letter
    completed = str(folder / common) if common.casefold().startswith(prefix.casefold()) else ""
    return completed + os.sep if completed and len(entries) == 1 and entries[0].is_folder else completed
