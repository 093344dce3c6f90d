"""Dialogs that choose files: folders and files, shortcuts, a path field, and files uploaded by the browser.

The session lists folders and renders previews on its own threads; this module only shows its answers.
"""

from __future__ import annotations

import base64
import os
import shlex
import threading
from collections.abc import Callable
from concurrent.futures import Future
from datetime import datetime
from itertools import count
from pathlib import Path
from typing import Any, get_args

import viser
from markupsafe import Markup

from wafer_viewer.draw.number_format import format_time, number, size
from wafer_viewer.gui.dialogs.dialog import Confirm, Dialog, KeepOpen, confirm_overwrite
from wafer_viewer.gui.elements.elements import Elements, Html, Text, Upload
from wafer_viewer.gui.elements.step import C
from wafer_viewer.gui.incoming import MOST_UPLOAD_BYTES
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.page.uploads import save_upload
from wafer_viewer.gui.widgets import html
from wafer_viewer.model.errors import DatasetError, WaferViewerError
from wafer_viewer.session.files.file_browser import (
    FILE_KINDS,
    PAGE,
    FileEntry,
    FileKind,
    KindName,
    Listing,
    Order,
    Root,
    saved_as,
)

MOST_SHOWN = 2000
"""Largest number of rows; the rest is reached by typing the beginning of a name."""
MOST_LOOKS = 48
"""Largest number of previews requested per list."""
LOOKS_AT_ONCE = 8
"""Number of previews sent together, to reduce layout work in the browser."""
ORDERS: dict[Order, str] = {"name": "Name", "size": "Size", "date": "Changed"}
_FIELD_MARK = Html(Markup('<div class="wv-file-field"></div>'), padded=False)
_listings = count(1)


