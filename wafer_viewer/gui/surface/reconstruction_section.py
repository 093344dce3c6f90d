"""Reconstruction section: recipe, stitching, and a form to reconstruct the surface again."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import viser
from markupsafe import Markup

from wafer_viewer.gui.page.dialogs import reconstruct_dialog
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.presenters import surface as words
from wafer_viewer.gui.scenes.pose_overlay import PoseCache
from wafer_viewer.gui.scenes.surface_scene import source_of
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.callbacks import guarded
from wafer_viewer.gui.widgets.controls import BoundInput, HtmlBlock, add_html, command_button, in_a_row, set_prop
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.recipe import READY_RECIPES, Recipe
from wafer_viewer.session.state.snapshot import OpenDataset, Snapshot, SurfaceInfo

Put = Callable[[Recipe, Any], Recipe]


class RecipeSection:
    """Recipe in one line; on demand the values chosen from the data, or the recipe form."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._unfolded: set[str] = set()
        self._recipe: Recipe | None = None
        self._dataset: object = None
        self._fields: list[tuple[BoundInput[str], dict[str, Any], Callable[[Recipe], Any]]] = []
        gui = page.gui
        self._head = HtmlBlock(gui)
        self._form = gui.add_folder(None, visible=False)
        with self._form:
            self._build()
        page.on_pick("recipe", self._toggle)

    def show(self, snapshot: Snapshot) -> None:
        """Bring the section up to date."""
        data, info = snapshot.dataset, snapshot.surface
        self._discard_edited_recipe(data)
        self._head.show(_summary(data, info, self._unfolded))
        set_prop(self._form, "visible", "form" in self._unfolded and data is not None)
        self._show_form(self._recipe or _requested_recipe(data, info))
        busy = data is None or data.read_only is not None or bool(snapshot.works)
        set_prop(self._button, "disabled", busy)

    # --- building

    def _build(self) -> None:
        """Create the choices in the order in which the reconstruction uses them."""
        gui = self._page.gui
        self._ready = self._dropdown("Preset", tuple(words.READY), self._take_ready)
        self._add("Drift", words.DRIFT, lambda r: r.drift, lambda r, v: replace(r, drift=v))
        self._add("Focus measure", words.FOCUS, lambda r: r.focus_measure, lambda r, v: replace(r, focus_measure=v))
        self._add("Window", words.WINDOW, lambda r: r.window, lambda r, v: replace(r, window=v))
        self._add("Peak", words.PEAK, lambda r: r.peak, lambda r, v: replace(r, peak=v))
        compare = words.SECOND_WINDOW
        self._second = self._add(
            "Second window", compare, lambda r: r.compare_windows, lambda r, v: replace(r, compare_windows=v)
        )
        self._edges = self._add("Beside walls", words.EDGES, lambda r: r.edges, lambda r, v: replace(r, edges=v))
        self._why_not = HtmlBlock(gui)
        self._add(
            "Smoothing", words.SMOOTHING, lambda r: r.levy.mode, lambda r, v: replace(r, levy=replace(r.levy, mode=v))
        )
        self._add(
            "Outliers",
            words.OUTLIERS,
            lambda r: r.outliers.mode,
            lambda r, v: replace(r, outliers=replace(r.outliers, mode=v)),
        )
        self._add("Fill", words.FILL, lambda r: r.fill.mode, lambda r, v: replace(r, fill=replace(r.fill, mode=v)))
        again = guarded(self._page, "The surface was not changed")(lambda _: self._again())
        self._button = command_button(gui, "Reconstruct again", viser.Icon.REFRESH, again)
        in_a_row(gui, [self._button], 34)

    def _add(self, label: str, names: dict[str, Any], get: Callable[[Recipe], Any], put: Put) -> BoundInput[str]:
        """Add a dropdown for a field of the recipe, with its displayed names."""
        field = self._dropdown(label, tuple(names), lambda name: self._choose(put(self._now(), names[name])))
        self._fields.append((field, names, get))
        return field

    def _dropdown(self, label: str, options: tuple[str, ...], act: Callable[[str], None]) -> BoundInput[str]:
        dropdown = self._page.gui.add_dropdown(label, options)
        return BoundInput(dropdown, lambda event: act(event.target.value), self._page, "The recipe was not changed")

    # --- choices

    def _now(self) -> Recipe:
        snapshot = self._page.session.snapshot
        return self._recipe or _requested_recipe(snapshot.dataset, snapshot.surface)

    def _choose(self, recipe: Recipe) -> None:
        self._recipe = recipe
        self._page.redraw()

    def _take_ready(self, name: str) -> None:
        if name in words.READY:
            self._choose(READY_RECIPES[words.READY[name]])

    def _toggle(self, part: str) -> None:
        self._unfolded ^= {part}
        self._page.redraw()

    def _again(self) -> None:
        page, recipe = self._page, self._now()
        reconstruct_dialog(page, lambda: page.ask("The surface was not changed", page.session.reconstruct(recipe)))

    # --- showing

    def _discard_edited_recipe(self, data: OpenDataset | None) -> None:
        """Discard the edited recipe when another dataset is open."""
        dataset = data.path if data else None
        if dataset != self._dataset:
            self._dataset, self._recipe = dataset, None

    def _show_form(self, recipe: Recipe) -> None:
        ready = words.ready_name(recipe)
        set_prop(self._ready.handle, "options", (*words.READY, *((words.OWN,) if ready == words.OWN else ())))
        self._ready.show(ready)
        for field, names, get in self._fields:
            field.show(words.option_name(names, get(recipe)))
        doubts = not words.accepts_all_peaks(recipe)
        self._second.enable(doubts)
        self._edges.enable(doubts)
        self._why_not.show(Markup() if doubts else Markup('<div class="wv-why">{}</div>').format(words.BELIEVES_ALL))


