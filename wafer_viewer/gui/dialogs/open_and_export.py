"""Dialogs to open datasets and plans, import images, export surfaces, and list the audit log."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

import viser
from markupsafe import Markup

from wafer_viewer.draw.number_format import format_time, number
from wafer_viewer.gui.dialogs.dialog import Confirm, Dialog
from wafer_viewer.gui.dialogs.file_dialog import FileDialog
from wafer_viewer.gui.elements.elements import Dropdown, Elements, Html, Number
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.state.view_state import Counted, View
from wafer_viewer.gui.widgets import html
from wafer_viewer.model.errors import WaferViewerError
from wafer_viewer.model.file_formats import BY_SUFFIX, FORMATS, MESH_POINTS, every_for, suffix_of
from wafer_viewer.model.region import Region
from wafer_viewer.model.roles import AuditEntry
from wafer_viewer.model.surface.comparison import FACE_TITLES, comparison_of
from wafer_viewer.model.surface_format import Reading

# --------------------------------------------------------------------------------------------------------- audit dialog


SHOWN = 200
"""Newest entries that are shown; the command line lists all."""


def audit_dialog(page: Page) -> None:
    """Show the newest entries of the audit log, or why it cannot be read."""
    try:
        shown = audit_table(page.session.recorded_actions(), datetime.now().astimezone())
    except WaferViewerError as fault:
        shown = Markup('<div class="wv-note fault">{}</div>').format(fault)
    below = "Every change to this folder. Each entry is signed."
    Dialog(page, "Audit log", below, None, contents=lambda _: [Html(shown)])


def audit_table(entries: Sequence[AuditEntry], now: datetime) -> Markup:
    """Return the newest entries as a table, the newest first."""
    if not entries:
        return html.empty("Nothing is recorded yet. A scan, a release or a kept result makes the first entry.")
    rows = [_row(entry, now) for entry in reversed(entries[-SHOWN:])]
    more = len(entries) - len(rows)
    rest = html.empty(f"{more} earlier entries: wafer-viewer log FOLDER lists them.") if more else Markup()
    table = html.table(["When", "Who", "What", "Of"], rows, widths_px=(124, 130, None, 220))
    return Markup('<div class="wv-audit">{}{}</div>').format(table, rest)


def _row(entry: AuditEntry, now: datetime) -> Markup:
    who = Markup("{}<small>{}</small>").format(entry.by, "" if entry.through == "page" else f" {entry.through}")
    what = Markup("{}<small>{}</small>").format(entry.action, entry.detail and f" {entry.detail}")
    return html.row([format_time(entry.at, now), who, what, entry.subject])


# ------------------------------------------------------------------------------------------------ import export dialogs


ICON = viser.Icon
SHOW_SURFACE = dict[str, Any](step="surface", show=0, range_um=None, selected=None, frame_k=None)
"""Changes of the view that show the surface of another dataset."""
NOT_EXPORTED = "Export failed"
FORMAT_HINT = "The file's extension follows"
WRITTEN_TITLES = {kind.title: kind.suffixes[0] for kind in FORMATS if kind.writer is not None}
"""Formats of the export dialog: suffixes by title."""
SCENE_ENDING = ".ome.zarr"
SCENE = "Each field as an image in its solved place: pictures and heights, OME-NGFF 0.6."
READ_FILES = ", ".join(kind.suffixes[0] for kind in FORMATS if kind.reader is not None)


def open_dataset(page: Page, path: Path) -> None:
    """Open a dataset and show its surface; show Acquire if its scan is unfinished."""

    def look(_: Any) -> None:
        data = page.session.snapshot.dataset
        unfinished = data is not None and not data.finished
        page.change(**SHOW_SURFACE | ({"step": "acquire"} if unfinished else {}))

    page.ask("The dataset was not opened", page.session.open_dataset(path), look)


def open_surface(page: Page, path: Path, says: Reading, name: str | None) -> None:
    """Import a surface file as a dataset and show it. says: settings that the file lacks."""
    done = page.session.exchange.import_surface(path, says, name)
    page.ask("The surface was not opened", done, lambda _: page.change(**SHOW_SURFACE))


def open_dialog(page: Page) -> None:
    """Open the dialog that opens a dataset, or imports a surface file as one."""

    def begin(here: FileDialog[None]) -> None:
        path = here.path()
        if page.session.exchange.is_surface(path):
            open_surface(page, path, Reading(), None)
        else:
            open_dataset(page, path)

    below = f"A dataset NAME.wafer, or a surface file ({READ_FILES})."
    answer = Confirm("Open", ICON.FOLDER_OPEN, begin, "The dataset was not opened")
    FileDialog(page, "Open a dataset", below, answer, "dataset", rows=9)


def save_dialog(
    page: Page,
    title: str,
    name: str,
    write: Callable[[Path], Future[Path]],
    saved: str,
    failed: str,
    about: str = "",
) -> None:
    """Open a Save dialog that starts in the data folder with `name`.

    Parameters
    ----------
    page : Page
        Page that shows the dialog.
    title : str
        Title of the dialog, such as ``Save the plan``.
    name : str
        Proposed name, with the extension of the file.
    write : callable
        Starts to write to a path; an existing file is replaced only after confirmation.
    saved, failed : str
        Titles of the success and failure notifications.
    about : str
        What is written, under the title.
    """

    def begin(target: Path) -> None:
        page.ask(failed, write(target), lambda path: page.say(saved, str(path)))

    def save(here: FileDialog[None]) -> None:
        here.write_to(here.target(), begin)

    FileDialog(
        page, title, about, Confirm("Save", ICON.DEVICE_FLOPPY, save, failed, commands=False), "any", saving=name
    )


def load_plan_dialog(page: Page) -> None:
    """Open the dialog that loads a plan from its file."""
    below, failed = "A file PLAN.toml, as Save plan… writes it.", "The plan was not loaded"
    answer = Confirm("Load", ICON.FOLDER_OPEN, lambda here: page.session.load_plan(here.path()), failed)
    FileDialog(page, "Load a plan", below, answer, "plan")


PARTS_COUNTED: dict[Counted, str] = {"all": "", "view": ", in view", "selection": ", selection"}


def surface_name(view: View) -> str:
    """Return the name of the surface part that statistics cover, such as ``Field 5, in view``."""
    part, compared = PARTS_COUNTED[view.counted], comparison_of(view.show)
    if compared is not None:
        return FACE_TITLES[compared[1]][1] + part
    return (f"Field {view.show}" if view.show else "Stitched surface") + part


@dataclass(frozen=True, slots=True)
class _Export:
    """Format of an export, by its title, and its density."""

    format: str
    every: int = 1

    @property
    def ending(self) -> str:
        return WRITTEN_TITLES[self.format]


def export_dialog(page: Page) -> None:
    """Open the dialog that exports the displayed surface; it names what the format cannot hold."""
    snapshot, field = page.session.snapshot, page.view.show or None
    data, info = snapshot.dataset, page.statistics or (snapshot.surface if field is None else None)
    part = Region.rectangle(*page.counted_um) if page.counted_um is not None else None
    size = (info.rows, info.cols, info.pixel_um) if info else None

    def take(here: FileDialog[_Export], title: str) -> None:
        ending, name = WRITTEN_TITLES[title], Path(here.text)
        is_drawing = size is not None and BY_SUFFIX[ending].is_drawing
        here.hold(_Export(title, every_for(size[:2], MESH_POINTS) if size and is_drawing else 1))
        here.save_as(f"{name.name.removesuffix(suffix_of(name))}{ending}", ending)

    def contents(here: FileDialog[_Export]) -> Elements:
        own = here.own
        density = "Density: every n-th row and column is written; 1 for all"
        return [
            *here.files(),
            Dropdown("Format", own.format, partial(take, here), FORMAT_HINT, options=tuple(WRITTEN_TITLES)),
            Number("Every n-th pixel", own.every, lambda n: here.keep(every=int(n)), density, least=1),
            Html(_description(own.ending, own.every, size)),
        ]

    def export(here: FileDialog[_Export], target: Path) -> None:
        done = page.session.export_surface(target, field, here.own.every, part)
        page.ask(NOT_EXPORTED, done, lambda out: page.say("Exported", str(out)))

    def write(here: FileDialog[_Export]) -> None:
        here.write_to(here.target(), partial(export, here))

    own = _Export(next(iter(WRITTEN_TITLES)))
    name = f"{data.path.stem if data else 'surface'}{_ending_of(field)}{own.ending}"
    answer, below = Confirm("Export", ICON.DOWNLOAD, write, NOT_EXPORTED, commands=False), surface_name(page.view)
    FileDialog(page, "Export the surface", f"Writes: {below}.", answer, "any", own, contents, rows=6, saving=name)


def export_fields_dialog(page: Page) -> None:
    """Open the dialog that exports the fields of the stitched surface as images in place."""
    data = page.session.snapshot.dataset
    name = f"{data.path.stem if data else 'fields'}{SCENE_ENDING}"
    write = page.session.exchange.export_fields
    save_dialog(page, "Export the fields", name, write, "Fields exported", "The fields were not exported", SCENE)


def _description(ending: str, every: int, size: tuple[int, int, float] | None) -> Markup:
    """Return output size and losses of the format. size: rows, columns, µm per pixel of the surface, or None."""
    written = ""
    if size is not None:
        rows, cols = (-(-n // every) for n in size[:2])
        pixel_um = number(size[2] * every, 3)
        written = f"{number(cols, 0)} × {number(rows, 0)} pixels of {pixel_um}\u202fµm, along x and y. "
    loses = BY_SUFFIX[ending].loses or "The file contains the whole surface."
    return html.remark(written + loses, "margin-bottom:9px")


def _ending_of(field: int | None) -> str:
    """Return the suffix of the file name: none for the dataset, one for a field or a comparison."""
    return "" if not field else f"-field{field}" if field > 0 else "-compared"
