"""Import dialog: files are looked at in the background before anything is imported."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, wait
from dataclasses import replace as with_changes
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import viser
from markupsafe import Markup

from wafer_viewer.gui.dialogs.dialog import Confirm
from wafer_viewer.gui.dialogs.file_dialog import FileDialog
from wafer_viewer.gui.dialogs.open_and_export import SHOW_SURFACE, open_surface
from wafer_viewer.gui.elements.elements import Button, Dropdown, Elements, Fold, Html, Input, NumberOrEmpty
from wafer_viewer.gui.elements.form import spec_input
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.presenters import import_contents as words
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.ask import Answer
from wafer_viewer.gui.widgets.callbacks import Debouncer, guarded
from wafer_viewer.model.acquisition.image_source import ImageOptions, Mirror
from wafer_viewer.model.errors import DatasetError, WaferViewerError
from wafer_viewer.model.file_contents import FileContents
from wafer_viewer.model.spec import Setting, Spec, replace, value_at
from wafer_viewer.model.surface_format import Reading
from wafer_viewer.session.files.file_jobs import PICTURE_ENDING, ImportLook
from wafer_viewer.session.state.snapshot import Fault, Snapshot

FAILED = "The files were not read"
PAUSE_S = 0.5
"""Pause in typing after which the files are looked at."""
FIRST_WORDS = "A folder of images, several files, a multi-page TIFF; or a surface file."
_CHOOSE, _ALL = "choose…", "all"
_STATED = {"pixel_um": "pixel size", "z_step_um": "z step", "numerical_aperture": "numerical aperture"}
"""Facts of files by the option whose field shows them while it is empty."""
_AXES = {"channel": "Of the images, the one to take", "time": "Point in time to take", "position": "Fields to take"}
_MIRRORS: dict[frozenset[str], Mirror] = {
    frozenset(): "none",
    frozenset("x"): "x",
    frozenset("y"): "y",
    frozenset("xy"): "both",
}
Asked = tuple[tuple[Path, ...], ImageOptions, Reading, str | None]
"""Files to look at, values and choices, and the name of the dataset to make."""


class _Form(Spec, frozen=True, kw_only=True):
    """Values and choices of a person."""

    options: ImageOptions = ImageOptions()
    reading: Reading = Reading()
    places: Annotated[str, Setting("Place table", "Of the fields: TileConfiguration.txt, MIST, .pos or CSV")] = ""
    name: Annotated[str, Setting("Name", "Of the dataset; empty: that of the folder or file")] = ""

    def for_other_files(self) -> _Form:
        """Return the form without what belonged to the files that were chosen before."""
        forgotten = dict.fromkeys(_AXES), {"as_listed": False, "overrule": False, "mirror": "none"}
        return replace(self, options=replace(self.options, **forgotten[0], **forgotten[1]))


def import_dialog(page: Page) -> None:
    """Open the import dialog: folder of images, multi-page TIFF or surface file, also as an upload."""
    ImportDialog(page)


def take_drops(page: Page) -> None:
    """Open the import dialog on files that are dropped on the page; the browser sends them to the dialog."""
    page.on_pick("import-drop", lambda drop: ImportDialog(page).take_drop(drop))


class ImportDialog(FileDialog[_Form]):
    """List of files on the left until one is chosen, then what they hold; values and choices on the right."""

    def __init__(self, page: Page) -> None:
        self._drop = self._fault = ""
        self._sources: tuple[Path, ...] = ()
        self._asked: Asked | None = None
        self._look: ImportLook | None = None
        self._is_current = False
        self._work_id = ""
        self._stop: Callable[[], None] = lambda: None
        self._rested = Debouncer(self._take_files, guarded(page, FAILED), PAUSE_S)
        answer = Confirm("Import", viser.Icon.PHOTO_PLUS, ImportDialog._import, "Import stopped")
        title, contents = "Import images or a surface", ImportDialog._contents
        super().__init__(page, title, "", answer, "images", _Form(), contents, rows=6)
        page.on_pick("import-toggle", self._toggle)
        page.on_pick("import-other", lambda _: self._use(()))
        page.on_pick("import-drop", self.take_drop)
        page.on_close(self._end_look)

    # --- what a person does

    def take_drop(self, drop: str) -> None:
        """Wait for all files of a drop, `number:files`, before they are looked at; the browser sends them then."""
        self.expect(int(drop.partition(":")[2]))
        self._drop = drop
        self.redraw()

    def opened(self) -> None:
        """Look at the file."""
        self.changed()

    def changed(self) -> None:
        """Look at the chosen files as soon as the path rests; until then the import itself checks them."""
        self._is_current = False
        self._rested.made()
        self.redraw()

    def close(self) -> None:
        """Close the dialog, and stop to look."""
        super().close()
        take_drops(self.page)
        self._end_look()

    def _take_files(self) -> None:
        self._fault = ""
        try:
            self._use(self.chosen())
        except WaferViewerError as fault:
            self._fault = "" if self.is_empty else str(fault)
            self.redraw()

    def _use(self, sources: tuple[Path, ...]) -> None:
        if sources != self._sources:
            self._sources, self.own = sources, self.own.for_other_files()
        self.redraw()

    def _toggle(self, what: str) -> None:
        options = self.own.options
        if what.startswith("mirror-"):
            axes = next(axes for axes, mirror in _MIRRORS.items() if mirror == options.mirror)
            self.put("options.mirror", _MIRRORS[axes ^ {what[-1]}])
        else:
            name = what.replace("-", "_")
            self.put(f"options.{name}", not value_at(options, name))

    def _import(self) -> None:
        page, sources, contents = self.page, self.paths(), self._found
        if self._is_current and (why := words.why_not(contents)):
            raise DatasetError(f"Not yet: {why}")
        _, options, reading, name = self._question(sources)
        if len(sources) == 1 and page.session.exchange.is_surface(sources[0]):
            open_surface(page, sources[0], reading, name)
        elif self._is_current and contents is not None and contents.is_tiled:
            made = page.session.exchange.stitch_images(sources, options, name=name)
            page.ask("No picture was made", made, lambda out: page.say("Picture stitched", str(out)))
        else:
            done = page.session.import_images(sources, options, name=name)
            page.ask("Import stopped", done, lambda _: page.change(**SHOW_SURFACE))

    def _question(self, sources: tuple[Path, ...]) -> Asked:
        """Return what is asked about files. Raises DatasetError if the table of places does not exist."""
        own = self.own
        places = self.existing(own.places) if own.places.strip() else None
        reading = replace(own.reading, pixel_um=own.options.pixel_um)
        return sources, replace(own.options, places=places), reading, own.name.strip() or None

    def tell(self, fault: Fault) -> None:
        """Show that a value is wrong."""
        self._fault = fault.text
        self.redraw()

    def settle(self, title: str) -> None:
        """Forget that a value was wrong, as there is another one."""
        self._fault = ""

    # --- the look

    @property
    def _found(self) -> FileContents | None:
        return None if self._look is None else self._look.contents

    def _ask_look(self) -> Answer[ImportLook]:
        """Return the newest look at the files, and begin another one if they or the values have changed."""
        asked, fault = None, self._fault
        try:
            asked = self._question(self._sources)
        except WaferViewerError as wrong:
            fault = fault or str(wrong)
        if asked != self._asked:
            self._end_look()
            self._asked = asked
        if asked is None or fault:
            self._is_current = False
            return Answer(self._look, fault)
        look = partial(self._look_at, asked) if self._sources else None
        answer = self.ask("files to import", asked, look, FAILED, about=(self, self._sources))
        self._look = answer.value if answer.value is not None or not answer.problem else self._look
        self._is_current = answer.value is not None and not (answer.computing or self._rested.under_way)
        return answer

    def _look_at(self, asked: Asked) -> ImportLook:
        """Look at files on the thread of the question, until another one is asked."""
        exchange = self.page.session.exchange
        work, ended = exchange.look(*asked).result(), Future[Any]()

        def stop() -> None:
            exchange.stop_look(work.id)
            ended.cancel()

        self._work_id, self._stop = work.id, stop
        if self._asked is not asked or self.modal.closed:
            self._end_look()
        wait((work.done, ended), return_when=FIRST_COMPLETED)
        if ended.cancelled():
            raise CancelledError
        self._work_id, self._stop = "", lambda: None
        return work.done.result()

    def _end_look(self) -> None:
        self._work_id, stop, self._stop = "", self._stop, lambda: None
        stop()

    # --- what is shown

    def _contents(self) -> Elements:
        look = self._ask_look()
        contents, options = self._found, self.own.options
        other = html.link("Other files…", "import-other")
        shown = _contents(self._look, options) if self._look is not None else Markup()
        return [
            Html(_sub(words.summary(contents), other) if contents is not None else _sub(FIRST_WORDS)),
            Html(_progress(self.snapshot, self._work_id) if look.computing else _problem(look.problem)),
            Html(Markup('<div class="wv-import" data-drop="{}"></div>').format(self._drop), padded=False),
            Fold("·", [*self.files(), self.upload(), Html(shown)], unfolded=True),
            Fold("·", self._values(contents), unfolded=True),
            Html(Markup('<div class="wv-imp-end"></div>'), padded=False),
            Html(self._foot(contents) if contents is not None else ""),
        ]

    def _foot(self, contents: FileContents) -> Markup:
        own, out = self.own, self._look.out if self._look is not None else Path()
        if name := own.name.strip():
            ending = PICTURE_ENDING if contents.is_tiled else out.suffix
            out = out.with_name(f"{Path(name).name.removesuffix(ending)}{ending}")
        sources, options, reading, _ = self._asked or (self._sources, own.options, own.reading, None)
        return words.foot_html(
            contents, out, words.command_line(sources, options, reading, out, is_tiled=contents.is_tiled)
        )

    def button(self, answer: Confirm) -> Button:
        """Return the confirming button, which names a gap; off without files or with something unsettled."""
        label = words.button_words(self._found, self.own.options)
        off = self.is_empty or (self._is_current and bool(words.why_not(self._found)))
        return with_changes(super().button(answer), label=label, disabled=off)

    def _values(self, contents: FileContents | None) -> Elements:
        images, own = contents is None or contents.kind == "images", self.own
        frames = images and not (contents is not None and contents.is_tiled)
        numbered = images and any(part in (own.options.pattern or "") for part in ("{n", "{series"))
        place = html.head("Place on the sample", words.fields_words(contents))
        return [
            Html(html.head("What the files say", "type what they do not", first=True)),
            *self._stated(contents, "pixel_um", over=0),
            *(self._stated(contents, "z_step_um") if frames else (None, None)),
            *(self._stated(contents, "numerical_aperture", over=0) if frames else (None, None)),
            self._field("options.wavelength_um", frames, over=0),
            *(self._choice(contents, axis) for axis in _AXES),
            *(self._field(f"reading.{name}", not images) for name in ("z_unit", "invert_z", "table")),
            Html(words.facts_html(contents) if images else ""),
            Html(place if images else ""),
            Html(words.place_html(contents)),
            self._field("options.pattern", images),
            *(self._field(f"options.{name}", numbered) for name in ("columns", "order", "corner")),
            *(self._field(path, images) for path in ("places", "options.only")),
            self._field("name"),
        ]

    def _field(self, path: str, shown: bool = True, **limits: Any) -> Input | None:
        put, value = partial(self.put, path), value_at(self.own, path)
        return spec_input(_Form, path, value, put, pause_s=PAUSE_S, **limits) if shown else None

    def _stated(self, contents: FileContents | None, name: str, **limits: Any) -> Elements:
        """Return the field of a value, and the line below with its source."""
        field = self._field(f"options.{name}", **limits)
        typed = isinstance(field, NumberOrEmpty) and field.value is not None
        label = field.label if field is not None else ""
        return [field, Html(words.source_html(contents, _STATED[name], label, typed), padded=False)]

    def _choice(self, contents: FileContents | None, axis: str) -> Dropdown | None:
        """Return the list of the names on an axis of the files; one without a name is chosen by its number."""
        names = next((one.names for one in contents.choices if one.axis == axis), ()) if contents is not None else ()
        if not names:
            return None
        options = (_ALL if axis == "position" else _CHOOSE, *(name or "unnamed" for name in names))
        keys = (None, *(name or str(n) for n, name in enumerate(names)))
        chosen = value_at(self.own.options, axis)
        title = options[keys.index(chosen)] if chosen in keys else options[0]
        put = lambda title: self.put(f"options.{axis}", keys[options.index(title)])  # noqa: E731 - short
        return Dropdown(axis.capitalize(), title, put, _AXES[axis], options=options)


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


def _progress(snapshot: Snapshot, work_id: str) -> Markup:
    """Return the bar of a look."""
    fraction = next((work.fraction for work in snapshot.works if work.id == work_id), None)
    return Markup('<div class="wv-imp-progress">{}<span>Reading the files …</span></div>').format(html.bar(fraction))


def _problem(text: str) -> Markup:
    if not text:
        return Markup()
    sign = html.icon(viser.Icon.ALERT_TRIANGLE, 17)
    return html.note("attention", "Not read", words.reason(text), Markup(), sign)
