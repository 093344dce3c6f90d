"""Dialogs for defects: export, KLARF overlay, golden dies, recipes and excluded areas."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import viser
from markupsafe import Markup

from wafer_viewer.draw.charts.wafer_map import MapMark
from wafer_viewer.draw.number_format import number, plural
from wafer_viewer.gui.dialogs.dialog import WAIT_S, Confirm, Dialog, ask, ask_name
from wafer_viewer.gui.dialogs.file_dialog import FileDialog
from wafer_viewer.gui.dialogs.open_and_export import FORMAT_HINT, NOT_EXPORTED
from wafer_viewer.gui.elements.elements import Dropdown, Elements, Html, Number, Text
from wafer_viewer.gui.elements.form import form
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.presenters.results import Box
from wafer_viewer.gui.scenes.thumbnails import thumbnail
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.number_field import PLACE, pair_of, pair_text
from wafer_viewer.model.errors import DatasetError, MeasureError
from wafer_viewer.model.inspection.defect import Defect, DefectRecipe, Inspection
from wafer_viewer.model.inspection.golden_die import GoldenHeader
from wafer_viewer.model.inspection.klarf import KlarfDefect, KlarfExport
from wafer_viewer.model.inspection.lot import WaferComparison
from wafer_viewer.model.inspection.wafer_map import require_notch
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import Setting, Spec, replace, settings_of
from wafer_viewer.session.inspection.inspection_files import Handover, KlarfUnit
from wafer_viewer.session.state.inspection_state import SAME_PLACE_UM, OtherTool
from wafer_viewer.session.state.snapshot import Snapshot

# -------------------------------------------------------------------------------------------------------- klarf overlay


MOST_ROWS, MOST_MARKS = 6, 400
INK = "var(--ink)"
ROUND, LEAST_PX = 3.0, 120
"""Side of the area shown relative to the defect, and its minimum in pixels of the surface."""


def place_of_other(snapshot: Snapshot, other_number: int) -> Box | None:
    """Return the box to show around a defect of the other tool; None if there is none."""
    other, surface = snapshot.defect_files.other, snapshot.surface
    if other is None or surface is None:
        return None
    pairs = zip(other.klarf.defects, other.places, strict=True)
    place = next((place for defect, place in pairs if defect.number == other_number), None)
    return _box_around(place.bounds_um, LEAST_PX * surface.pixel_um) if place is not None else None


def other_marks(other: OtherTool | None) -> list[MapMark]:
    """Return the map marks of the other tool's defects: open rings, so that our own defects stay visible inside."""
    if other is None:
        return []
    pairs = list(zip(other.klarf.defects, other.places, strict=True))[:MOST_MARKS]
    return [
        MapMark(
            place.points[0].x_um,
            place.points[0].y_um,
            INK,
            f"{other.name} {defect.number}{f', {defect.class_name}' if defect.class_name else ''}",
            attributes=html.pick("defect-other", str(defect.number)),
            shape="ring",
        )
        for defect, place in pairs
    ]


def overlay_html(other: OtherTool, defects: tuple[Defect, ...]) -> Markup:
    """Return the match counts and the table of unmatched defects as HTML."""
    compared = tuple(defect for defect in defects if defect.kind != "unmeasured")
    rest = other.unmatched(compared)
    both, n = len(other.klarf.defects) - len(rest), len(other.klarf.defects)
    away = html.link("Remove overlay", "defect-other-away")
    head = Markup('<div class="wv-h">{}<span>{}</span></div>').format(other.name, away)
    simulated = "SIMULATED. " if other.klarf.simulated else ""
    summary = (
        f"{simulated}{plural(n, 'place')} of another tool: {both} found here too, {len(rest)} not. "
        f"{len(compared) - both} found here {'is' if len(compared) - both == 1 else 'are'} not in the file. "
        f"The same within {number(other.within_um, 0)} µm; {other.by}."
    )
    notes = Markup("").join(html.remark(note, "margin-bottom:5px") for note in other.klarf.notes)
    more = (
        html.remark(f"{len(rest) - MOST_ROWS} more on the map.", "margin-bottom:5px") if len(rest) > MOST_ROWS else ""
    )
    rows = [_klarf_row(defect, other.pictures.get(defect.number, b"")) for defect, _ in rest[:MOST_ROWS]]
    table = html.table(["Not found here", "Die", "Size, µm"], rows, " nn") if rows else ""
    return Markup('{head}{lab}{notes}{table}{more}<div style="height:8px"></div>').format(
        head=head, lab=html.remark(summary, "margin-bottom:5px"), notes=notes, table=table, more=more
    )


