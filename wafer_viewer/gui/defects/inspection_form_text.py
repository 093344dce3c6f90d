"""Texts of the inspection form: recipe in use, expected false defects, golden dies."""

from __future__ import annotations

import math
from collections.abc import Iterator
from datetime import datetime

from wafer_viewer.draw.number_format import number
from wafer_viewer.gui.page.dialogs import format_time
from wafer_viewer.gui.presenters.review.defects import per_mm2
from wafer_viewer.gui.presenters.review.inspection_form_values import DefectForm
from wafer_viewer.gui.widgets import html
from wafer_viewer.model.inspection.defect import DefectRecipe, Inspection, threshold_of
from wafer_viewer.model.inspection.golden_die import GoldenHeader
from wafer_viewer.session.state.inspection_resources import DefectShelf

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


def recipe_origin_text(recipe: DefectRecipe, now: DefectRecipe, shelf: DefectShelf, inspected: bool) -> str:
    """Return the origin of the form's settings and whether they were changed; `now` is its present recipe."""
    newest = shelf.recipe_of(recipe.product)
    if now in shelf.recipes:
        by_itself = " Applied automatically because it was saved last." if not inspected and now == newest else ""
        return f"Recipe “{now.name}” of {now.product}, as saved.{by_itself}"
    if inspected and now == recipe:
        return "As the surface was inspected; not saved."
    if recipe in shelf.recipes:
        return f"Recipe “{recipe.name}” of {recipe.product}, changed, not saved."
    if not now.product:
        return "Without a product no recipe can be saved."
    if shelf.recipes_of(now.product):
        return f"As no recipe of {now.product} that is kept."
    return f"No recipe of {now.product} is kept."


def unreadable(shelf: DefectShelf) -> str:
    """Return a sentence with the number of unreadable recipe files; empty if there are none."""
    n = len(shelf.problems)
    return f"{n} recipe {'file' if n == 1 else 'files'} cannot be read: Recipes… says why." if n else ""


def golden_table(shelf: DefectShelf, product: str, chosen: str) -> str:
    """Return the table of golden dies of a product as HTML; those of other products are only counted."""
    mine = [header for header in shelf.golden if not product or header.product in ("", product)]
    others = len(shelf.golden) - len(mine)
    left = f"{others} of other products" if others else ""
    link = f'<div class="wv-lab"><span class="wv-link" {html.pick("defect-golden-file")}>From a file…</span></div>'
    if not mine:
        return html.empty("No golden die is kept", "compare with the fitted form, or die to die.") + _lab(left) + link
    rows = [_row(header, name, name == chosen) for header, name in _named(mine)][:MOST_GOLDEN]
    hidden = f"{len(mine) - MOST_GOLDEN} older ones" if len(mine) > MOST_GOLDEN else ""
    more = " and ".join(part for part in (hidden, left) if part)
    return (
        html.table(["Golden die", "Dies", "Kept"], rows, " nn") + _lab(f"{more} are not listed." if more else "") + link
    )


def advanced_settings_header(form: DefectForm, unfolded: bool) -> str:
    """Return the header of the additional settings as HTML, with a summary while they are folded."""
    link = f'<span class="wv-link" {html.pick("defect-more")}>{"Less" if unfolded else "Change…"}</span>'
    if unfolded:
        return f'<div class="wv-h">More settings<span>{link}</span></div>'
    limits = [text for text in (form.max_per_die and f"{form.max_per_die} per die", _a_mm2(form.max_per_mm2)) if text]
    told = (
        form.evidence,
        f"scales {form.scales_px} px",
        *((areas(form),) if form.excluded else ()),
        f"dies: {form.dies[0].lower()}{form.dies[1:]}",
        f"at most {' and '.join(limits)}" if limits else "no limits",
    )
    return f'<div class="wv-lab" style="margin:2px 0 6px">{html.safe("; ".join(told))} · {link}</div>'


def exclusion_line_html(form: DefectForm) -> str:
    """Return the form's line about excluded areas, with a link to edit them, as HTML."""
    link = f'<span class="wv-link" {html.pick("defect-excluded")}>Areas…</span>'
    told = areas(form)
    return f'<div class="wv-lab" style="margin:2px 0 6px">{told[0].upper()}{told[1:]} · {link}</div>'


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
    seen: set[str] = set()
    for header in headers:
        yield header, f"{header.name}.{header.version}" if header.name in seen else header.name
        seen.add(header.name)


def _row(header: GoldenHeader, name: str, chosen: bool) -> str:
    version = f"version {header.version}" + ("" if "." in name else ", the newest")
    of, made_of = header.product or "no product", header.made_of or "a file"
    title = f"{header.name} version {header.version} of {of}, made of {made_of}"
    told = f'<span class="wv-cut wv-short" title="{html.safe(title)}">{html.safe(header.name)}</span>'
    cells = [f"{told}<small>{version}</small>", number(header.dies, 0), html.safe(_kept(header))]
    attributes = f'{html.pick("defect-golden", name)} aria-pressed="{str(chosen).lower()}"'
    return html.row(cells, " nn", attributes, "sel" if chosen else "")


def _kept(header: GoldenHeader) -> str:
    return format_time(header.made_at, datetime.now().astimezone())


def _expected_count_text(count: float) -> str:
    """Return an expected count rounded to two digits; one decimal below ten, "under 0.1" below 0.05."""
    if count < 0.05:
        return "under 0.1"
    if count < 10:
        return number(count, 1)
    return number(round(count, 1 - math.floor(math.log10(count))), 0)


def _lab(text: str) -> str:
    return f'<div class="wv-lab">{html.safe(text)}</div>' if text else ""
