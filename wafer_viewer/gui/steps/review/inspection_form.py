"""Inspection form: recipe, sensitivity, comparison, die grid and limits, with the texts that explain them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from typing import Any, TypeVar

import viser
from markupsafe import Markup

from wafer_viewer.draw.number_format import format_time, number
from wafer_viewer.gui.elements.elements import Button, Buttons, Dropdown, Elements, Html, Input, Stack
from wafer_viewer.gui.elements.form import form as inputs_of
from wafer_viewer.gui.elements.step import Here
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.steps.review.defect_form import (
    FORM,
    GIVEN,
    GOLDEN,
    LIMITS,
    DefectForm,
    against_of,
    dies_of,
    form_of,
    limits_of,
    per_mm2,
    recipe_of,
    text_of,
)
from wafer_viewer.gui.steps.review.dialogs import golden_file_dialog, recipes_dialog, save_recipe_dialog
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.callbacks import COMMIT_S, tell_failure
from wafer_viewer.gui.widgets.number_field import pair_text
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.inspection.defect import DefectLimits, DefectRecipe, Inspection, threshold_of
from wafer_viewer.model.inspection.golden_die import GoldenHeader
from wafer_viewer.model.spec import replace, settings_of
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
        return f"Matches no saved recipe of {now.product}."
    return f"No recipe is saved for {now.product}."


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
            html.empty("No golden die is saved", "compare with the fitted form, or die to die.")
            + html.remark(others_text)
            + link
        )
    rows = [_row(header, name, name == chosen) for header, name in _named(mine)][:MOST_GOLDEN]
    hidden = f"{len(mine) - MOST_GOLDEN} older ones" if len(mine) > MOST_GOLDEN else ""
    more = " and ".join(part for part in (hidden, others_text) if part)
    return (
        html.table(["Golden die", "Dies", "Kept"], rows, " nn")
        + html.remark(f"{more} are not listed." if more else "")
        + link
    )


def advanced_settings_header(form: DefectForm, unfolded: bool) -> Markup:
    """Return the header of the additional settings as HTML, with a summary while they are folded."""
    link = html.link("Less" if unfolded else "Change…", "defect-more")
    if unfolded:
        return Markup('<div class="wv-h">More settings<span>{}</span></div>').format(link)
    limits = [f"{text} {unit}" for name, unit in LIMITS.items() if (text := getattr(form, name))]
    parts = (
        settings_of(DefectForm)["evidence"].setting.titles[form.evidence],
        f"filters {form.scales_px} px",
        *((areas(form),) if form.excluded else ()),
        f"dies: {form.dies[0].lower()}{form.dies[1:]}",
        f"at most {' and '.join(limits)}".replace("mm2", "mm²") if limits else "no limits",
    )
    return Markup('<div class="wv-lab" style="margin:2px 0 6px">{} · {}</div>').format("; ".join(parts), link)


def exclusion_line_html(form: DefectForm) -> Markup:
    """Return the form's line about excluded areas, with a link to edit them, as HTML."""
    link = html.link("Areas…", "defect-excluded")
    text = areas(form)
    return Markup('<div class="wv-lab" style="margin:2px 0 6px">{}{} · {}</div>').format(
        text[0].upper(), text[1:], link
    )


def areas(form: DefectForm) -> str:
    """Return the number of excluded areas in words."""
    n = len(form.excluded)
    return f"{n} {'area' if n == 1 else 'areas'} of every die excluded" if n else "the whole die is searched"


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


NOT_SAVED = "not kept"
FAILED, NOT_LIMITED = "Inspection failed", "The limits were not changed"


@dataclass(frozen=True, slots=True)
class InspectionDraft:
    """State of the form, filled in from the last inspection of the surface, else from the recipe of its product.

    recipe: supplies the settings that the form does not show. filled_from: dataset and recipe that it was filled in
    from. limits: that it was filled in with last.
    """

    form: DefectForm = DefectForm()
    recipe: DefectRecipe = DefectRecipe()
    filled_from: object = None
    limits: DefectLimits = DefectLimits()
    unfolded: bool = False
    shows_more: bool = False