def _klarf_row(defect: KlarfDefect, picture: bytes) -> Markup:
    title = f"{defect.number} {defect.class_name}".strip()
    name = Markup("{}{}").format(thumbnail(picture) if picture else "", title)
    size = number(defect.size_um, 1) if defect.size_um else "–"
    return html.row([name, f"{defect.col},{defect.row}", size], " nn", html.pick("defect-other", str(defect.number)))


def _box_around(bounds: Box, least_um: float) -> Box:
    x0, y0, x1, y1 = bounds
    half = max(ROUND * max(x1 - x0, y1 - y0), least_um) / 2
    x, y = (x0 + x1) / 2, (y0 + y1) / 2
    return x - half, y - half, x + half, y + half


# ------------------------------------------------------------------------------------------------------- defect dialogs


class _Named(Spec, frozen=True, kw_only=True):
    """Name and product that are typed."""

    product: Annotated[str, Setting("Product", "Product on the wafer")] = ""
    name: Annotated[str, Setting("Name", "Name in lists, exports and reports")]


NOT_CLASSES = "The class table was not changed"
NOT_GOLDEN, NOT_OVERLAID = "No golden die was kept", "The KLARF file was not overlaid"
ADDERS, NOT_COMPARED = "Adders since an earlier inspection…", "The inspections were not compared"
NEAR = "Places closer than this count as the same defect"
FORMATS: dict[str, tuple[Handover, str]] = {
    "KLARF 1.2, for yield systems": ("klarf", "-defects.klarf"),
    "KLARF 1.8": ("klarf18", "-defects.klarf"),
    "Wafer map, SEMI E142": ("e142", "-map.xml"),
    "Wafer map, SINF": ("sinf", "-map.sinf"),
    "CSV, a table": ("csv", "-defects.csv"),
    "CSV of the dies": ("dies", "-dies.csv"),
    "Training set, a folder": ("training", "-training"),
}
KLARF_LOSES = (
    "It cannot hold U, reasons, notes, unmeasured areas or who judged. Heights are in a column of our own "
    "that other readers ignore; dies not scanned whole are left out of its test plan."
)
MAP_LOSES = (
    "It has one bin for each die, pass, fail, missing or not inspected, and no defects. "
    "A die fails beyond the largest number of defects per die, which must be set; nuisances do not count."
)
LOSES: dict[Handover, str] = {
    "klarf": KLARF_LOSES,
    "klarf18": f"{KLARF_LOSES} Places are in whole nm.",
    "e142": MAP_LOSES,
    "sinf": MAP_LOSES,
    "dies": "It has state, tilts, offset, bow and brightness of every die with U, but no defects.",
    "csv": "It has every number with U and all text, but no pictures and no outlines.",
    "training": "Heights and picture round each defect, its features, your class and that of the rules. "
    "Unmeasured areas are left out. It takes a new folder.",
}
UNITS: dict[str, KlarfUnit | None] = {"As the file says": None, "µm": "um", "nm": "nm", "mm": "mm"}


class _Export(Spec, frozen=True, kw_only=True):
    """Chosen format, and what a KLARF or a map states."""

    format: str = next(iter(FORMATS))
    stated: KlarfExport = KlarfExport()


