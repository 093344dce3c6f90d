"""Dialogs to open datasets and plans, import images, export surfaces, and list the audit log."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Future
from datetime import datetime
from pathlib import Path
from typing import Any

import viser
from markupsafe import Markup

from wafer_viewer.draw.number_format import number
from wafer_viewer.gui.page.dialogs import Dialog, format_time, open_dataset, open_surface
from wafer_viewer.gui.page.file_dialog import FileList
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.state.view_state import Counted, View
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.controls import HtmlBlock
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
    dialog = Dialog(page, "Audit log", "What changed something in this folder, signed entry by entry.")
    try:
        shown = audit_table(page.session.recorded_actions(), datetime.now().astimezone())
    except WaferViewerError as fault:
        shown = Markup('<div class="wv-note fault">{}</div>').format(fault)
    with dialog.modal:
        HtmlBlock(page.gui, shown)
    dialog.close_button("Close")


def audit_table(entries: Sequence[AuditEntry], now: datetime) -> Markup:
    """Return the newest entries as a table, the newest first."""
    if not entries:
        return html.empty("Nothing was recorded yet: a scan, a release or a kept result is the first entry.")
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


WRITTEN_TITLES = {kind.title: kind.suffixes[0] for kind in FORMATS if kind.writer is not None}
"""Formats of the export dialog: suffixes by title."""
SCENE_ENDING = ".ome.zarr"
SCENE = "Each field as an image in its solved place: pictures and heights, OME-NGFF 0.6."
READ_FILES = ", ".join(kind.suffixes[0] for kind in FORMATS if kind.reader is not None)


def open_dialog(page: Page) -> None:
    """Open the dialog that opens a dataset, or imports a surface file as one."""
    dialog = Dialog(page, "Open a dataset", f"A dataset NAME.wafer, or a surface file ({READ_FILES}).")
    with dialog.modal:
        files = FileList(dialog, "dataset", rows=9)

    def begin() -> None:
        path = files.path()
        if page.session.exchange.is_surface(path):
            open_surface(page, path, Reading(), None)
        else:
            open_dataset(page, path)

    dialog.answers("Open", viser.Icon.FOLDER_OPEN, begin, "The dataset was not opened")


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
    dialog = Dialog(page, title, about)
    with dialog.modal:
        files = FileList(dialog, "any", saving=name, ending=Path(name).suffix)

    def begin(target: Path) -> None:
        page.ask(failed, write(target), lambda path: page.say(saved, str(path)))

    def save() -> None:
        target = files.target()
        files.write_to(target, lambda: begin(target))

    dialog.answers("Save", viser.Icon.DEVICE_FLOPPY, save, failed, needs_control=False)


def load_plan_dialog(page: Page) -> None:
    """Open the dialog that loads a plan from its file."""
    dialog = Dialog(page, "Load a plan", "A file PLAN.toml, as Save plan… writes it.")
    with dialog.modal:
        files = FileList(dialog, "plan")

    def load() -> None:
        page.ask("The plan was not loaded", page.session.load_plan(files.path()))

    dialog.answers("Load", viser.Icon.FOLDER_OPEN, load, "The plan was not loaded")


PARTS_COUNTED: dict[Counted, str] = {"all": "", "view": ", in view", "selection": ", selection"}


def surface_name(view: View) -> str:
    """Return the name of the surface part that statistics cover, such as ``Field 5, in view``."""
    part, compared = PARTS_COUNTED[view.counted], comparison_of(view.show)
    if compared is not None:
        return FACE_TITLES[compared[1]][1] + part
    return (f"Field {view.show}" if view.show else "Stitched surface") + part


def export_dialog(page: Page) -> None:
    """Open the dialog that exports the displayed surface; it names what the format cannot hold."""
    snapshot, field = page.session.snapshot, page.view.show or None
    data, info = snapshot.dataset, snapshot.surface if field is None else None
    stem = f"{data.path.stem if data else 'surface'}{_ending_of(field)}"
    statistics, box_um = page.statistics, page.counted_um
    part = Region.rectangle(*box_um) if box_um is not None else None
    dialog = Dialog(page, "Export the surface", f"Writes: {surface_name(page.view)}.")
    size = (
        (statistics.rows, statistics.cols, statistics.pixel_um)
        if statistics
        else (info.rows, info.cols, info.pixel_um)
        if info
        else None
    )
    with dialog.modal:
        first = next(iter(WRITTEN_TITLES.values()))
        files = FileList(dialog, "any", rows=6, saving=f"{stem}{first}", ending=first)
        kind = page.gui.add_dropdown("Format", tuple(WRITTEN_TITLES))
        every = page.gui.add_number("One pixel in", 1, min=1, max=1000, step=1)
        description = HtmlBlock(page.gui, _description(first, 1, size))

    @kind.on_update
    def _(_: Any) -> None:
        ending = WRITTEN_TITLES[kind.value]
        name = Path(files.field.value)
        files.save_as(f"{name.name.removesuffix(suffix_of(name))}{ending}", ending)
        every.value = every_for(size[:2], MESH_POINTS) if size and BY_SUFFIX[ending].is_drawing else 1
        description.show(_description(ending, every.value, size))

    @every.on_update
    def _(_: Any) -> None:
        description.show(_description(WRITTEN_TITLES[kind.value], every.value, size))

    def write() -> None:
        target = files.target()
        files.write_to(target, lambda: export(target))

    def export(target: Path) -> None:
        done = page.session.export_surface(target, field, int(every.value), part)
        page.ask("Export failed", done, lambda out: page.say("Exported", str(out)))

    dialog.answers("Export", viser.Icon.DOWNLOAD, write, "Export failed", needs_control=False)


def export_fields_dialog(page: Page) -> None:
    """Open the dialog that exports the fields of the stitched surface as images in place."""
    data = page.session.snapshot.dataset
    name = f"{data.path.stem if data else 'fields'}{SCENE_ENDING}"
    write = page.session.exchange.export_fields
    save_dialog(page, "Export the fields", name, write, "Fields exported", "The fields were not exported", SCENE)


def _description(ending: str, every: float, size: tuple[int, int, float] | None) -> Markup:
    """Return output size and losses of the format. size: rows, columns, µm per pixel of the surface, or None."""
    written = ""
    if size is not None:
        step = max(1, int(every))
        rows, cols = (-(-n // step) for n in size[:2])
        pixel_um = number(size[2] * step, 3)
        written = f"{number(cols, 0)} × {number(rows, 0)} pixels of {pixel_um}\u202fµm, along x and y. "
    loses = BY_SUFFIX[ending].loses or "The file holds all there is of the surface."
    return Markup('<div class="wv-lab" style="margin-bottom:9px">{}</div>').format(
        html.with_micro_sign(written + loses)
    )


def _ending_of(field: int | None) -> str:
    """Return the suffix of the file name: none for the dataset, one for a field or a comparison."""
    return "" if not field else f"-field{field}" if field > 0 else "-compared"