D = TypeVar("D", bound=InspectionDraft)


def inspection_form(here: Here[D]) -> Elements | None:
    """Return the form; it is shown until the surface has been inspected, and when it is unfolded."""
    snapshot, state = here.snapshot, here.snapshot.inspection
    _take_up(here)
    if here.view.step != "review" or state.work or not (here.own.unfolded or state.inspection is None):
        return None
    form, icon, page = here.own.form, viser.Icon, here.page
    golden = golden_table(snapshot.defect_files, form.product.strip(), form.golden) if form.compare == GOLDEN else ""
    why, (origin, saved_as) = why_not(snapshot), _described(here)
    names = (NOT_SAVED, *(recipe.name for recipe in snapshot.defect_files.recipes_of(form.product.strip())))
    begin = Button("Inspect", partial(inspect, here), icon.SEARCH, disabled=bool(why), commands=True, failed=FAILED)
    kept_hint = "Saved by product; the one saved last is applied automatically"
    return [
        Html(html.remark(origin, "margin-bottom:5px")),
        *_inputs(here, "sensitivity"),
        Html(html.remark(expectation(form.sensitivity, state.inspection), "margin-bottom:5px")),
        *_inputs(here, "compare"),
        Html(golden),
        Html(advanced_settings_header(form, here.own.shows_more)),
        Stack(_more(here)) if here.own.shows_more else None,
        Html(html.remark(why, "margin-bottom:5px") if why else ""),
        Buttons([begin], 34),
        Html(html.head("Recipe")),
        Dropdown("Kept as", saved_as, partial(_choose_recipe, here), kept_hint, options=names),
        *_inputs(here, "product"),
        Buttons(
            [
                Button("Save recipe…", partial(save, here), icon.DEVICE_FLOPPY, failed="It was not saved"),
                Button("Recipes…", partial(recipes_dialog, page), icon.LIST, failed="The recipes were not changed"),
            ],
            30,
        ),
    ]


def inspect(here: Here[D]) -> None:
    """Inspect the surface with the settings of the form."""
    form, page = here.own.form, here.page
    verb = page.session.defects.inspect(recipe_of(form, here.own.recipe), dies_of(form), against_of(form))
    verb.add_done_callback(partial(_tell_refusal, page))
    page.redraw()


def inspect_by_form(here: Here[D]) -> None:
    """Inspect against the fitted form, as offered where no dies were found; a limit per die needs dies."""
    no_limits = {name: "" for name in LIMITS if name != "max_per_mm2"}
    here.keep(form=replace(here.own.form, compare=FORM, **no_limits))
    inspect(here)


def save(here: Here[D]) -> None:
    """Open the dialog that saves the form as a recipe of its product."""
    recipe = recipe_of(here.own.form, here.own.recipe)
    save_recipe_dialog(here.page, recipe, partial(_fill_in, here))


def why_not(snapshot: Snapshot) -> str:
    """Return the reason why no inspection can start now; empty if it can, or if one is running."""
    data = snapshot.dataset
    if data is None or snapshot.inspection.work:
        return ""
    if data.read_only is not None:
        return f"Not possible: {data.read_only}"
    return "Not yet: the surface still grows." if snapshot.scanning else ""


def _put(here: Here[D], name: str, value: Any) -> None:
    here.put(f"form.{name}", value)


def _inputs(here: Here[D], *names: str, **state: Any) -> list[Input]:
    return inputs_of(here.own.form, partial(_put, here), *names, **state)


def _more(here: Here[D]) -> Elements:
    form = here.own.form
    given = form.dies == GIVEN and against_of(form) == "dies"
    limits = inputs_of(form, partial(_put_limit, here), *LIMITS, pause_s=COMMIT_S)
    return [
        *_inputs(here, "evidence", "scales_px"),
        Html(exclusion_line_html(form)),
        *_inputs(here, "dies"),
        Html(html.remark(html.link("Pitch from a selected rectangle", "defect-pitch"))) if given else None,
        Stack(_inputs(here, "pitch_um", "corner_um", "size_um", "angle_deg")) if given else None,
        *(replace(limit, failed=NOT_LIMITED) for limit in limits),
    ]


