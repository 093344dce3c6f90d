"""Import dialog: files are looked at in the background before anything is imported."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import Future
from itertools import count
from pathlib import Path
from typing import Any

import viser
from markupsafe import Markup

from wafer_viewer.gui.page.dialogs import Dialog, open_surface
from wafer_viewer.gui.page.file_dialog import FileList
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.presenters import import_contents as words
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.callbacks import Debouncer, guarded
from wafer_viewer.gui.widgets.controls import HtmlBlock, add_html, set_prop
from wafer_viewer.gui.widgets.number_field import OptionalNumber
from wafer_viewer.model.acquisition.image_source import ImageOptions
from wafer_viewer.model.errors import DatasetError, WaferViewerError
from wafer_viewer.model.file_contents import FileContents
from wafer_viewer.model.surface_format import Reading
from wafer_viewer.session.core.background_work import RunningWork
from wafer_viewer.session.files.file_jobs import PICTURE_ENDING, ImportLook
from wafer_viewer.session.state.snapshot import Snapshot

FAILED = "The files were not read"
PAUSE_S = 0.5
"""Pause in typing after which the files are looked at."""
_CHOOSE, _ALL = "choose…", "all"
_looks = count(1)


def import_dialog(page: Page) -> None:
    """Open the import dialog: folder of images, multi-page TIFF or surface file, also as an upload."""
    ImportDialog(page)


def take_drops(page: Page) -> None:
    """Open the import dialog on files that are dropped on the page; the browser sends them to the dialog."""
    page.on_pick("import-drop", lambda drop: ImportDialog(page).expect(drop))


class ImportDialog:
    """List of files on the left until one is chosen, then what they hold; values and choices on the right."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._dialog = dialog = Dialog(page, "Import images or a surface", "", on_close=self._leave)
        self._id, self._work = 0, None
        self._look: ImportLook | None = None
        self._is_current = False
        self._sources: tuple[Path, ...] = ()
        self._asked = ImageOptions(), Reading()
        self._problem = ""
        self._as_listed = self._overrule = False
        self._mirrored: frozenset[str] = frozenset()
        self._debounced = Debouncer(self._begin, guarded(page, FAILED), PAUSE_S)
        gui = page.gui
        with dialog.modal:
            self._sub = HtmlBlock(gui, _sub("A folder of images, several files, a multi-page TIFF; or a surface file."))
            self._progress = HtmlBlock(gui)
            self._awaited = HtmlBlock(gui, _awaited(), padded=False)
            with gui.add_folder("·"):
                self._files = FileList(dialog, "images", rows=6, on_open=self.changed)
                self._files.add_upload(then=self.changed)
                self._contents = HtmlBlock(gui)
            with gui.add_folder("·"):
                self._build_values()
            add_html(gui, Markup('<div class="wv-imp-end"></div>'))
            self._foot = HtmlBlock(gui)
        self._button = dialog.answers("Import", viser.Icon.PHOTO_PLUS, self._import, "Import stopped")
        self._files.field.on_update(lambda _: self.changed())
        page.on_pick("import-toggle", self._toggle)
        page.on_pick("import-other", lambda _: self._choose_other())
        page.on_pick("import-drop", self.expect)
        self._unsubscribe = page.session.subscribe(self._show_progress)
        page.on_close(self._leave)

    def _build_values(self) -> None:
        gui = self._page.gui
        HtmlBlock(gui, html.head("What the files say", "type what they do not", first=True))
        self._values = {
            "pixel size": StatedValue(gui, "Pixel, µm", self._edited, over=0),
            "z step": StatedValue(gui, "z step, µm", self._edited),
            "numerical aperture": StatedValue(gui, "NA", self._edited, over=0),
        }
        self._light = OptionalNumber(gui, "Light, µm", over=0, hint="Wavelength; empty: 0.55 µm")
        self._choices = {axis: self._dropdown(axis) for axis in ("channel", "time", "position")}
        self._unit = gui.add_text("z unit", "", visible=False)
        self._depths = gui.add_checkbox("Depths", False, visible=False)
        self._table = gui.add_dropdown("Lines", tuple(words.TABLES.values()), visible=False)
        self._facts = HtmlBlock(gui)
        self._place_head = HtmlBlock(gui, html.head("Place on the sample"))
        self._place = HtmlBlock(gui)
        self._pattern = gui.add_text("Pattern", "", hint="Only for a grid of fields, such as r{row}_c{col}_k{k}.tif")
        self._columns = OptionalNumber(gui, "Columns", over=0, hint="Of a grid whose fields have running numbers, {n}")
        self._order = gui.add_dropdown("Numbered", tuple(words.ORDERS.values()), visible=False)
        self._corner = gui.add_dropdown("Begins", tuple(words.CORNERS.values()), visible=False)
        self._places = gui.add_text("Place table", "", hint="Of the fields: TileConfiguration.txt, MIST, .pos or CSV")
        self._only = gui.add_text("Only", "", hint="Files to take, by a pattern of their names such as img_*.png")
        self._name = gui.add_text("Name", "", hint="Of the dataset; empty: that of the folder or file")
        texts = (self._unit, self._depths, self._pattern, self._places, self._only, self._name)
        for handle in (self._light.handle, self._columns.handle, self._order, self._corner, self._table, *texts):
            handle.on_update(self._edited)

    def _dropdown(self, axis: str) -> Any:
        handle = self._page.gui.add_dropdown(
            axis.capitalize(), (_ALL if axis == "position" else _CHOOSE,), visible=False
        )
        handle.on_update(self._edited)
        return handle

    # --- what a person does

    def expect(self, drop: str) -> None:
        """Wait for all files of a drop, `number:files`, before they are looked at; the browser sends them then."""
        self._files.expect(int(drop.partition(":")[2]))
        self._awaited.show(_awaited(drop))

    def changed(self) -> None:
        """Look at the chosen files as soon as path and values rest; until then the import itself checks them."""
        self._is_current = False
        set_prop(self._button, "disabled", False)
        self._debounced.made()

    def _edited(self, event: Any) -> None:
        if event.client is not None:
            self.changed()

    def _toggle(self, what: str) -> None:
        if what == "as-listed":
            self._as_listed = not self._as_listed
        elif what == "overrule":
            self._overrule = not self._overrule
        elif what.startswith("mirror-"):
            self._mirrored ^= {what[-1]}
        self._begin()

    def _choose_other(self) -> None:
        self._stop()
        self._forget()
        self._show()

    def _import(self) -> None:
        sources, name = self._files.paths(), self._name.value.strip() or None
        if self._is_current and self._look is not None and (why := words.why_not(self._look.contents)):
            raise DatasetError(f"Not yet: {why}")
        page = self._page
        if len(sources) == 1 and page.session.exchange.is_surface(sources[0]):
            open_surface(page, sources[0], self._reading(), name)
            return
        if self._is_current and self._look is not None and self._look.contents.is_tiled:
            made = page.session.exchange.stitch_images(sources, self._options(), name=name)
            page.ask("No picture was made", made, lambda out: page.say("Picture stitched", str(out)))
            return
        done = page.session.import_images(sources, self._options(), name=name)
        page.ask("Import stopped", done, lambda _: page.change(step="surface", show=0, range_um=None, selected=None))

    def _options(self) -> ImageOptions:
        """Return the values and choices of the form. Raises WaferViewerError for text that is no number."""
        channel, time, position = (_name_of(handle, self._names(axis)) for axis, handle in self._choices.items())
        return ImageOptions(
            pixel_um=self._values["pixel size"].typed,
            z_step_um=self._values["z step"].typed,
            numerical_aperture=self._values["numerical aperture"].typed,
            wavelength_um=self._light.value,
            pattern=self._pattern.value.strip() or None,
            only=self._only.value.strip() or None,
            as_listed=self._as_listed,
            overrule=self._overrule,
            **self._grid(),
            channel=channel,
            time=time,
            position=position,
        )

    def _grid(self) -> dict[str, Any]:
        """Return how the fields are numbered, mirrored, and placed by a table, which the viewer may show."""
        columns, places = self._columns.value, self._places.value.strip()
        mirror = "both" if len(self._mirrored) > 1 else next(iter(self._mirrored), "none")
        return {
            "columns": None if columns is None else round(columns),
            "order": _key_of(words.ORDERS, self._order.value),
            "corner": _key_of(words.CORNERS, self._corner.value),
            "mirror": mirror,
            "places": self._files.existing(places) if places else None,
        }

    def _reading(self) -> Reading:
        unit = self._unit.value.strip() or None
        return Reading(
            z_unit=unit,
            pixel_um=self._values["pixel size"].typed,
            invert_z=self._depths.value,
            table=_key_of(words.TABLES, self._table.value) or None,
        )

    def _names(self, axis: str) -> tuple[str, ...]:
        choices = () if self._look is None else self._look.contents.choices
        return next((choice.names for choice in choices if choice.axis == axis), ())

    # --- the look

    def _begin(self) -> None:
        """Look at the chosen files; an earlier look is stopped, and its answer not shown."""
        self._stop()
        if self._dialog.modal.closed:
            return
        try:
            sources = self._files.chosen()
            if self._sources != sources:
                self._forget()
                self._sources = sources
            self._asked = self._options(), self._reading()
        except WaferViewerError as fault:
            self._problem = "" if self._files.is_empty else str(fault)
            self._show()
            return
        look_id = self._id = next(_looks)
        self._problem = ""
        self._progress.show(_progress(None))
        name = self._name.value.strip() or None
        begun = self._page.session.exchange.look(sources, *self._asked, name)
        begun.add_done_callback(lambda done: self._began(look_id, done))

    def _began(self, look_id: int, begun: Future[RunningWork[ImportLook]]) -> None:
        if begun.cancelled() or begun.exception() is not None:
            self._came(look_id, begun)
            return
        work = begun.result()
        if look_id != self._id:
            self._page.session.exchange.stop_look(work.id)
            return
        self._work = work
        work.done.add_done_callback(lambda done: self._came(look_id, done))

    def _came(self, look_id: int, done: Future[Any]) -> None:
        if look_id != self._id or self._dialog.modal.closed or done.cancelled():
            return
        self._work = None
        fault = done.exception()
        if fault is None:
            self._look, self._is_current = done.result(), True
        elif isinstance(fault, WaferViewerError):
            self._problem = str(fault)
        else:
            raise fault
        guarded(self._page, FAILED)(self._show)()

    def _stop(self) -> None:
        work, self._work, self._id = self._work, None, 0
        if work is not None:
            self._page.session.exchange.stop_look(work.id)

    def _forget(self) -> None:
        """Forget what belonged to other files."""
        self._look, self._sources, self._problem = None, (), ""
        self._as_listed = self._overrule = False
        self._mirrored = frozenset()
        for handle in self._choices.values():
            set_prop(handle, "visible", False)
            handle.value = handle.options[0]

    def _leave(self) -> None:
        take_drops(self._page)
        self._stop()
        leave, self._unsubscribe = self._unsubscribe, lambda: None
        leave()

    # --- what is shown

    def _show_progress(self, snapshot: Snapshot) -> None:
        work = self._work
        if work is not None and not self._dialog.modal.closed:
            share = next((each.fraction for each in snapshot.works if each.id == work.id), None)
            self._progress.show(_progress(share))

    def _show(self) -> None:
        options, reading = self._asked
        contents = None if self._look is None else self._look.contents
        self._progress.show(Markup() if not self._problem else _problem(self._problem))
        self._show_values(contents)
        if contents is None or self._look is None:
            self._foot.show("")
            self._contents.show("")
            self._sub.show(_sub("A folder of images, several files, a multi-page TIFF; or a surface file."))
        else:
            other = Markup('<span class="wv-link" {}>Other files…</span>').format(html.pick("import-other"))
            self._sub.show(_sub(words.summary(contents), other))
            self._contents.show(_contents(self._look, options))
            out = self._look.out
            if name := self._name.value.strip():
                ending = PICTURE_ENDING if contents.is_tiled else out.suffix
                out = out.with_name(f"{Path(name).name.removesuffix(ending)}{ending}")
            command = words.command_line(self._sources, options, reading, out, is_tiled=contents.is_tiled)
            self._foot.show(words.foot_html(contents, out, command))
        set_prop(self._button, "label", words.button_words(contents, options))
        set_prop(self._button, "disabled", bool(words.why_not(contents)))

    def _show_values(self, contents: FileContents | None) -> None:
        images = contents is None or contents.kind == "images"
        tiled = contents is not None and contents.is_tiled
        for name, value in self._values.items():
            value.show(contents, name, visible=(images and not tiled) or name == "pixel size")
        set_prop(self._light.handle, "visible", images and not tiled)
        for handle in (self._pattern, self._places, self._only):
            set_prop(handle, "visible", images)
        for handle in (self._columns.handle, self._order, self._corner):
            set_prop(handle, "visible", images and ("{n" in self._pattern.value or "{series" in self._pattern.value))
        for handle in (self._unit, self._depths, self._table):
            set_prop(handle, "visible", not images)
        for axis, handle in self._choices.items():
            names = self._names(axis)
            options = (_ALL if axis == "position" else _CHOOSE, *(name or "unnamed" for name in names))
            if names and handle.options != options:
                handle.options = options
            set_prop(handle, "visible", bool(names))
        self._facts.show(words.facts_html(contents) if images else "")
        self._place_head.show(html.head("Place on the sample", words.fields_words(contents)) if images else "")
        self._place.show(words.place_html(contents))


