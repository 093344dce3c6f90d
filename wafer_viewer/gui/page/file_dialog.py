"""The list of files inside a dialog: folders and files to choose from, places to go to, and the path typed.

The session lists and paints, on its own threads; here is only drawn what it answers.
"""

from __future__ import annotations

import base64
import os
import shlex
from collections.abc import Callable
from concurrent.futures import Future
from datetime import datetime
from itertools import count
from pathlib import Path
from typing import Any, get_args

import viser

from wafer_viewer.draw.number_format import number, size
from wafer_viewer.gui.page.dialogs import Dialog, KeepOpen, unless_there, when
from wafer_viewer.gui.page.uploads import put_down
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.controls import HtmlBlock, outlined
from wafer_viewer.gui.widgets.error_guard import guarded
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
"""Rows of one list; the rest is reached by typing the beginning of a name."""
MOST_LOOKS = 48
"""Small pictures asked for of one list."""
LOOKS_AT_ONCE = 8
"""So many are sent together, so that the browser lays the page out less often."""
ORDERS: dict[Order, str] = {"name": "Name", "size": "Size", "date": "Changed"}
_listings = count(1)


class FileList:
    """Folders and files of one folder at a time, in a dialog that is being built.

    Parameters
    ----------
    dialog : Dialog
        Its button is pressed when a file is opened from the list.
    kind : KindName
        What is asked for.
    rows : int
        How high the list is, in rows.
    saving : str
        Name proposed for a file to be saved; empty where a file is opened.
    ending : str
        Ending of the file to be saved.
    """

    def __init__(self, dialog: Dialog, kind: KindName, rows: int = 8, saving: str = "", ending: str = "") -> None:
        self._dialog, self._page = dialog, dialog.page
        self._kind_name: KindName = kind
        self._browsing = dialog.page.session.browsing
        self._saving, self._ending, self._rows = bool(saving), ending, rows
        self._folder = self._base = dialog.page.session.snapshot.data_folder
        self._order: Order = "date"
        self._limit, self._prefix = PAGE, ""
        self._typing = False
        self._of = 0
        self._shown: Listing | None = None
        self._sent: dict[str, Path] = {}
        gui = self._page.gui
        self._places = HtmlBlock(gui)
        self._list = HtmlBlock(gui, padded=False)
        self._looks = HtmlBlock(gui, padded=False)
        gui.add_html('<div class="wv-file-field"></div>')
        self.field = gui.add_text("File name", saving) if self._saving else gui.add_text("Path", "")
        self._told = HtmlBlock(gui)
        self._listen()
        self.go(self._folder)

    # --- what was chosen

    @property
    def kind(self) -> FileKind:
        """What is asked for: while a file is saved, those of its ending."""
        if self._saving:
            return FileKind("Files", (self._ending,))
        return FILE_KINDS[self._kind_name]

    def path(self) -> Path:
        """Return the one path chosen; a folder that is none is shown instead, and the dialog stays open."""
        paths = list(self.paths())
        if len(paths) > 1:
            raise DatasetError(f"{len(paths)} files are chosen: choose one.")
        return paths[0]

    def paths(self) -> tuple[Path, ...]:
        """Return the paths chosen, all of them there. Raises DatasetError where there is none."""
        texts = _texts(self.field.value)
        if len(texts) == 1 and (sent := self._sent.get(texts[0])) is not None:
            return (sent,)
        paths = tuple(self._browsing.existing(text, self._base) for text in texts)
        folders = [p for p in paths if p.is_dir() and not p.name.endswith(".wafer")]
        if folders and not self.kind.takes_folder:
            self.go(folders[0])
            raise KeepOpen
        for path in paths:
            self._browsing.remember(self._kind_name, path)
        return paths

    def target(self) -> Path:
        """Return the path of the file to be saved; a folder typed is shown instead, and the dialog stays open."""
        path = self._browsing.path_of(self.field.value, self._base) if self.field.value.strip() else None
        if path is not None and path.is_dir():
            name = Path(self._default).name
            self.field.value = name
            self.go(path)
            raise KeepOpen
        return saved_as(self._browsing, self.field.value, self._base, self._ending)

    @property
    def is_empty(self) -> bool:
        """Whether nothing is chosen and nothing typed."""
        return not self.field.value.strip()

    def save_as(self, name: str, ending: str) -> None:
        """Propose another name and kind of file; the folder stays."""
        self._ending, self._default = ending, name
        self.field.value = name
        self.go(self._folder)

    def put(self, path: Path, called: str) -> None:
        """Choose a file that the browser sent."""
        self.field.value = called
        self._sent = {called: path}

    def write_to(self, path: Path, write: Callable[[], None]) -> None:
        """Write a file; one that is there is replaced only after a question, and the dialog stays open behind it."""
        if not path.exists():
            write()
            return

        def over() -> None:
            write()
            self._dialog.close()

        unless_there(self._page, path, over)
        raise KeepOpen

    def add_upload(self, mime_type: str = "*/*", then: Callable[[], None] | None = None) -> None:
        """A button below the list that sends a file from the machine of the browser."""
        gui = self._page.gui
        upload = gui.add_upload_button("Send a file from this computer…", icon=viser.Icon.UPLOAD, mime_type=mime_type)
        outlined(gui, upload, 30)

        @upload.on_upload
        def _(event: Any) -> None:
            self.put(put_down(event.target.value), event.target.value.name)
            self._told.show(_told(f"{event.target.value.name} was sent and is chosen."))
            if then is not None:
                then()

    # --- where to look

    def go(self, folder: Path, prefix: str = "", *, typing: bool = False) -> None:
        """List a folder; the answer is drawn when it comes, and only the newest.

        typing: the path typed leads there, so that what it is relative to stays.
        """
        if (folder, prefix) != (self._folder, self._prefix):
            self._limit = PAGE
        self._prefix, self._typing = prefix, typing
        self._of = of = next(_listings)
        asked = self._browsing.list_folder(folder, self.kind, prefix=prefix, order=self._order, limit=self._limit)
        asked.add_done_callback(lambda done: self._came(of, done))

    def _came(self, of: int, done: Future[Listing]) -> None:
        if of != self._of or self._dialog.modal.closed or done.cancelled():
            return
        if (fault := done.exception()) is not None:
            if not isinstance(fault, WaferViewerError):
                raise fault
            self._told.show(f'<div class="wv-note fault">{html.safe(str(fault))}</div>')
            return
        listing = done.result()
        self._folder, self._shown = listing.folder, listing
        if not self._typing:
            self._base = listing.folder
        self._places.show(_places(listing, self._browsing.roots, self._recent_shown(listing)))
        self._list.show(_list(listing, of, self._order, self.kind, self._rows))
        self._told.show(_told(_summary(listing, self.kind, self._saving)))
        self._ask_looks(of, listing)

    def _recent_shown(self, listing: Listing) -> tuple[Path, ...]:
        return () if self._saving else listing.recent

    def _ask_looks(self, of: int, listing: Listing) -> None:
        """Small pictures come a few at a time, as a style sheet: the list itself stays as it is."""
        rules: list[str] = []
        asked = [(n, e) for n, e in enumerate(listing.entries) if _has_look(e)][:MOST_LOOKS]
        self._looks.show("")

        def came(n: int, last: bool, done: Future[bytes]) -> None:
            if of != self._of or self._dialog.modal.closed or done.cancelled() or done.exception() is not None:
                return
            if jpeg := done.result():
                url = f"data:image/jpeg;base64,{base64.b64encode(jpeg).decode()}"
                row = f'.wv-files [data-n="{n}"] .wv-file-look'
                rules.append(f"{row}{{background-image:url({url})}}{row} .wv-i{{display:none}}")
            if rules and (last or len(rules) % LOOKS_AT_ONCE == 0):
                self._looks.show(f"<style>{''.join(rules)}</style>")

        for n, entry in asked:
            future = self._browsing.look(entry.path)
            future.add_done_callback(lambda done, n=n: came(n, n == asked[-1][0], done))

    # --- what a person does

    def _listen(self) -> None:
        page, failed = self._page, "The folder is not shown"
        self._default = self.field.value
        self.field.on_update(guarded(page, failed)(self._typed))
        page.on_pick("file-mark", self._mark)
        page.on_pick("file-open", self._open)
        page.on_pick("file-go", lambda path: self._go_and_leave(Path(path)))
        page.on_pick("file-recent", self._take_recent)
        page.on_pick("file-parent", lambda _: self._to_parent())
        page.on_pick("file-order", self._sort)
        page.on_pick("file-more", lambda _: self._more())

    def _typed(self, event: Any) -> None:
        """The list follows what is typed: the folder named, and in it what begins as the last part does."""
        text = str(event.target.value)
        if event.client is None or text.startswith(('"', "'")) or text in self._sent:
            return
        folder, _, name = text.strip().rpartition(os.sep)
        if self._saving and not folder:
            return
        beginning = f"{folder}{os.sep}" if folder or text.strip().startswith(os.sep) else ""
        base = self._typed_base(beginning)
        if base is not None:
            self.go(base, name if not self._saving else "", typing=True)

    def _typed_base(self, beginning: str) -> Path | None:
        """The folder that a beginning of a path names; None where it is none to be shown."""
        if not beginning:
            return self._base
        try:
            path = self._browsing.existing(beginning, self._base)
        except DatasetError:
            return None
        return path if path.is_dir() else None

    def _entries(self, key: str) -> list[FileEntry]:
        """The rows that a click names; none of a list that was replaced meanwhile."""
        of, _, numbers = key.partition(":")
        if self._shown is None or of != str(self._of):
            return []
        return [self._shown.entries[int(n)] for n in numbers.split(",") if n.isdigit()]

    def _mark(self, key: str) -> None:
        chosen = self._entries(key)
        if self._saving:
            chosen = [entry for entry in chosen if not entry.is_folder]
            if chosen:
                self.field.value = chosen[0].path.name
            return
        if chosen:
            self.field.value = _text_of([entry.path for entry in chosen])
        self._told.show(_told(_chosen(chosen)))

    def _open(self, key: str) -> None:
        for entry in self._entries(key)[:1]:
            if entry.is_folder:
                self._go_and_leave(entry.path)
                return
            self._mark(key)
            self._dialog.press()

    def _go_and_leave(self, folder: Path) -> None:
        """Go to a folder; what was chosen in another is chosen no more, and where folders are asked for this one is."""
        if not self._saving:
            self.field.value = str(folder) if self.kind.takes_folder else ""
        self.go(folder)

    def _take_recent(self, path: str) -> None:
        self.field.value = path
        self.go(Path(path).parent)

    def _to_parent(self) -> None:
        if self._shown is not None and self._shown.parent is not None:
            self._go_and_leave(self._shown.parent)

    def _sort(self, order: str) -> None:
        self._order = next((known for known in get_args(Order) if known == order), "date")
        self.go(self._folder, self._prefix, typing=self._typing)

    def _more(self) -> None:
        self._limit = min(self._limit + PAGE, MOST_SHOWN)
        self.go(self._folder, self._prefix, typing=self._typing)


