"""How the surface was reconstructed, and the choices for doing it again."""

from __future__ import annotations

from typing import Any

import viser

from wafer_viewer.gui import html
from wafer_viewer.gui.guard import guarded
from wafer_viewer.gui.kit import Cell, Field, button, in_a_row, set_prop
from wafer_viewer.gui.page import Page
from wafer_viewer.model.recipe import Recipe
from wafer_viewer.model.spec import replace
from wafer_viewer.session.state import Snapshot

FOCUS = {"Tenengrad": "tenengrad", "SML": "sml", "GLV": "glv", "Log-Laplacian": "log_laplacian"}
PEAK = {"Blur law": "blur_law", "Tent": "tent", "Gaussian": "gaussian", "Highest frame": "argmax"}
WINDOW = {"auto": "auto", **{f"{n} px": n for n in range(3, 27, 2)}}
SMOOTHING = {
    "Sigma filter": "sigma_filter",
    "Switching median": "switching_median",
    "Levy, guided": "guided",
    "Levy, literal": "literal",
    "None": "none",
}
OUTLIERS = {"Lattice": "lattice", "Cloud": "cloud", "None": "none"}
FILL = {"Small gaps": "small_gaps", "All gaps": "all", "None": "none"}


class RecipeSection:
    """One line that says how; opened, a form of the recipe and a button."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._open = False
        self._recipe: Recipe | None = None
        gui = page.gui
        self._head = Cell(gui)
        self._form = gui.add_folder(None, visible=False)
        with self._form:
            self._focus = self._choice("Focus measure", FOCUS, lambda r, v: replace(r, focus_measure=v))
            self._window = self._choice("Window", WINDOW, lambda r, v: replace(r, window=v))
            self._peak = self._choice("Peak", PEAK, lambda r, v: replace(r, peak=v))
            self._levy = self._choice("Smoothing", SMOOTHING, lambda r, v: replace(r, levy=replace(r.levy, mode=v)))
            self._out = self._choice(
                "Outliers", OUTLIERS, lambda r, v: replace(r, outliers=replace(r.outliers, mode=v))
            )
            self._fill = self._choice("Fill", FILL, lambda r, v: replace(r, fill=replace(r.fill, mode=v)))
            again = guarded(page, "The surface stays")(lambda _: self._again())
            self._button = button(gui, "Reconstruct again", viser.Icon.REFRESH, again)
            in_a_row(gui, [self._button], 34)
        page.on_pick("recipe", lambda _: self._toggle())

    def show(self, snapshot: Snapshot) -> None:
        """Bring the section up to date."""
        data = snapshot.dataset
        used = data.job.recipe if data else Recipe()
        recipe = self._recipe or used
        action = "Close" if self._open else "Change"
        link = f'<span class="wv-link" {html.pick("recipe")}>{action}</span>' if data else ""
        notes = snapshot.surface.recipe_notes if snapshot.surface else ()
        self._head.show(_head(used, link) + "".join(f'<div class="wv-lab">{html.safe(n)}</div>' for n in notes))
        set_prop(self._form, "visible", self._open and data is not None)
        self._focus.show(_name(FOCUS, recipe.focus_measure))
        self._window.show(_name(WINDOW, recipe.window))
        self._peak.show(_name(PEAK, recipe.peak))
        self._levy.show(_name(SMOOTHING, recipe.levy.mode))
        self._out.show(_name(OUTLIERS, recipe.outliers.mode))
        self._fill.show(_name(FILL, recipe.fill.mode))
        busy = data is None or data.read_only is not None or bool(snapshot.works)
        set_prop(self._button, "disabled", busy)

    def _choice(self, label: str, names: dict[str, Any], put: Any) -> Field[str]:
        def chosen(event: Any) -> None:
            data = self._page.session.snapshot.dataset
            base = self._recipe or (data.job.recipe if data else Recipe())
            self._recipe = put(base, names[event.target.value])

        return Field(self._page.gui.add_dropdown(label, tuple(names)), chosen, self._page, "The recipe stays")

    def _toggle(self) -> None:
        self._open = not self._open
        self._page.redraw()

    def _again(self) -> None:
        self._page.ask("The surface stays", self._page.session.reconstruct(self._recipe))


def _head(recipe: Recipe, link: str) -> str:
    words = f"{_name(FOCUS, recipe.focus_measure)} · {_name(PEAK, recipe.peak)}"
    return f'<div class="wv-h">Reconstruction<span>{html.safe(words)} · {link}</span></div>'


def _name(names: dict[str, Any], value: Any) -> str:
    return next(name for name, key in names.items() if key == value)