NO_RECTANGLE = (
    "Select a rectangle on the surface first, from a corner of a die to the same corner of the next one along both "
    "axes."
)


def _take_pitch(here: Here[D], _: str) -> None:
    """Take the pitch from the selected rectangle, whose corners are equal corners of two dies; the place is found."""
    if (box := here.page.view.selection) is None:
        here.page.say("No pitch was taken", NO_RECTANGLE, "attention")
        return
    pitch = round(abs(box[2] - box[0]), 2), round(abs(box[3] - box[1]), 2)
    here.keep(form=replace(here.own.form, dies=GIVEN, pitch_um=pair_text(pitch), corner_um=""))


def _put_limit(here: Here[D], name: str, text: str) -> Future[None] | None:
    """Apply the limits to the present inspection; the verdict follows without another search."""
    _put(here, name, text)
    limits, page = limits_of(here.own.form), here.page
    if page.session.snapshot.inspection.inspection is None:
        return None
    answer = page.session.defects.limit(limits)
    page.ask(NOT_LIMITED, answer)
    return answer


def _tell_refusal(page: Page, done: Future[Any]) -> None:
    """Report why an inspection did not start, unless the section shows that problem already."""
    fault = None if done.cancelled() else done.exception()
    if fault is not None and str(fault) != page.session.snapshot.inspection.problem:
        tell_failure(page, FAILED, fault)


def _fill_in(here: Here[D], recipe: DefectRecipe) -> None:
    here.keep(recipe=recipe, form=form_of(recipe, None, here.own.form))


def _choose_recipe(here: Here[D], name: str) -> None:
    product, files = here.own.form.product.strip(), here.page.session.snapshot.defect_files
    chosen = next((recipe for recipe in files.recipes_of(product) if recipe.name == name), None)
    if chosen is not None:
        _fill_in(here, chosen)


def _ask_golden(here: Here[D], _: str) -> None:
    """Choose a golden die from a file; its name includes the version only if a newer version exists."""

    def take(header: GoldenHeader) -> None:
        stored = here.page.session.snapshot.defect_files.golden
        newest = max((h.version for h in stored if h.name == header.name), default=header.version)
        _put(here, "golden", header.name if header.version == newest else f"{header.name}.{header.version}")

    golden_file_dialog(here.page, take)


PICKS: dict[str, Callable[[Here[Any], str], Any]] = {
    "defect-golden": lambda here, name: _put(here, "golden", name),
    "defect-golden-file": _ask_golden,
    "defect-pitch": _take_pitch,
    "defect-more": lambda here, _: here.keep(shows_more=not here.own.shows_more),
}
"""What clicks on links and rows of the form do."""


def _take_up(here: Here[D]) -> None:
    """Fill the form in from the inspection, else from the recipe of the product, once per dataset and recipe."""
    snapshot, own = here.snapshot, here.own
    inspection, data = snapshot.inspection.inspection, snapshot.dataset
    product = product_of(data.job) if data is not None else ""
    recipe = snapshot.defect_files.recipe_of(product) or DefectRecipe(product=product)
    if inspection is not None:
        recipe = inspection.recipe
        if recipe.limits != own.limits:
            own = replace(own, limits=recipe.limits, form=replace(own.form, **text_of(recipe.limits)))
    source = (data.path if data is not None else None, replace(recipe, limits=DefectLimits()))
    if source != own.filled_from:
        own = replace(own, filled_from=source, recipe=recipe, form=form_of(recipe, inspection, own.form))
    here.own = own


def _described(here: Here[D]) -> tuple[str, str]:
    """Return the origin of the settings, or why they make no recipe, and the name that they are kept as."""
    own, snapshot = here.own, here.snapshot
    files, inspected = snapshot.defect_files, snapshot.inspection.inspection is not None
    try:
        now = recipe_of(own.form, own.recipe)
    except MeasureError as fault:
        return str(fault), NOT_SAVED
    origin = f"{recipe_origin_text(own.recipe, now, files, inspected)} {unreadable(files)}".rstrip()
    return origin, now.name if now in files.recipes else NOT_SAVED