_KLARF_STATES = tuple(f"stated.{name}" for name in settings_of(KlarfExport))
STATED: dict[Handover, tuple[str, ...]] = {
    "klarf": _KLARF_STATES,
    "klarf18": _KLARF_STATES,
    "e142": ("stated.notch",),
    "sinf": ("stated.notch",),
}
"""Fields that a format states, to be typed where they are not known."""


def export_defects_dialog(page: Page) -> None:
    """Open the dialog that exports the defects; it states what the chosen format cannot hold."""
    required_inspection(page)
    snapshot = page.session.snapshot
    stem = snapshot.dataset.path.stem if snapshot.dataset is not None else "wafer"

    def choose(here: FileDialog[_Export], title: str) -> None:
        here.put("format", title)
        ending = FORMATS[title][1]
        here.save_as(f"{stem}{ending}", Path(ending).suffix)

    def contents(here: FileDialog[_Export]) -> Elements:
        what = FORMATS[here.own.format][0]
        kind = Dropdown("Format", here.own.format, partial(choose, here), FORMAT_HINT, options=tuple(FORMATS))
        stated = form(here.own, here.put, *STATED.get(what, ()))
        return [*here.files(), kind, *stated, Html(html.remark(LOSES[what], "margin-bottom:9px"))]

    def write(here: FileDialog[_Export]) -> None:
        what, target, stated = FORMATS[here.own.format][0], here.target(), here.own.stated
        if what == "training" and target.exists():
            raise DatasetError(f"{target} exists already: give the name of a new folder.")
        if what in ("klarf", "klarf18"):
            stated.require_complete()
        elif what in STATED:
            require_notch(stated.notch)
        here.write_to(target, partial(begin, what, stated))

    def begin(what: Handover, stated: KlarfExport, target: Path) -> None:
        done = page.session.defects.files.write(what, target, stated)
        page.ask(NOT_EXPORTED, done, lambda out: page.say("Exported", str(out)))

    below = "As judged now; nuisances are included and marked as such."
    data = snapshot.dataset
    known = KlarfExport.of(data.job.sample, data.job.alignment) if data is not None else KlarfExport()
    first = _Export(stated=known)
    answer, name = (
        Confirm("Export", viser.Icon.DOWNLOAD, write, NOT_EXPORTED, commands=False),
        f"{stem}{FORMATS[first.format][1]}",
    )
    FileDialog(page, "Export the defects", below, answer, "any", first, contents, rows=7, saving=name)


@dataclass(frozen=True, slots=True)
class _Overlay:
    unit: str = next(iter(UNITS))
    within_um: float = SAME_PLACE_UM


def klarf_dialog(page: Page) -> None:
    """Open the dialog that overlays the defects of another tool from a KLARF file."""
    unit_hint = "Of its lengths; KLARF is in µm where it does not say"

    def contents(here: FileDialog[_Overlay]) -> Elements:
        own, put = here.own, partial(partial, here.put)
        unit = Dropdown("Unit", own.unit, put("unit"), unit_hint, options=tuple(UNITS))
        within = Number("Same within, µm", own.within_um, put("within_um"), NEAR, step=5.0, decimals=2, least=0.0)
        return [*here.files(), here.upload(), unit, within]

    def lay(here: FileDialog[_Overlay]) -> None:
        source, own = here.path(), here.own
        page.session.defects.files.lay_over(source, UNITS[own.unit], own.within_um).result(WAIT_S)
        page.redraw()

    below = "Compares the places in a KLARF file with those found here: what both found, and what only one did."
    answer = Confirm("Overlay", viser.Icon.STACK_2, lay, NOT_OVERLAID)
    FileDialog(page, "Overlay a KLARF file", below, answer, "klarf", _Overlay(), contents, rows=6)


