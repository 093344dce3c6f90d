"""Inspection form: recipe, sensitivity, comparison, die grid and limits, with the texts that explain them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from concurrent.futures import Future
from dataclasses import replace
from datetime import datetime
from typing import Any

import viser
from markupsafe import Markup

from wafer_viewer.draw.number_format import number
from wafer_viewer.gui.defects.defect_dialogs import golden_file_dialog, recipes_dialog, save_recipe_dialog
from wafer_viewer.gui.page.dialogs import format_time
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.presenters.defects import per_mm2
from wafer_viewer.gui.presenters.inspection_form import (
    AGAINST,
    DIES,
    EVIDENCE,
    GIVEN,
    GOLDEN,
    DefectForm,
    against_of,
    dies_of,
    form_of,
    limits_of,
    recipe_of,
    text_of,
)
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.callbacks import Debouncer, guarded, tell_failure
from wafer_viewer.gui.widgets.controls import (
    BoundInput,
    HtmlBlock,
    button,
    command_button,
    in_a_row,
    set_prop,
    with_decimals,
)
from wafer_viewer.gui.widgets.number_field import PLACE, OptionalPair
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.inspection.defect import DefectLimits, DefectRecipe, Inspection, threshold_of
from wafer_viewer.model.inspection.golden_die import GoldenHeader
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import replace as changed
from wafer_viewer.session.state.inspection_state import DefectFilesState, product_of
from wafer_viewer.session.state.snapshot import Snapshot

WAFER_MM2 = math.pi * 150.0**2
"""Area of a 300 mm wafer."""
MOST_GOLDEN = 12


def expectation(sensitivity: float, inspection: Inspection | None) -> str:
    """Return the expected false defects at a sensitivity: per mm², on the inspected area, on a 300 mm wafer."""
    above = f"From {number(threshold_of(sensitivity), 1)} times the noise."
    expected = inspection.expected_false_at(sensitivity) if inspection is not None else None
    if inspection is None or expected is None:
        return f"{above} The expected number of false ones is shown after the first inspection."
    here, wafer = _expected_count_text(expected * inspection.inspected_mm2), _expected_count_text(expected * WAFER_MM2)
    return (
        f"{above} Expected to be false by noise alone: {per_mm2(expected)}, {here} here, {wafer} on a wafer of 300 mm."
    )


def recipe_origin_text(recipe: DefectRecipe, now: DefectRecipe, files: DefectFilesState, inspected: bool) -> str:
    """Return the origin of the form's settings and whether they were changed; `now` is its present recipe."""
    newest = files.recipe_of(recipe.product)
    if now in files.recipes:
        by_itself = " Applied automatically because it was saved last." if not inspected and now == newest else ""
        return f"Recipe “{now.name}” of {now.product}, as saved.{by_itself}"
    if inspected and now == recipe:
        return "As the surface was inspected; not saved."
    if recipe in files.recipes:
        return f"Recipe “{recipe.name}” of {recipe.product}, changed, not saved."
    if not now.product:
        return "Without a product no recipe can be saved."
    if files.recipes_of(now.product):
        return f"As no recipe of {now.product} that is kept."
    return f"No recipe of {now.product} is kept."


def unreadable(files: DefectFilesState) -> str:
    """Return a sentence with the number of unreadable recipe files; empty if there are none."""
    n = len(files.problems)
    return f"{n} recipe {'file' if n == 1 else 'files'} cannot be read: Recipes… says why." if n else ""