def _texts(text: str) -> list[str]:
    """The paths in a field: several are in quotation marks."""
    text = text.strip()
    if not text.startswith(('"', "'")):
        return [text]
    try:
        return shlex.split(text)
    except ValueError as fault:
        raise DatasetError(f"The paths {text} cannot be told apart: put each in quotation marks.") from fault


def _text_of(paths: list[Path]) -> str:
    return str(paths[0]) if len(paths) == 1 else shlex.join(f"{path}" for path in paths)


def _has_look(entry: FileEntry) -> bool:
    image = entry.kind == "TIFF" or entry.kind.endswith("image")
    return not entry.why_not and (image or entry.kind == "Dataset" or bool(entry.note))


def _places(listing: Listing, roots: tuple[Root, ...], recent: tuple[Path, ...]) -> str:
    """The roots, the way from one of them to the folder shown, and what was taken last."""
    inside = [root for root in roots if listing.folder.is_relative_to(root.path)]
    root = max(inside, key=lambda r: len(r.path.parts), default=None)
    chips = "".join(_place(each.path, each.name, "on" if each is root else "") for each in roots)
    parts = listing.folder.relative_to(root.path).parts if root is not None else ()
    ways = [] if root is None else [root.path.joinpath(*parts[: k + 1]) for k in range(len(parts))]
    crumbs = "".join(f"<i>/</i>{_place(way, way.name)}" for way in ways)
    up = ""
    if listing.parent is not None:
        told = 'class="wv-act" title="Folder above (Backspace)" aria-label="Folder above"'
        up = f"<span {told} {html.pick('file-go', listing.parent)}>{html.icon(viser.Icon.ARROW_UP, 15)}</span>"
    names = "".join(_place(path, path.name, what="file-recent") for path in recent)
    last = f'<div class="wv-file-recent"><em>Recent</em>{names}</div>' if names else ""
    return f'{last}<div class="wv-file-places">{chips}<div>{crumbs}</div>{up}</div>'