def earlier_dialog(page: Page) -> None:
    """Open the dialog that compares with an earlier inspection; then the added defects are listed alone."""

    def contents(here: FileDialog[None]) -> Elements:
        return [*here.files(), here.upload()]

    def compare(here: FileDialog[None]) -> None:
        page.session.defects.files.compare(here.path()).result(WAIT_S)
        list_added(page)

    below = "An inspected dataset of this wafer, or a KLARF file. Dies that only one of them inspected stay out."
    answer = Confirm("Compare", viser.Icon.ARROWS_DIFF, compare, NOT_COMPARED)
    FileDialog(page, "Adders since an earlier inspection", below, answer, "inspected", None, contents, rows=7)


def list_added(page: Page) -> None:
    """List the defects alone that the earlier inspection does not have."""
    if (earlier := page.session.snapshot.defect_files.earlier) is not None:
        page.change(defects=replace(page.view.defects.widened, numbers=earlier.added), review=None)


def earlier_html(earlier: WaferComparison) -> Markup:
    """Return the numbers of added, removed and common defects as HTML, with the link that lists the added ones."""
    away = html.link("Remove", "defect-earlier-away")
    head = Markup('<div class="wv-h">Since {}<span>{}</span></div>').format(earlier.first, away)
    chance = f", by chance {number(earlier.by_chance, 1)} at most" if earlier.by_chance is not None else ""
    blind = len(earlier.not_inspected_before), len(earlier.not_inspected_after)
    kept_out = f" On dies that only one inspected: {blind[1]} before, {blind[0]} now." if any(blind) else ""
    added = html.link(f"{len(earlier.added)} added", "defect-added") if earlier.added else Markup("None added")
    by = f" {earlier.dies[:1].upper()}{earlier.dies[1:]}." if earlier.dies else ""
    told = f" · {len(earlier.removed)} removed · {len(earlier.common)} common{chance}.{by}{kept_out}"
    notes = Markup("").join(html.remark(note, "margin-bottom:5px") for note in earlier.notes)
    return Markup('{}<div class="wv-sub">{}{}</div>{}<div style="height:8px"></div>').format(
        head, added, html.typeset(told), notes
    )


def classes_dialog(page: Page) -> None:
    """Open the dialog that loads a fab's class table for what was found; without a file, the built-in one."""
    used = required_inspection(page).recipe.class_table
    rows = [html.row([entry.code, entry.title, entry.key, str(entry.klarf_number)], "   n") for entry in used.offered]
    table = html.table(["Code", "Class", "Key", "KLARF"], rows, "   n")

    def load(here: FileDialog[None]) -> None:
        path = here.path() if here.text.strip() else None
        page.session.defects.load_classes(path).result(WAIT_S)
        page.redraw()

    def contents(here: FileDialog[None]) -> Elements:
        return [Html(table), *here.files(), here.upload()]

    below = (
        "A TOML file with name, code, colour, key and KLARF number of each class; an empty path is the built-in table."
    )
    answer = Confirm("Use these classes", viser.Icon.TAGS, load, NOT_CLASSES)
    FileDialog(page, "Class table", below, answer, "classes", None, contents, rows=4)


def golden_dialog(page: Page) -> None:
    """Open the dialog that saves the median die of this wafer as the next version of a golden die."""
    inspection, files = required_inspection(page), page.session.snapshot.defect_files
    if inspection.grid is None:
        raise MeasureError("A golden die is made from dies and this inspection has none: inspect die to die first.")
    product = inspection.product
    below = (
        f"The median of the dies of this wafer{f' of {product}' if product else ''}, with its spread from die to die. "
        "Under an existing name it becomes the next version; earlier versions are kept."
    )

    def keep(here: Dialog[_Named]) -> None:
        name = here.own.name.strip()
        if not name:
            raise DatasetError("The golden die has no name: type one, such as that of the product.")
        done = page.session.defects.files.keep_golden(name)
        page.ask(NOT_GOLDEN, done, lambda out: page.say("Golden die kept", str(out)))

    def fields(here: Dialog[_Named]) -> Elements:
        return [
            *form(here.own, here.put, "name"),
            Html(html.remark(_next_version(page, here.own.name.strip()), "margin-bottom:9px")),
        ]

    named = next((header.name for header in files.golden if product and header.product == product), product)
    answer = Confirm("Keep", viser.Icon.CHECK, keep, NOT_GOLDEN)
    Dialog(page, "Keep as golden die", below, answer, _Named(name=named), fields)