def golden_table(files: DefectFilesState, product: str, chosen: str) -> Markup:
    """Return the table of golden dies of a product as HTML; those of other products are only counted."""
    mine = [header for header in files.golden if not product or header.product in ("", product)]
    others = len(files.golden) - len(mine)
    others_text = f"{others} of other products" if others else ""
    link = Markup('<div class="wv-lab"><span class="wv-link" {}>From a file…</span></div>').format(
        html.command_pick("defect-golden-file")
    )
    if not mine:
        return (
            html.empty("No golden die is kept", "compare with the fitted form, or die to die.")
            + _lab(others_text)
            + link
        )
    rows = [_row(header, name, name == chosen) for header, name in _named(mine)][:MOST_GOLDEN]
    hidden = f"{len(mine) - MOST_GOLDEN} older ones" if len(mine) > MOST_GOLDEN else ""
    more = " and ".join(part for part in (hidden, others_text) if part)
    return (
        html.table(["Golden die", "Dies", "Kept"], rows, " nn") + _lab(f"{more} are not listed." if more else "") + link
    )


def advanced_settings_header(form: DefectForm, unfolded: bool) -> Markup:
    """Return the header of the additional settings as HTML, with a summary while they are folded."""
    link = Markup('<span class="wv-link" {}>{}</span>').format(
        html.pick("defect-more"), "Less" if unfolded else "Change…"
    )
    if unfolded:
        return Markup('<div class="wv-h">More settings<span>{}</span></div>').format(link)
    limits = [text for text in (form.max_per_die and f"{form.max_per_die} per die", _a_mm2(form.max_per_mm2)) if text]
    parts = (
        form.evidence,
        f"scales {form.scales_px} px",
        *((areas(form),) if form.excluded else ()),
        f"dies: {form.dies[0].lower()}{form.dies[1:]}",
        f"at most {' and '.join(limits)}" if limits else "no limits",
    )
    return Markup('<div class="wv-lab" style="margin:2px 0 6px">{} · {}</div>').format("; ".join(parts), link)


def exclusion_line_html(form: DefectForm) -> Markup:
    """Return the form's line about excluded areas, with a link to edit them, as HTML."""
    link = Markup('<span class="wv-link" {}>Areas…</span>').format(html.pick("defect-excluded"))
    text = areas(form)
    return Markup('<div class="wv-lab" style="margin:2px 0 6px">{}{} · {}</div>').format(
        text[0].upper(), text[1:], link
    )


def areas(form: DefectForm) -> str:
    """Return the number of excluded areas in words."""
    n = len(form.excluded)
    return f"{n} {'area' if n == 1 else 'areas'} of every die left out" if n else "the whole die is searched"


def _a_mm2(text: str) -> str:
    return f"{text} per mm²" if text else ""


def _named(headers: tuple[GoldenHeader, ...] | list[GoldenHeader]) -> Iterator[tuple[GoldenHeader, str]]:
    """Yield each header with its name in a recipe.

    The newest version is named without a number, so that the recipe follows later versions.
    """
    names: set[str] = set()
    for header in headers:
        yield header, f"{header.name}.{header.version}" if header.name in names else header.name
        names.add(header.name)


def _row(header: GoldenHeader, name: str, chosen: bool) -> Markup:
    version = f"version {header.version}" + ("" if "." in name else ", the newest")
    product, made_of = header.product or "no product", header.made_of or "a file"
    title = f"{header.name} version {header.version} of {product}, made of {made_of}"
    label = Markup('<span class="wv-cut wv-short" title="{}">{}</span>').format(title, header.name)
    cells = [Markup("{}<small>{}</small>").format(label, version), number(header.dies, 0), _kept_on(header)]
    attributes = Markup('{} aria-pressed="{}"').format(html.pick("defect-golden", name), str(chosen).lower())
    return html.row(cells, " nn", attributes, "sel" if chosen else "")


def _kept_on(header: GoldenHeader) -> str:
    return format_time(header.made_at, datetime.now().astimezone())


def _expected_count_text(count: float) -> str:
    """Return an expected count rounded to two digits; one decimal below ten, "under 0.1" below 0.05."""
    if count < 0.05:
        return "under 0.1"
    if count < 10:
        return number(count, 1)
    return number(round(count, 1 - math.floor(math.log10(count))), 0)


def _lab(text: str) -> Markup:
    return Markup('<div class="wv-lab">{}</div>').format(text) if text else Markup()