class FileDialog(Dialog[C]):
    """Dialog that chooses files from the list of a folder.

    Parameters
    ----------
    page, title, below, answer, own, contents
        As of a dialog; the contents are the list alone unless given.
    kind : KindName
        Kind of file to choose.
    rows : int
        Height of the list, in rows.
    saving : str
        Proposed name of a file to save, with its extension; empty if a file is opened.
    chosen : str
        Path that is chosen at first.
    """

    def __init__(
        self,
        page: Page,
        title: str,
        below: str,
        answer: Confirm,
        kind: KindName,
        own: C = None,
        contents: Callable[[Any], Elements] | None = None,
        *,
        rows: int = 8,
        saving: str = "",
        chosen: str = "",
    ) -> None:
        self._kind_name: KindName = kind
        self._browsing = page.session.browsing
        self._saving, self._ending, self._rows = bool(saving), Path(saving).suffix, rows
        self._folder = self._base = page.session.snapshot.data_folder
        self._order: Order = "date"
        self._limit, self._prefix, self._typing = PAGE, "", False
        self._listing_id = 0
        self._shown: Listing | None = None
        self._places = self._list = self._looks = self._status = Markup()
        self._sent: dict[str, Path] = {}
        self._expected = 1
        self._putting = threading.Lock()
        self._name = saving
        self.text = saving or chosen
        """Text of the field: a path, several of them in quotation marks, or the name of the file to save."""
        picks = {
            "file-mark": FileDialog._mark,
            "file-open": FileDialog._open,
            "file-go": lambda here, path: here._go_and_leave(Path(path)),
            "file-recent": FileDialog._take_recent,
            "file-parent": FileDialog._to_parent,
            "file-order": FileDialog._sort,
            "file-more": FileDialog._more,
            "file-too-large": FileDialog._refuse_upload,
        }
        super().__init__(page, title, below, answer, own, contents or FileDialog.files, picks)
        self.go(self._folder)

    def files(self) -> Elements:
        """Return the list with its shortcuts, and the field for the path."""
        hint = "On the machine that runs the viewer; Tab completes it"
        path = Text("Path", self.text, self._typed, hint)
        if self._saving:
            path = Text("File name", self.text, self._typed, "May begin with a folder")
        lists = Html(self._places), Html(self._list, padded=False), Html(self._looks, padded=False)
        return [*lists, _FIELD_MARK, path, Html(self._status)]

    def upload(self, mime_type: str = "*/*") -> Upload:
        """Return the button that uploads a file from the browser's computer."""
        return Upload("Send a file from this computer…", self._take_upload, viser.Icon.UPLOAD, mime_type)

    def opened(self) -> None:
        """Act when a file is opened from the list: press the confirming button."""
        self.press()

    def changed(self) -> None:
        """Act when other files are chosen: draw the dialog."""
        self.redraw()

    def choose(self, text: str) -> None:
        """Put other paths into the field."""
        self.text = text
        self.changed()

    # --- what was chosen

    @property
    def kind(self) -> FileKind:
        """Kind of file to choose; when saving, files with its extension."""
        return FileKind("Files", (self._ending,)) if self._saving else FILE_KINDS[self._kind_name]

    @property
    def is_empty(self) -> bool:
        """True if nothing is chosen or typed."""
        return not self.text.strip()

    def path(self) -> Path:
        """Return the single chosen path; an unsuitable folder is shown instead, and the dialog stays open."""
        path, *others = self.paths()
        if others:
            raise DatasetError(f"{len(others) + 1} files are chosen: choose one.")
        return path

    def chosen(self) -> tuple[Path, ...]:
        """Return the paths in the field, all of which exist. Raises DatasetError if there is none."""
        texts = _texts(self.text)
        if texts and set(texts) <= self._sent.keys():
            return tuple(self._sent[text] for text in texts)
        return tuple(map(self.existing, texts))

    def existing(self, text: str) -> Path:
        """Return the path of a typed text, relative to the shown folder. Raises DatasetError as `chosen` does."""
        return self._browsing.existing(text, self._base)

    def paths(self) -> tuple[Path, ...]:
        """Return the chosen paths and remember them; a folder that cannot be chosen is shown instead.

        Raises DatasetError if there is none.
        """
        paths = self.chosen()
        if set(paths) <= set(self._sent.values()):
            return paths
        folders = [p for p in paths if p.is_dir() and not p.name.endswith(".wafer")]
        if folders and not self.kind.takes_folder:
            self.go(folders[0])
            raise KeepOpen
        for path in paths:
            self._browsing.remember(self._kind_name, path)
        return paths

    def target(self) -> Path:
        """Return the path of the file to save; a typed folder is shown instead, and the dialog stays open."""
        folder = self._browsing.path_of(self.text, self._base) if not self.is_empty else None
        if folder is not None and folder.is_dir():
            self.choose(self._name)
            self.go(folder)
            raise KeepOpen
        return saved_as(self._browsing, self.text, self._base, self._ending)

    def write_to(self, path: Path, write: Callable[[Path], Any]) -> None:
        """Write a file; confirm before an existing file is replaced, with the dialog open behind."""
        if not path.exists():
            write(path)
            return

        def over() -> None:
            write(path)
            self.close()

        confirm_overwrite(self.page, path, over)
        raise KeepOpen

    def save_as(self, name: str, ending: str) -> None:
        """Propose another name and extension in the same folder."""
        self._ending, self._name = ending, name
        self.choose(name)
        self.go(self._folder)

    # --- files that the browser uploads

    def expect(self, n_files: int) -> None:
        """Take the next files that the browser uploads together."""
        self._expected, self._sent = n_files, {}

    def _take_upload(self, file: viser.UploadedFile) -> None:
        """Choose an uploaded file, with those expected before it."""
        with self._putting:
            path = save_upload(file)
            if len(self._sent) >= self._expected:
                self.expect(1)
            self._sent[file.name] = path
            self.text = _text_of([Path(name) for name in self._sent])
            n_sent, expected = len(self._sent), self._expected
        sent = f"{file.name} was sent and is chosen." if expected == 1 else f"{n_sent} of {expected} files were sent."
        self._tell(sent)
        if n_sent == expected:
            self.changed()

    def _refuse_upload(self, name: str) -> None:
        most = f"{MOST_UPLOAD_BYTES / 1e6:.0f} MB"
        self._tell_fault(
            f"{name} has more than {most}: copy it to this computer's data folder and choose it in the list."
        )

    # --- where to look

    def go(self, folder: Path, prefix: str = "", *, typing: bool = False) -> None:
        """List a folder asynchronously; only the answer to the latest request is shown.

        typing: the folder comes from the typed path, so the base of relative paths does not change.
        """
        if (folder, prefix) != (self._folder, self._prefix):
            self._limit = PAGE
        self._prefix, self._typing = prefix, typing
        self._listing_id = listing_id = next(_listings)
        request = self._browsing.list_folder(folder, self.kind, prefix=prefix, order=self._order, limit=self._limit)
        request.add_done_callback(lambda done: self._came(listing_id, done))

    def _came(self, listing_id: int, done: Future[Listing]) -> None:
        if not self._is_awaited(listing_id) or done.cancelled():
            return
        if (fault := done.exception()) is not None:
            if not isinstance(fault, WaferViewerError):
                raise fault
            self._tell_fault(str(fault))
            return
        listing = done.result()
        self._folder, self._shown = listing.folder, listing
        if not self._typing:
            self._base = listing.folder
        self._places = _places(listing, self._browsing.roots, () if self._saving else listing.recent)
        self._list = _list(listing, listing_id, self._order, self.kind, self._rows)
        self._looks = Markup()
        self._tell(_summary(listing, self.kind, self._saving))
        self._ask_looks(listing_id, listing)

    def _is_awaited(self, listing_id: int) -> bool:
        return listing_id == self._listing_id and not self.modal.closed

    def _ask_looks(self, listing_id: int, listing: Listing) -> None:
        """Request the previews; they arrive in batches as a style sheet, without a change of the list."""
        rules: list[str] = []
        previewed = [(n, e) for n, e in enumerate(listing.entries) if _has_look(e)][:MOST_LOOKS]

        def came(n: int, done: Future[bytes]) -> None:
            if not self._is_awaited(listing_id) or done.cancelled() or done.exception() is not None:
                return
            if jpeg := done.result():
                url = f"data:image/jpeg;base64,{base64.b64encode(jpeg).decode()}"
                row = f'.wv-files [data-n="{n}"] .wv-file-look'
                rules.append(f"{row}{{background-image:url({url})}}{row} .wv-i{{display:none}}")
            if rules and (n == previewed[-1][0] or len(rules) % LOOKS_AT_ONCE == 0):
                self._looks = html.style_sheet("".join(rules))
                self.redraw()

        for n, entry in previewed:
            self._browsing.look(entry.path).add_done_callback(lambda done, n=n: came(n, done))

    def _tell(self, text: str) -> None:
        self._status = Markup('<div class="wv-lab wv-file-told">{}</div>').format(text)
        self.redraw()

    def _tell_fault(self, text: str) -> None:
        self._status = Markup('<div class="wv-note fault">{}</div>').format(text)
        self.redraw()

    # --- what a person does

    def _typed(self, text: str) -> None:
        """Follow the typed path: list its folder, filtered by the beginning of the last part."""
        self.choose(text)
        if text.startswith(('"', "'")) or text in self._sent:
            return
        folder, _, name = text.strip().rpartition(os.sep)
        if self._saving and not folder:
            return
        beginning = f"{folder}{os.sep}" if folder or text.strip().startswith(os.sep) else ""
        base = self._typed_base(beginning)
        if base is not None:
            self.go(base, name if not self._saving else "", typing=True)

    def _typed_base(self, beginning: str) -> Path | None:
        """Return the folder named by the beginning of a path; None if it cannot be shown."""
        if not beginning:
            return self._base
        try:
            path = self.existing(beginning)
        except DatasetError:
            return None
        return path if path.is_dir() else None

    def _entries(self, key: str) -> list[FileEntry]:
        """Return the entries of a click; empty if the list was replaced meanwhile."""
        listing_id, _, numbers = key.partition(":")
        if self._shown is None or listing_id != str(self._listing_id):
            return []
        return [self._shown.entries[int(n)] for n in numbers.split(",") if n.isdigit()]

    def _mark(self, key: str) -> None:
        chosen = self._entries(key)
        if self._saving:
            if names := [entry.path.name for entry in chosen if not entry.is_folder]:
                self.choose(names[0])
            return
        if chosen:
            self.choose(_text_of([entry.path for entry in chosen]))
        self._tell(_chosen(chosen))

    def _open(self, key: str) -> None:
        for entry in self._entries(key)[:1]:
            if entry.is_folder:
                self._go_and_leave(entry.path)
                return
            self._mark(key)
            self.opened()

    def _go_and_leave(self, folder: Path) -> None:
        """Go to a folder and clear the choice; if folders can be chosen, choose this one."""
        if not self._saving:
            self.choose(str(folder) if self.kind.takes_folder else "")
        self.go(folder)

    def _take_recent(self, path: str) -> None:
        self.choose(path)
        self.go(Path(path).parent)

    def _to_parent(self, _: str) -> None:
        if self._shown is not None and self._shown.parent is not None:
            self._go_and_leave(self._shown.parent)

    def _sort(self, order: str) -> None:
        self._order = next((option for option in get_args(Order) if option == order), "date")
        self.go(self._folder, self._prefix, typing=self._typing)

    def _more(self, _: str) -> None:
        self._limit = min(self._limit + PAGE, MOST_SHOWN)
        self.go(self._folder, self._prefix, typing=self._typing)