def golden_file_dialog(page: Page, then: Callable[[GoldenHeader], None]) -> None:
    """Open the dialog that imports a golden die from a file, and pass its header to `then`."""

    def take(here: FileDialog[None]) -> None:
        then(page.session.defects.files.add_golden(here.path()).result(WAIT_S))
        page.redraw()

    def contents(here: FileDialog[None]) -> Elements:
        return [*here.files(), here.upload()]

    below = "A file NAME.3.golden.npz. It is copied into the data folder, as the next version of its name."
    answer = Confirm("Use this golden die", viser.Icon.DIAMOND, take, "No golden die was chosen")
    FileDialog(page, "Choose a golden die", below, answer, "golden", None, contents, rows=7)


def save_recipe_dialog(page: Page, recipe: DefectRecipe, then: Callable[[DefectRecipe], None]) -> None:
    """Open the dialog that saves a recipe under a product and a name, and pass it to `then`.

    An existing recipe of that name is replaced only after confirmation.
    """
    of = recipe.product or "its product"
    below = f"Kept beside the datasets. It is applied automatically when a dataset of {of} opens."

    def save(here: Dialog[_Named]) -> None:
        named = replace(recipe, product=here.own.product.strip(), name=here.own.name.strip())
        stored = page.session.snapshot.defect_files.recipes_of(named.product)
        if any(recipe.name == named.name and recipe != named for recipe in stored):
            lost = f"It is a recipe of {named.product} already; its present settings are lost."
            title, over = f"Replace recipe {named.name}?", lambda _: keep(named)
            ask(page, title, lost, Confirm(f"Replace {named.name}", viser.Icon.REPLACE, over, "Nothing was replaced"))
        else:
            keep(named)

    def keep(named: DefectRecipe) -> None:
        page.session.defects.files.save_recipe(named).result(WAIT_S)
        then(named)
        page.redraw()

    answer = Confirm("Save", viser.Icon.DEVICE_FLOPPY, save, "It was not saved")
    Dialog(page, "Save the recipe", below, answer, _Named(name=recipe.name, product=recipe.product))


def recipes_dialog(page: Page) -> None:
    """Open the dialog that lists the saved recipes, to rename or delete them."""
    files = page.session.snapshot.defect_files
    problems = (html.remark(text, "margin-bottom:9px") for text in files.problems)
    listed = Markup("").join((recipe_table(files.recipes), *problems))

    def choose(change: Callable[[Page, DefectRecipe], None], here: Dialog[None], key: str) -> None:
        here.close()
        change(page, files.recipes[int(key)])

    picks = {
        "defect-recipe-name": partial(choose, _rename_dialog),
        "defect-recipe-away": partial(choose, _delete_dialog),
    }
    below = "The one saved last is applied automatically when a dataset of its product is opened."
    Dialog(page, "Recipes for defects", below, None, None, lambda _: [Html(listed)], picks)


def recipe_table(recipes: tuple[DefectRecipe, ...]) -> Markup:
    """Return the table of recipes as HTML, with links to rename and delete each."""
    if not recipes:
        return html.empty("No recipe is saved yet.")
    return html.table(
        ["Recipe", "Product", "Sensitivity", ""], [_recipe_row(*each) for each in enumerate(recipes)], "  n"
    )