def _place(path: Path, name: str, look: str = "", what: str = "file-go") -> str:
    return f'<span class="{look}" title="{html.safe(path)}" {html.pick(what, path)}>{html.safe(name)}</span>'


def _list(listing: Listing, of: int, order: Order, kind: FileKind, rows: int) -> str:
    heads = "".join(
        f'<span class="{"on" if name == order else ""}" {html.pick("file-order", name)}>{title}</span>'
        for name, title in ORDERS.items()
    )
    now = datetime.now().astimezone()
    lines = "".join(_row(n, entry, now) for n, entry in enumerate(listing.entries))
    if not lines:
        lines = html.empty("No such file here." if listing.n_hidden else "Nothing here.")
    several = ' data-several="1" aria-multiselectable="true"' if kind.several else ""
    sign = '<img src="data:," alt="" hidden onerror="window.wvFiles&&window.wvFiles.came(this)">'
    return (
        f'<div class="wv wv-file-box"><div class="wv-file-heads"><span></span>{heads}</div>'
        f'<div class="wv-files" role="listbox" tabindex="0" aria-label="{html.safe(kind.title)}" '
        f'data-of="{of}"{several} data-completion="{html.safe(listing.completion)}" style="--rows:{rows}">'
        f"{lines}{_left(listing)}{sign}</div></div>"
    )