NOT_SAVED = "not kept"
DIAL = "0 finds only clear defects, 1 everything that may be one"
FAILED = "Inspection failed"


class InspectionForm:
    """Form filled in from the last inspection of the surface, else from the saved recipe of its product."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._recipe = DefectRecipe()
        """Recipe that supplies the settings that the form does not show."""
        self._shown_for: object = None
        self._limits = DefectLimits()
        self._shows_more = False
        self._form = DefectForm()
        gui = page.gui
        self._folder = gui.add_folder(None, visible=False)
        with self._folder:
            self._origin = HtmlBlock(gui)
            self._build_search(gui)
            self._more = HtmlBlock(gui)
            self._rest = gui.add_folder(None, visible=False)
            with self._rest:
                self._build_evidence(gui)
                self._build_dies(gui)
                self._build_limits(gui)
            self._why = HtmlBlock(gui)
            begin = guarded(page, FAILED)(lambda _: self.inspect())
            self._begin = command_button(gui, "Inspect", viser.Icon.SEARCH, begin)
            in_a_row(gui, [self._begin], 34)
            self._build_recipe(gui)
        page.on_pick("defect-golden", self._choose_golden)
        page.on_pick("defect-golden-file", lambda _: self._ask_golden())
        page.on_pick("defect-more", lambda _: self._show_more())

    def show(self, snapshot: Snapshot, unfolded: bool, why_not: str) -> None:
        """Bring the form up to date; `why_not` is the reason why no inspection can start now, or empty."""
        set_prop(self._folder, "visible", unfolded)
        self._take_up(snapshot)
        if not unfolded:
            return
        form = self._typed()
        self._show_recipe(snapshot, form)
        self._expected.show(_label(expectation(form.sensitivity, snapshot.inspection.inspection)))
        golden = form.compare == GOLDEN
        self._golden.show(golden_table(snapshot.defect_files, form.product.strip(), form.golden) if golden else "")
        self._more.show(advanced_settings_header(form, self._shows_more))
        self._excluded.show(exclusion_line_html(form))
        set_prop(self._rest, "visible", self._shows_more)
        set_prop(self._given, "visible", form.dies == GIVEN and against_of(form) == "dies")
        set_prop(self._begin, "disabled", bool(why_not))
        self._why.show(_label(why_not) if why_not else "")

    @property
    def recipe(self) -> DefectRecipe:
        """Recipe that the form describes. Raises MeasureError if its entries make no valid recipe."""
        return recipe_of(self._typed(), self._recipe)

    def inspect(self) -> None:
        """Inspect the surface with the settings of the form."""
        form, page = self._typed(), self._page
        recipe = recipe_of(form, self._recipe)
        verb = page.session.defects.inspect(recipe, dies_of(form), against_of(form))
        verb.add_done_callback(self._tell_refusal)
        page.redraw()

    def _tell_refusal(self, done: Future[Any]) -> None:
        """Report why an inspection did not start, unless the section shows that problem already."""
        fault = None if done.cancelled() else done.exception()
        if fault is not None and str(fault) != self._page.session.snapshot.inspection.problem:
            tell_failure(self._page, FAILED, fault)

    # --- building

    def _build_recipe(self, gui: Any) -> None:
        page = self._page
        HtmlBlock(gui, html.head("Recipe"))
        listed = gui.add_dropdown(
            "Kept as", (NOT_SAVED,), hint="Saved by product; the one saved last is applied automatically"
        )
        self._recipes: BoundInput[str] = BoundInput(listed, self._choose_recipe, page, "The recipe was not changed")
        self._product = gui.add_text("Product", "", hint="A golden die of another product is refused")
        self._product.on_update(self._redrawing())
        save = button(gui, "Save recipe…", viser.Icon.DEVICE_FLOPPY, self._on("It was not saved", self.save))
        recipes = button(
            gui, "Recipes…", viser.Icon.LIST, self._on("The recipes were not changed", lambda: recipes_dialog(page))
        )
        in_a_row(gui, [save, recipes], 30)

    def _build_search(self, gui: Any) -> None:
        self._dial = gui.add_slider("Sensitivity", 0.0, 1.0, 0.05, DefectRecipe().sensitivity, hint=DIAL)
        self._expected = HtmlBlock(gui)
        self._against = gui.add_dropdown(
            "Compare", AGAINST, hint="A surface with one die has no others to compare with"
        )
        self._golden = HtmlBlock(gui)
        for widget in (self._dial, self._against):
            widget.on_update(self._redrawing())

    def _build_evidence(self, gui: Any) -> None:
        self._evidence = gui.add_dropdown("Look at", tuple(EVIDENCE), hint="Where a defect may show")
        self._scales = gui.add_text("Scales, px", "", hint="Filters at which is looked; 0 is unfiltered, at most 40")
        self._excluded = HtmlBlock(gui)
        for widget in (self._evidence, self._scales):
            widget.on_update(self._redrawing())

    def _build_dies(self, gui: Any) -> None:
        self._dies = gui.add_dropdown(
            "Dies", DIES, hint="From the job where it names dies, else found, or entered here"
        )
        self._dies.on_update(self._redrawing())
        self._given = gui.add_folder(None, visible=False)
        with self._given:
            self._pitch = OptionalPair(gui, "Pitch, µm", over=0, hint="From die to die, x × y")
            self._corner = OptionalPair(gui, "Corner, µm", between=PLACE, hint="Lower left one of die 0,0, stage x, y")
            self._size = OptionalPair(gui, "Die, µm", over=0, hint="Width × height; empty: as the pitch")
            self._angle = with_decimals(gui.add_number("Angle, °", 0.0, step=0.01, hint="Anticlockwise"), 4)

    def _build_limits(self, gui: Any) -> None:
        page, failed = self._page, "The limits were not changed"
        self._edits = Debouncer(self._limit, guarded(page, failed))
        per_die = gui.add_text("Max. per die", "", hint="Defects allowed on a die; empty for no limit")
        per_mm2 = gui.add_text("Max. per mm²", "", hint="Defects allowed in 1 mm²; empty for no limit")
        self._per_die: BoundInput[str] = BoundInput(per_die, lambda _: self._edits.made(), page, failed)
        self._per_mm2: BoundInput[str] = BoundInput(per_mm2, lambda _: self._edits.made(), page, failed)

    # --- what a person does

    @property
    def excluded(self) -> tuple[Region, ...]:
        """Excluded areas of every die."""
        return self._form.excluded

    def save(self) -> None:
        """Open the dialog that saves the form as a recipe of its product."""
        save_recipe_dialog(
            self._page, self.recipe, lambda recipe: self._put(recipe, form_of(recipe, None, self._typed()))
        )

    def exclude(self, areas: tuple[Region, ...]) -> None:
        """Set the areas of every die that the next inspection excludes."""
        self._form = replace(self._form, excluded=areas)
        self._page.redraw()

    def _choose_recipe(self, event: Any) -> None:
        product, files = self._product.value.strip(), self._page.session.snapshot.defect_files
        chosen = next((r for r in files.recipes_of(product) if r.name == event.target.value), None)
        if chosen is not None:
            self._put(chosen, form_of(chosen, None, self._typed()))
        self._page.redraw()

    def _choose_golden(self, name: str) -> None:
        self._form = replace(self._form, golden=name)
        self._page.redraw()

    def _ask_golden(self) -> None:
        """Choose a golden die from a file; its name includes the version only if a newer version exists."""

        def take(header: GoldenHeader) -> None:
            stored = self._page.session.snapshot.defect_files.golden
            newest = max((h.version for h in stored if h.name == header.name), default=header.version)
            self._choose_golden(header.name if header.version == newest else f"{header.name}.{header.version}")

        golden_file_dialog(self._page, take)

    def _show_more(self) -> None:
        self._shows_more = not self._shows_more
        self._page.redraw()

    def _limit(self) -> Future[None] | None:
        """Apply the limits to the present inspection; the verdict follows without another search.

        Returns None if there is no inspection.
        """
        page, limits = self._page, limits_of(self._per_die.value, self._per_mm2.value)
        page.redraw()
        if page.session.snapshot.inspection.inspection is None:
            return None
        answer = page.session.defects.limit(limits)
        page.ask("The limits were not changed", answer)
        return answer

    # --- showing

    def _take_up(self, snapshot: Snapshot) -> None:
        """Fill the form in from the inspection, else from the recipe of the product, once per dataset and recipe."""
        inspection, data = snapshot.inspection.inspection, snapshot.dataset
        product = product_of(data.job) if data is not None else ""
        own = snapshot.defect_files.recipe_of(product) or DefectRecipe(product=product)
        recipe = inspection.recipe if inspection is not None else own
        sources = (data.path if data is not None else None, changed(recipe, limits=DefectLimits()))
        if inspection is not None and recipe.limits != self._limits and not self._edits.under_way:
            self._limits = recipe.limits
            self._per_die.handle.value, self._per_mm2.handle.value = text_of(recipe.limits)
        if sources != self._shown_for:
            self._shown_for = sources
            self._put(recipe, form_of(recipe, inspection, self._typed()))

    def _show_recipe(self, snapshot: Snapshot, form: DefectForm) -> None:
        """Show the name of the recipe that the form describes, or why its entries make no recipe."""
        files, inspected = snapshot.defect_files, snapshot.inspection.inspection is not None
        names = (NOT_SAVED, *(recipe.name for recipe in files.recipes_of(form.product.strip())))
        if tuple(self._recipes.handle.options) != names:
            self._recipes.handle.options = names
        try:
            now = recipe_of(form, self._recipe)
        except MeasureError as fault:
            self._recipes.show(NOT_SAVED)
            self._origin.show(_label(str(fault)))
            return
        self._recipes.show(now.name if now in files.recipes else NOT_SAVED)
        origin = recipe_origin_text(self._recipe, now, files, inspected)
        self._origin.show(_label(f"{origin} {unreadable(files)}".rstrip()))

    def _put(self, recipe: DefectRecipe, form: DefectForm) -> None:
        """Fill in the form."""
        self._recipe, self._form = recipe, form
        self._dial.value, self._against.value, self._evidence.value = form.sensitivity, form.compare, form.evidence
        self._product.value, self._scales.value, self._dies.value = form.product, form.scales_px, form.dies
        self._pitch.handle.value, self._corner.handle.value = form.pitch_um, form.corner_um
        self._size.handle.value, self._angle.value = form.size_um, form.angle_deg
        self._per_die.handle.value, self._per_mm2.handle.value = form.max_per_die, form.max_per_mm2

    def _typed(self) -> DefectForm:
        """Return the present entries of the form."""
        return DefectForm(
            sensitivity=float(self._dial.value),
            compare=self._against.value,
            evidence=self._evidence.value,
            golden=self._form.golden,
            excluded=self._form.excluded,
            dies=self._dies.value,
            pitch_um=self._pitch.handle.value,
            corner_um=self._corner.handle.value,
            size_um=self._size.handle.value,
            angle_deg=float(self._angle.value),
            product=self._product.value,
            scales_px=self._scales.value,
            max_per_die=self._per_die.value,
            max_per_mm2=self._per_mm2.value,
        )

    def _redrawing(self) -> Any:
        return guarded(self._page, "The form was not changed")(lambda _: self._page.redraw())

    def _on(self, failed: str, act: Any) -> Any:
        return guarded(self._page, failed)(lambda _: act())


def _label(text: str) -> Markup:
    return Markup('<div class="wv-lab" style="margin-bottom:5px">{}</div>').format(html.with_micro_sign(text))