def _recipe_row(place: int, recipe: DefectRecipe) -> Markup:
    verbs = Markup(" · ").join(
        Markup('<span class="wv-link" title="{}" {}>{}</span>').format(
            f"{verb} {recipe.name}", html.pick(what, place), verb
        )
        for verb, what in (("Rename…", "defect-recipe-name"), ("Delete…", "defect-recipe-away"))
    )
    return html.row([recipe.name, recipe.product, f"{recipe.sensitivity:g}", verbs], "  n")


def required_inspection(page: Page) -> Inspection:
    """Return the inspection result. Raises MeasureError if the surface has not been inspected."""
    if (inspection := page.session.snapshot.inspection.inspection) is None:
        raise MeasureError("The surface has not been inspected yet: inspect it for defects first.")
    return inspection


def _rename_dialog(page: Page, recipe: DefectRecipe) -> None:
    def rename(name: str) -> None:
        page.session.defects.files.rename_recipe(recipe, name.strip()).result(WAIT_S)
        page.redraw()

    ask_name(page, f"Rename recipe {recipe.name}", f"It stays a recipe of {recipe.product}.", recipe.name, rename)


def _delete_dialog(page: Page, recipe: DefectRecipe) -> None:
    def delete(_: object) -> None:
        page.session.defects.files.delete_recipe(recipe).result(WAIT_S)
        page.redraw()

    below = f"A recipe of {recipe.product}. Its file is deleted; this cannot be undone."
    answer = Confirm(f"Delete {recipe.name}", viser.Icon.TRASH, delete, "The recipe was not changed")
    ask(page, f"Delete recipe {recipe.name}?", below, answer)


def _next_version(page: Page, name: str) -> str:
    versions = [header.version for header in page.session.snapshot.defect_files.golden if header.name == name]
    return f"It will be version {max(versions, default=0) + 1}." if name else ""


@dataclass(frozen=True, slots=True)
class Errand:
    """Command on all defects: name, short name, failure title, icon and dialog."""

    name: str
    short: str
    failed: str
    icon: Any
    ask: Callable[[Page], None]


PROPOSE, NOT_PROPOSED = "Propose classes from judgements", "No classes were proposed"


def propose_classes(page: Page) -> None:
    """Propose classes for the open defects from the judged ones, and list them with the least certain first."""

    def tell(inspection: Inspection) -> None:
        if inspection.learned is not None:
            page.change(defects=replace(page.view.defects, sort="doubt"), review=None)
            page.say("Classes are proposed, the least certain first", f"{inspection.learned.words} Alt + Y agrees.")

    page.ask(NOT_PROPOSED, page.session.defects.propose_classes(), tell)


ERRANDS: dict[str, Errand] = {
    "export": Errand("Export the defects…", "Export…", NOT_EXPORTED, viser.Icon.DOWNLOAD, export_defects_dialog),
    "golden": Errand("Keep as golden die…", "Golden die…", NOT_GOLDEN, viser.Icon.DIAMOND, golden_dialog),
    "classes": Errand("Class table…", "Classes…", NOT_CLASSES, viser.Icon.TAGS, classes_dialog),
    "learn": Errand(PROPOSE, "Propose classes", NOT_PROPOSED, viser.Icon.BULB, propose_classes),
    "earlier": Errand(ADDERS, "Adders…", NOT_COMPARED, viser.Icon.ARROWS_DIFF, earlier_dialog),
    "klarf": Errand("Overlay a KLARF file…", "Overlay KLARF…", NOT_OVERLAID, viser.Icon.STACK_2, klarf_dialog),
}
"""Commands in the header of the defect list and in the command palette."""


Areas = tuple[Region, ...]
STAYS, CORNER = "The areas were not changed", "corner of a new one, x, y from that of the die; empty: none"
ROOM = 0.25
"""Margin around a defect as a share of its size; its position varies slightly from die to die."""
BELOW = (
    "Areas of every die, µm from its lower left corner, that are not searched: numbers and probe marks differ from "
    "die to die. They are part of the recipe; defects already found stay until the surface is inspected again."
)