def _texts(text: str) -> list[str]:
    """Return the paths in a text field; several paths are quoted. Raises DatasetError for unbalanced quotes."""
    text = text.strip()
    if not text.startswith(('"', "'")):
        return [text]
    try:
        return shlex.split(text)
    except ValueError as fault:
        raise DatasetError(f"The paths {text} cannot be told apart: put each in quotation marks.") from fault


def _text_of(paths: list[Path]) -> str:
    """Return the text of a field with these paths; of several each is quoted, as `_texts` takes them apart."""
    return str(paths[0]) if len(paths) == 1 else " ".join(shlex.quote(f"{path} ")[:-2] + "'" for path in paths)


def _has_look(entry: FileEntry) -> bool:
    image = entry.kind == "TIFF" or entry.kind.endswith("image")
    return not entry.why_not and (image or entry.kind == "Dataset" or bool(entry.note))


def _places(listing: Listing, roots: tuple[Root, ...], recent: tuple[Path, ...]) -> Markup:
    """Return the roots, the breadcrumbs from a root to the folder, and the recent paths."""
    inside = [root for root in roots if listing.folder.is_relative_to(root.path)]
    root = max(inside, key=lambda r: len(r.path.parts), default=None)
    chips = Markup("").join(_place(each.path, each.name, "on" if each is root else "") for each in roots)
    parts = listing.folder.relative_to(root.path).parts if root is not None else ()
    ways = [] if root is None else [root.path.joinpath(*parts[: k + 1]) for k in range(len(parts))]
    crumbs = Markup("").join(Markup("<i>/</i>{}").format(_place(folder, folder.name)) for folder in ways)
    up = ""
    if listing.parent is not None:
        label = Markup('class="wv-act" title="Folder above (Backspace)" aria-label="Folder above"')
        up = Markup("<span {} {}>{}</span>").format(
            label, html.pick("file-go", listing.parent), html.icon(viser.Icon.ARROW_UP, 15)
        )
    names = Markup("").join(_place(path, path.name, what="file-recent") for path in recent)
    last = Markup('<div class="wv-file-recent"><em>Recent</em>{}</div>').format(names) if names else Markup()
    return Markup('{last}<div class="wv-file-places">{chips}<div>{crumbs}</div>{up}</div>').format(
        last=last, chips=chips, crumbs=crumbs, up=up
    )


