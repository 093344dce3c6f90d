"""Reconstruction and stitching in the step Surface: recipe and its form, accepted overlaps, warnings."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import viser
from markupsafe import Markup

from wafer_viewer.draw.number_format import THIN, digits_of_u, number, share, with_unit
from wafer_viewer.draw.quantities import recipe_rows, setting_text
from wafer_viewer.gui.dialogs.dialog import Confirm, ask
from wafer_viewer.gui.elements.elements import (
    Button,
    Buttons,
    Checkbox,
    Dropdown,
    Element,
    Elements,
    Html,
    Slider,
    Stack,
)
from wafer_viewer.gui.elements.form import form
from wafer_viewer.gui.elements.step import Here
from wafer_viewer.gui.scenes.surface_scene import source_of
from wafer_viewer.gui.widgets import html
from wafer_viewer.model.spec import settings_of, value_at, with_field
from wafer_viewer.model.surface.field_poses import DOUBT_TITLES, Poses, RejectionReason
from wafer_viewer.model.surface.recipe import LEAST_PROBABILITY, READY_RECIPES, Recipe
from wafer_viewer.session.rendering.render_request import SurfaceStatistics
from wafer_viewer.session.state.snapshot import OpenDataset, StitchingInfo, SurfaceInfo

READY = {"Default": "default", "The paper's method": "paper"}
OWN = "Custom"
"""Name of a recipe that matches no preset."""
BELIEVES_ALL = "Every peak is accepted: neither the second window nor walls are tested."
NOT_CHANGED = "The surface was not changed"
REPLACES = (
    "Its heights are reconstructed with the chosen recipe. Frames and results are kept; the present heights are "
    "replaced."
)
_FORM = (
    "drift",
    "focus_measure",
    "window",
    "peak",
    "compare_windows",
    "edges",
    "levy.mode",
    "outliers.mode",
    "fill.mode",
)
"""Settings in the order in which the reconstruction uses them."""
_OF_DOUBTS = ("compare_windows", "edges")
"""Fields without effect if every peak is accepted."""


@dataclass(frozen=True, slots=True)
class RecipeState:
    """Recipe as edited for a dataset, and the unfolded parts: values, form, stitching."""

    recipe: Recipe | None = None
    dataset: Path | None = None
    unfolded: frozenset[str] = frozenset()


def recipe_section(here: Here[Any]) -> Elements:
    """Return the recipe in one line; on demand the values chosen from the data, or the form of another recipe."""
    own: RecipeState = here.own.recipe
    data, info = here.snapshot.dataset, here.snapshot.surface
    edited = own.recipe if data is not None and own.dataset == data.path else None
    form = tuple(_form(here, edited or _requested_recipe(data, info))) if data and "form" in own.unfolded else ()
    summary = _summary(data, info, own.unfolded)
    return [Html(summary), Stack(form) if form else None]


def fold(here: Here[Any], part: str) -> None:
    """Unfold or fold a part: values, form, stitching."""
    here.keep(recipe=replace(here.own.recipe, unfolded=here.own.recipe.unfolded ^ {part}))


def _form(here: Here[Any], recipe: Recipe) -> Iterator[Element]:
    data, doubts, ready = here.snapshot.dataset, not accepts_all_peaks(recipe), ready_name(recipe)

    def choose(recipe: Recipe) -> None:
        here.keep(recipe=replace(here.own.recipe, recipe=recipe, dataset=data and data.path))

    def preset(name: str) -> None:
        if name in READY:
            choose(READY_RECIPES[READY[name]])

    def again() -> None:
        page, snapshot = here.page, here.page.session.snapshot
        if snapshot.surface is None or snapshot.dataset is None:
            page.ask(NOT_CHANGED, page.session.reconstruct(recipe))
            return
        title = f"Replace the surface of {snapshot.dataset.path.stem}"
        answer = Confirm(title, viser.Icon.REFRESH, lambda _: page.session.reconstruct(recipe), NOT_CHANGED)
        ask(page, f"{title}?", REPLACES, answer)

    facts = here.page.on_show.facts if here.page.on_show is not None else None
    yield Dropdown("Preset", ready, preset, "All settings at once", options=(*READY, *((OWN,) if ready == OWN else ())))
    for path in _FORM:
        yield from form(
            recipe,
            lambda path, value: choose(with_field(recipe, path, value)),
            path,
            disabled=path in _OF_DOUBTS and not doubts,
        )
        if path == "edges":
            yield Html(Markup() if doubts else Markup('<div class="wv-why">{}</div>').format(BELIEVES_ALL))
            least = least_probability(recipe, here.snapshot.surface)
            yield Slider(
                "Probability from, %",
                round(100 * least, 1),
                lambda percent: choose(with_field(recipe, "least_probability", percent / 100)),
                settings_of(Recipe)["least_probability"].hint,
                disabled=not doubts,
                least=0,
                most=99,
                step=1,
            )
            yield Html(expected(facts, least) if doubts else Markup())
    busy = data is None or data.read_only is not None or bool(here.snapshot.works)
    icon = viser.Icon.REFRESH
    yield Buttons([Button("Reconstruct again", again, icon, disabled=busy, commands=True, failed=NOT_CHANGED)], 34)


def least_probability(recipe: Recipe, info: SurfaceInfo | None) -> float:
    """Return the least probability of a recipe; for `auto` that of the surface, else that of whole stacks."""
    if recipe.least_probability != "auto":
        return float(recipe.least_probability)
    settled = info.settled.least_probability if info is not None and info.settled is not None else "auto"
    return LEAST_PROBABILITY if settled == "auto" else float(settled)


def expected(facts: SurfaceStatistics | None, least: float) -> Markup:
    """Return what the heights of the surface on show keep at a least probability, and how many of these are false."""
    if facts is None or not facts.by_probability or least == 0:
        return Markup()
    kept, false = facts.kept_from(least)
    text = f"Keeps {share(kept)} of the ground, {share(false)} of that expected to be false."
    return Markup('<div class="wv-why">{}</div>').format(text)


def _requested_recipe(data: OpenDataset | None, info: SurfaceInfo | None) -> Recipe:
    """Return the recipe as requested; values left to the data are not resolved."""
    if info is not None and info.asked is not None:
        return info.asked
    return data.job.recipe if data is not None else Recipe()


def _summary(data: OpenDataset | None, info: SurfaceInfo | None, unfolded: frozenset[str]) -> Markup:
    """Return header, recipe in one line, values chosen from the data, and notes, as HTML."""
    requested = _requested_recipe(data, info)
    settled = (info.settled if info else None) or requested
    values = recipe_rows(settled, requested)
    links = [_link("values", "Details", unfolded)] if values else []
    links += [_link("form", "Change", unfolded)] if data else []
    ready = ready_name(requested)
    lead = f"{ready}: " if ready not in ("Default", OWN) else ""
    content = html.head("Reconstruction", Markup(" · ").join(links))
    content += Markup("<div>{}</div>").format(lead + summary(settled))
    if values and "values" in unfolded:
        content += Markup('<div class="wv-chosen"><div class="wv-lab">Chosen from the data</div>{}</div>').format(
            html.pairs(values)
        )
    return content + notes(_noted(info) if info else ())


def _noted(info: SurfaceInfo) -> list[str]:
    """Return the notes of the reconstruction without those of the stitching."""
    elsewhere = info.stitching.notes if info.stitching is not None else ()
    return [note for note in info.recipe_notes if note not in elsewhere]


def _link(part: str, name: str, unfolded: frozenset[str]) -> Markup:
    shown = "Close" if part == "form" and part in unfolded else "Less" if part in unfolded else name
    return html.link(shown, "recipe", part)


def ready_name(recipe: Recipe) -> str:
    """Return the display name of a recipe: its preset, else ``Custom``."""
    return next((name for name, key in READY.items() if READY_RECIPES[key] == recipe), OWN)


def accepts_all_peaks(recipe: Recipe) -> bool:
    """Return whether every peak is accepted, so that neither second window nor edges are tested."""
    return recipe.min_confidence == 0


def summary(recipe: Recipe) -> str:
    """Describe a recipe in one line."""
    settings = settings_of(Recipe)
    focus, window, peak = (
        setting_text(settings[path], value_at(recipe, path)) for path in ("focus_measure", "window", "peak")
    )
    return f"{focus} · window {window[:1].lower()}{window[1:]} · {peak}"


def notes(sentences: Iterable[str], sign: Any = viser.Icon.INFO_CIRCLE, tone: str = "") -> Markup:
    """Return the notes; those that differ only in numbers are folded into one. `tone`: '' or 'attention'."""
    kinds: dict[str, list[str]] = {}
    for sentence in sentences:
        kinds.setdefault(re.sub(r"\d[\d.]*", "0", sentence), []).append(sentence)
    lines = Markup("").join(_kind(group, sign) for group in kinds.values())
    return lines and Markup('<div class="wv-notes {}">{}</div>').format(tone, lines)


def _kind(group: list[str], sign: Any) -> Markup:
    first, *others = (_sentence(text) for text in group)
    if others:
        more = Markup("").join(Markup("<p>{}</p>").format(other) for other in others)
        first = Markup("<details><summary>{} <u>{} more like it</u></summary>{}</details>").format(
            first, len(others), more
        )
    return Markup("<div>{}<div>{}</div></div>").format(html.icon(sign, 15), first)


def _sentence(text: str) -> str:
    """Format a note: micro signs, multiplication signs, a full stop."""
    return re.sub(r"(?<![.\w])x(?=\d)", "× ", html.typeset(text)).rstrip(".") + "."


BY_STAGE = "Fields are placed by the stage alone: their overlaps were not compared."
SHOWN, LISTED = 6, 60
"""Number of rejected overlaps listed at first, and in total when unfolded."""
NAMED = 8
"""Largest number of fields named in a sentence."""
_PRACTICALLY = 0.999
_SURE = ((_PRACTICALLY, "practically sure"), (0.98, "sure"), (0.8, "likely"), (0.0, "open"))
"""Words for the probability of a chosen period, from which on; fields are placed by it from 98 % on."""
Rows = list[tuple[str, str]]


def stitching_section(here: Here[Any]) -> Stack | None:
    """Return how fields were placed, with the rejected overlaps beside the overlay; None for a single field."""
    snapshot, view, info = here.snapshot, here.view, here.snapshot.surface
    if info is None or info.n_fields <= 1 or view.show != 0:
        return None
    stitching, unfolded = info.stitching, "stitching" in here.own.recipe.unfolded
    link = html.link("Less" if unfolded else "Details", "recipe", "stitching") if stitching is not None else Markup()
    if stitching is None:
        text = html.remark(BY_STAGE)
    else:
        text = cautions(stitching) + stitching_numbers(stitching) + (details(stitching) if unfolded else Markup())
        source = source_of(snapshot, 0) if unfolded or view.shows_fields else None
        cached = here.own.poses.at(source) if source is not None else None
        if cached is not None and cached.poses is not None:
            text += rejected_overlaps(cached.poses, info.pixel_um)

    def overlay(shown: bool) -> None:
        here.page.change(fields=shown)

    elements = [
        Html(html.head("Stitching", link)),
        Html(Markup('<div class="wv-wide"></div>'), padded=False),
        Checkbox("Fields and overlaps", view.fields, overlay, "Key O", disabled=stitching is None),
        Html(text),
    ]
    return Stack(elements)


def stitching_numbers(info: StitchingInfo) -> Markup:
    """Return the main figures of the stitching: accepted overlaps, residual steps, uncertainties."""
    rows: Rows = [("Overlaps accepted", f"{number(info.n_believed, 0)} of {number(info.n_overlaps, 0)}")]
    if info.n_periodic:
        rows.append(("– of a repeating pattern", number(info.n_periodic, 0)))
    if info.period_probability is not None:
        rows.append(("– least sure of these", _percent(info.period_probability)))
    rows += [(f"– {words}", number(n, 0)) for words, n in info.doubts if n]
    if info.step_median_um is not None:
        rows.append(("Step left at a seam, median", _length(info.step_median_um)))
    if info.step_p95_um is not None:
        rows.append(("– 95 % are under", _length(info.step_p95_um)))
    rows += [
        ("Position of a field, U (k = 2)", _plus_minus(info.position_u_um)),
        ("Height of a field, U (k = 2)", _plus_minus(info.height_u_um)),
    ]
    return html.pairs(rows)


def how_sure(probability: float) -> str:
    """Return a probability in words and as a number: ``practically sure, over 99.9 %`` or ``likely, 92 %``."""
    words = next(words for least, words in _SURE if probability >= least)
    return f"{words}, {_percent(probability)}"


def _percent(probability: float) -> str:
    if probability > _PRACTICALLY:
        return f"over {100 * _PRACTICALLY:g}{THIN}%"
    return f"{100 * probability:.3g}{THIN}%"


def details(info: StitchingInfo) -> Markup:
    """Return the estimated stage errors, and the form components known only from the stage."""
    rows: Rows = [
        ("Field offset from the stage, rms", _length(info.moved_rms_um)),
        ("– largest", _length(info.moved_max_um)),
        ("Error of the stage, x and y", _length(info.stage_error_um)),
        ("– along z", _length(info.z_error_um)),
    ]
    table = Markup('<div class="wv-chosen">{}</div>').format(html.pairs(rows))
    form = [(name[:1].upper() + name[1:], _plus_minus(u)) for name, u in info.form]
    if form:
        head = html.remark("Known only from the stage, U (k = 2) at the edge")
        table += Markup('<div class="wv-chosen">{}{}</div>').format(head, html.pairs(form))
    return table


def cautions(info: StitchingInfo) -> Markup:
    """Return the warnings; an excluded field that a note already names is not listed again."""
    noted = " ".join(info.notes)
    unsaid = tuple(n for n in info.left_out if f"ield {n} " not in noted)
    sentences = [_left_out(unsaid)] if unsaid else []
    if info.n_groups > 1 and not info.n_by_stage:
        sentences.append(
            f"The fields fall into {info.n_groups} islands: no overlap joins them, so between islands "
            "positions and heights are the stage's."
        )
    return notes((*sentences, *info.notes), viser.Icon.ALERT_TRIANGLE, "attention")


def rejected_overlaps(poses: Poses, pixel_um: float) -> Markup:
    """Return the table of rejected overlaps, largest residual first, blank ones last; empty if there are none."""
    rows = _doubted_rows(poses, pixel_um)
    if not rows:
        return Markup()
    content = _table(("Fields", "Rejected because", "Offset, µm", "px"), rows[:SHOWN])
    if len(rows) > SHOWN:
        beyond = len(rows) - LISTED
        tail = html.remark(f"and {number(beyond, 0)} with smaller offsets" if beyond > 0 else "")
        more = Markup("<summary><u>{} more</u></summary>").format(number(len(rows) - SHOWN, 0))
        content += Markup('<details class="wv-more">{}{}{}</details>').format(
            more, _table((), rows[SHOWN:LISTED]), tail
        )
    return Markup('<div class="wv-chosen">{}</div>').format(content)


def _table(heads: tuple[str, ...], rows: list[Markup]) -> Markup:
    """Return a table with the column widths shared by both tables."""
    return html.table(heads, rows, "  nn", widths_px=(74, None, 60, 46))


def _doubted_rows(poses: Poses, pixel_um: float) -> list[Markup]:
    shifts = poses.shifts
    off_um = np.hypot(shifts.residual_x_um, shifts.residual_y_um)
    rows = np.flatnonzero(~shifts.believed)
    blank = shifts.doubt[rows] == RejectionReason.BLANK
    order = np.lexsort((-np.nan_to_num(off_um[rows], nan=-1.0, posinf=-1.0), blank))
    return [_doubted_row(poses, row, float(off_um[row]), pixel_um) for row in rows[order].tolist()]


def _doubted_row(poses: Poses, row: int, off_um: float, pixel_um: float) -> Markup:
    shifts = poses.shifts
    first, second = (int(poses.numbers[k]) for k in (shifts.first[row], shifts.second[row]))
    doubt = RejectionReason(int(shifts.doubt[row]))
    off = None if doubt is RejectionReason.BLANK else off_um
    figures = [number(off, 2), number(None if off is None else off / pixel_um, 1)]
    why = DOUBT_TITLES[doubt]
    sure = float(poses.overlap_period_probability[row])
    if doubt is RejectionReason.AMBIGUOUS and np.isfinite(sure):
        why = f"{why}; the likeliest is {how_sure(sure)}"
    return html.row([f"{first}{THIN}–{THIN}{second}", why, *figures], "  nn")


def _left_out(fields: tuple[int, ...]) -> str:
    if len(fields) == 1:
        return f"Field {fields[0]} is left out: it matches none of its neighbours. Check its frames, or scan it again."
    named, more = [str(n) for n in fields[:NAMED]], len(fields) - NAMED
    names = f"{', '.join(named)} and {more} more" if more > 0 else f"{', '.join(named[:-1])} and {named[-1]}"
    return f"Fields {names} are left out: they match none of their neighbours. Check their frames, or scan them again."


def _length(value_um: float) -> str:
    """Format a length to two significant digits, as uncertainties are."""
    return with_unit(value_um, digits_of_u(value_um))


def _plus_minus(u_um: float) -> str:
    return f"±{THIN}{_length(u_um)}"