@dataclass(frozen=True, slots=True)
class _Excluded:
    """Areas of the dialog, and the corners of a new one as they are typed."""

    areas: Areas
    start: str = ""
    end: str = ""


def excluded_dialog(page: Page, areas: Areas, keep: Callable[[Areas], None], proposed: Areas = ()) -> None:
    """Open the dialog that lists the excluded areas, to be edited or removed, and takes two corners of a new one.

    proposed: further areas, such as that of the defect under review. Nothing changes before Keep is pressed.
    """

    def fields(here: Dialog[_Excluded]) -> Elements:
        own = here.own
        return [
            Html(area_table(own.areas)),
            Text("From, µm", own.start, partial(here.put, "start"), f"Lower left {CORNER}"),
            Text("To, µm", own.end, partial(here.put, "end"), f"Upper right {CORNER}"),
        ]

    def without(here: Dialog[_Excluded], key: str, **typed: str) -> None:
        k = int(key)
        here.keep(areas=(*here.own.areas[:k], *here.own.areas[k + 1 :]), **typed)

    def change(here: Dialog[_Excluded], key: str) -> None:
        x0, y0, x1, y1 = here.own.areas[int(key)].bounds_um
        without(here, key, start=pair_text((x0, y0), PLACE), end=pair_text((x1, y1), PLACE))

    answer = Confirm("Keep", viser.Icon.CHECK, lambda d: keep((*d.own.areas, *_typed_area(d.own))), STAYS)
    picks = {"defect-area-change": change, "defect-area-away": without}
    Dialog(page, "Excluded areas", BELOW, answer, _Excluded((*areas, *proposed)), fields, picks)


def _typed_area(own: _Excluded) -> Areas:
    """Return the rectangle between the typed corners; empty if none are typed.

    Raises MeasureError if one corner is missing or the rectangle is empty.
    """
    start, end = pair_of(own.start, "From, µm"), pair_of(own.end, "To, µm")
    if start is None and end is None:
        return ()
    if start is None or end is None:
        raise MeasureError("One corner of the area is missing: type both, or leave both empty.")
    if start[0] == end[0] or start[1] == end[1]:
        raise MeasureError("The area is empty: type two opposite corners of a rectangle.")
    return (Region.rectangle(*map(min, start, end), *map(max, start, end)),)


def area_of_defect(defect: Defect | None) -> Areas:
    """Return the rectangle around a defect, relative to the corner of its die; empty if it is on no die."""
    if defect is None or defect.in_die is None:
        return ()
    x0, y0, x1, y1 = defect.outline.bounds_um
    half_x, half_y = (x1 - x0) * (0.5 + ROOM), (y1 - y0) * (0.5 + ROOM)
    u, v = defect.in_die.x_um, defect.in_die.y_um
    return (Region.rectangle(*(round(um, 1) for um in (u - half_x, v - half_y, u + half_x, v + half_y))),)


def area_table(areas: Areas) -> Markup:
    """Return the table of excluded areas with links to edit and remove them, as HTML."""
    if not areas:
        return html.empty("The whole die is searched.")
    return html.table(["", "x, µm", "y, µm", ""], [_row(k, area) for k, area in enumerate(areas)], " nn ")


def _row(k: int, area: Region) -> Markup:
    """Return the table row of an area as HTML; only rectangles can be edited."""
    x0, y0, x1, y1 = area.bounds_um
    change, away = ("Change", "change", "Edit its corners"), ("Remove", "away", "Search there again")
    verbs = Markup(" · ").join(
        Markup('<span class="wv-link" title="{}" {}>{}</span>').format(title, html.pick(f"defect-area-{what}", k), verb)
        for verb, what, title in ((change, away) if area.kind == "rectangle" else (away,))
    )
    spans = (f"{number(low, 1)} – {number(high, 1)}" for low, high in ((x0, x1), (y0, y1)))
    return html.row([str(k + 1), *spans, Markup('<span style="white-space:nowrap">{}</span>').format(verbs)], " nn ")