def _place(path: Path, name: str, look: str = "", what: str = "file-go") -> Markup:
    return Markup('<span class="{look}" title="{path}" {pick}>{name}</span>').format(
        look=look, path=path, pick=html.pick(what, path), name=name
    )


def _list(listing: Listing, listing_id: int, order: Order, kind: FileKind, rows: int) -> Markup:
    heads = Markup("").join(
        Markup('<span class="{}" {}>{}</span>').format(
            "on" if name == order else "", html.pick("file-order", name), title
        )
        for name, title in ORDERS.items()
    )
    now = datetime.now().astimezone()
    lines = Markup("").join(_row(n, entry, now) for n, entry in enumerate(listing.entries))
    if not lines:
        lines = html.empty("No file of this kind here." if listing.n_hidden else "This folder is empty.")
    several = Markup(' data-several="1" aria-multiselectable="true"') if kind.several else Markup()
    sign = Markup('<i hidden data-arrived="files"></i>')
    return Markup(
        '<div class="wv wv-file-box"><div class="wv-file-heads"><span></span>{heads}</div>'
        '<div class="wv-files" role="listbox" tabindex="0" aria-label="{title}" '
        'data-of="{listing_id}"{several} data-completion="{completion}" style="--rows:{rows}">'
        "{lines}{left}{sign}</div></div>"
    ).format(
        heads=heads,
        title=kind.title,
        listing_id=listing_id,
        several=several,
        completion=listing.completion,
        rows=rows,
        lines=lines,
        left=_remaining(listing),
        sign=sign,
    )