def _left(listing: Listing) -> str:
    """The entries that are not in the list yet, and the way to them."""
    left = listing.n_matching - len(listing.entries)
    if left <= 0:
        return ""
    if len(listing.entries) < MOST_SHOWN:
        more = f'<span class="wv-link" {html.pick("file-more")}>Show more</span>'
        return f'<div class="wv-file-more">{more} ({number(left, 0)} left)</div>'
    return f'<div class="wv-file-more">{number(left, 0)} more: type the beginning of the name.</div>'


def _row(n: int, entry: FileEntry, now: datetime) -> str:
    sign = viser.Icon.FOLDER if entry.is_folder else viser.Icon.STACK_2 if entry.kind == "Dataset" else viser.Icon.FILE
    name = html.safe(entry.path.name)
    below = entry.why_not or entry.note or ("" if entry.is_folder else entry.kind)
    off = ' aria-disabled="true"' if entry.why_not else ""
    changed = when(datetime.fromtimestamp(entry.modified_s).astimezone().isoformat(), now)
    weight = size(entry.size_bytes) if entry.size_bytes is not None else ""
    return (
        f'<div role="option" id="wv-file-{n}" data-n="{n}" aria-selected="false"{off} title="{name}">'
        f'<span class="wv-file-look">{html.icon(sign, 17)}</span><span class="wv-file-name"><b>{name}</b>'
        f"<small>{html.safe(below)}</small></span><span>{weight}</span><span>{html.safe(changed)}</span></div>"
    )


def _summary(listing: Listing, kind: FileKind, saving: bool) -> str:
    """What the list leaves out, and for a file to be saved the room there is."""
    if saving:
        return f"Saved in {listing.folder}. {size(listing.free_bytes)} free on this disk."
    told = []
    if listing.is_cut:
        told.append("The folder holds more than can be listed: type the beginning of the name.")
    if listing.n_hidden:
        files = "1 other file is" if listing.n_hidden == 1 else f"{number(listing.n_hidden, 0)} other files are"
        told.append(f"{kind.title} only: {files} not shown.")
    return " ".join(told)


def _chosen(entries: list[FileEntry]) -> str:
    if len(entries) > 1:
        return f"{len(entries)} chosen."
    return f"{entries[0].note} chosen." if entries and entries[0].is_folder and entries[0].note else ""


def _told(text: str) -> str:
    return f'<div class="wv-lab wv-file-told">{html.safe(text)}</div>'