def _requested_recipe(data: OpenDataset | None, info: SurfaceInfo | None) -> Recipe:
    """Return the recipe as requested; values left to the data are not resolved."""
    if info is not None and info.asked is not None:
        return info.asked
    return data.job.recipe if data is not None else Recipe()


def _summary(data: OpenDataset | None, info: SurfaceInfo | None, unfolded: set[str]) -> Markup:
    """Return header, recipe in one line, values chosen from the data, and notes, as HTML."""
    requested = _requested_recipe(data, info)
    settled = (info.settled if info else None) or requested
    values = words.chosen_by_data(requested, settled)
    links = [_link("values", "Details", unfolded)] if values else []
    links += [_link("form", "Change", unfolded)] if data else []
    ready = words.ready_name(requested)
    lead = f"{ready}: " if ready not in ("Default", words.OWN) else ""
    content = Markup('<div class="wv-h">Reconstruction<span>{}</span></div>').format(Markup(" · ").join(links))
    content += Markup("<div>{}</div>").format(lead + words.summary(settled))
    if values and "values" in unfolded:
        content += Markup('<div class="wv-chosen"><div class="wv-lab">Chosen from the data</div>{}</div>').format(
            html.pairs(values)
        )
    return content + words.notes(_noted(info) if info else ())


def _noted(info: SurfaceInfo) -> list[str]:
    """Return the notes of the reconstruction without those of the stitching."""
    elsewhere = info.stitching.notes if info.stitching is not None else ()
    return [note for note in info.recipe_notes if note not in elsewhere]


def _link(part: str, name: str, unfolded: set[str]) -> Markup:
    shown = "Close" if part == "form" and part in unfolded else "Less" if part in unfolded else name
    return Markup('<span class="wv-link" {}>{}</span>').format(html.pick("recipe", part), shown)


class StitchingSection:
    """Section shown for more than one field; it lists rejected overlaps with the details or the overlay."""

    def __init__(self, page: Page, poses: PoseCache) -> None:
        self._page, self._poses = page, poses
        self._unfolded = False
        gui = page.gui
        self._folder = gui.add_folder(None, visible=False)
        with self._folder:
            self._head = HtmlBlock(gui)
            add_html(gui, Markup('<div class="wv-wide"></div>'))
            box = gui.add_checkbox("Fields and overlaps", False, hint="Key O")
            self._on = BoundInput(
                box, lambda event: page.change(fields=bool(event.target.value)), page, "The display was not changed"
            )
            self._text = HtmlBlock(gui)
        page.on_pick("stitching", self._toggle)

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Bring the section up to date."""
        info = snapshot.surface
        visible = info is not None and info.n_fields > 1 and view.show == 0
        set_prop(self._folder, "visible", visible)
        if info is None or not visible:
            return
        self._head.show(self._headed(info))
        self._on.show(view.fields)
        self._on.enable(info.stitching is not None)
        self._text.show(self._stitching_text(snapshot, info, view))

    def _toggle(self, _: str) -> None:
        self._unfolded = not self._unfolded
        self._page.redraw()

    def _headed(self, info: SurfaceInfo) -> Markup:
        name = "Less" if self._unfolded else "Details"
        link = (
            Markup('<span class="wv-link" {}>{}</span>').format(html.pick("stitching"), name)
            if info.stitching
            else Markup()
        )
        return Markup('<div class="wv-h">Stitching<span>{}</span></div>').format(link)

    def _stitching_text(self, snapshot: Snapshot, info: SurfaceInfo, view: View) -> Markup:
        stitching = info.stitching
        if stitching is None:
            return Markup('<div class="wv-lab">{}</div>').format(words.BY_STAGE)
        text = words.cautions(stitching) + words.stitching_numbers(stitching)
        if self._unfolded:
            text += words.details(stitching)
        if self._unfolded or view.shows_fields:
            text += self._doubted(snapshot, info)
        return text

    def _doubted(self, snapshot: Snapshot, info: SurfaceInfo) -> Markup:
        source = source_of(snapshot, 0)
        cached = self._poses.at(source) if source is not None else None
        return (
            words.rejected_overlaps(cached.poses, info.pixel_um)
            if cached is not None and cached.poses is not None
            else Markup()
        )