def _remaining(listing: Listing) -> Markup:
    """Return the number of entries not listed yet, with a link or hint to reach them."""
    remaining = listing.n_matching - len(listing.entries)
    if remaining <= 0:
        return Markup()
    if len(listing.entries) < MOST_SHOWN:
        more = html.link("Show more", "file-more")
        return Markup('<div class="wv-file-more">{} ({} left)</div>').format(more, number(remaining, 0))
    return Markup('<div class="wv-file-more">{} more: type the beginning of the name.</div>').format(
        number(remaining, 0)
    )


def _row(n: int, entry: FileEntry, now: datetime) -> Markup:
    sign = viser.Icon.FOLDER if entry.is_folder else viser.Icon.STACK_2 if entry.kind == "Dataset" else viser.Icon.FILE
    name = entry.path.name
    below = entry.why_not or entry.note or ("" if entry.is_folder else entry.kind)
    off = Markup(' aria-disabled="true"') if entry.why_not else Markup()
    changed = format_time(datetime.fromtimestamp(entry.modified_s).astimezone().isoformat(), now)
    weight = size(entry.size_bytes) if entry.size_bytes is not None else ""
    return Markup(
        '<div role="option" id="wv-file-{n}" data-n="{n}" aria-selected="false"{off} title="{name}">'
        '<span class="wv-file-look">{icon}</span><span class="wv-file-name"><b>{name}</b>'
        "<small>{below}</small></span><span>{weight}</span><span>{changed}</span></div>"
    ).format(n=n, off=off, name=name, icon=html.icon(sign, 17), below=below, weight=weight, changed=changed)


def _summary(listing: Listing, kind: FileKind, saving: bool) -> str:
    """Return the number of omitted entries; when saving, the folder and its free disk space."""
    if saving:
        return f"Saved in {listing.folder}. {size(listing.free_bytes)} free on this disk."
    sentences = []
    if listing.is_cut:
        sentences.append("The folder holds more than can be listed: type the beginning of the name.")
    if listing.n_hidden:
        files = "1 other file is" if listing.n_hidden == 1 else f"{number(listing.n_hidden, 0)} other files are"
        sentences.append(f"{kind.title} only: {files} not shown.")
    return " ".join(sentences)


def _chosen(entries: list[FileEntry]) -> str:
    if len(entries) > 1:
        return f"{len(entries)} chosen."
    return f"{entries[0].note} chosen." if entries and entries[0].is_folder and entries[0].note else ""