def _awaited(drop: str = "") -> Markup:
    """Return the mark of this dialog, with the drop whose files it waits for."""
    return Markup('<div class="wv-import" data-drop="{}"></div>').format(drop)


def _key_of(names: Mapping[Any, str], shown: str) -> Any:
    """Return the key of what a drop-down shows."""
    return next(key for key, name in names.items() if name == shown)


class StatedValue:
    """An optional number with its source below; while it is empty it shows the value that the files state."""

    def __init__(self, gui: viser.GuiApi, label: str, edited: Callable[[Any], None], **limits: Any) -> None:
        self._label = label
        self._field = OptionalNumber(gui, label, **limits)
        self._field.handle.on_update(edited)
        self._source = HtmlBlock(gui, padded=False)

    @property
    def typed(self) -> float | None:
        """Typed value, None if the field is empty. Raises WaferViewerError for invalid text."""
        return self._field.value

    def show(self, contents: FileContents | None, name: str, *, visible: bool) -> None:
        """Show the source of the value."""
        set_prop(self._field.handle, "visible", visible)
        source = words.source_html(contents, name, self._label, bool(self._field.handle.value.strip()))
        self._source.show(source if visible else "")


def _name_of(handle: Any, names: tuple[str, ...]) -> str | None:
    """Return the chosen name of an axis, or its number where it has no name; None if none is chosen."""
    if not handle.visible or handle.value in (_CHOOSE, _ALL):
        return None
    n = list(handle.options).index(handle.value) - 1
    return (names[n] if n < len(names) else "") or str(n)


def _contents(look: ImportLook, options: ImageOptions) -> Markup:
    found = look.contents
    if found.kind != "images":
        return Markup('<div class="wv-imp-shown">{}</div>').format(words.surface_html(found, options))
    return Markup('<div class="wv-imp-shown wv-imp-found"><div>{}</div><div>{}{}{}{}</div></div>').format(
        words.files_html(found, options.as_listed),
        words.doubts_html(found, options),
        words.frames_html(found, look.thumbnails),
        words.order_html(found),
        words.notes_html(found),
    )


def _sub(text: str, more: str = "") -> Markup:
    return Markup('<div class="wv-sub wv-imp-sub">{} {}</div>').format(text, more)


def _progress(fraction: float | None) -> Markup:
    return Markup('<div class="wv-imp-progress">{}<span>Looking at the files…</span></div>').format(html.bar(fraction))


def _problem(text: str) -> Markup:
    sign = html.icon(viser.Icon.ALERT_TRIANGLE, 17)
    return html.note("attention", "Not looked at", words.reason(text), Markup(), sign)
