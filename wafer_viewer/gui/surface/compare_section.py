"""Comparison section of the left panel: form, list of comparisons, and the displayed one."""

from __future__ import annotations

from collections.abc import Hashable
from typing import Any

import viser
from markupsafe import Markup

from wafer_viewer.gui.page.dialogs import Dialog
from wafer_viewer.gui.page.file_dialog import FileList
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.page.preconditions import no_comparison, no_surface
from wafer_viewer.gui.presenters import surface as words
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.callbacks import LatestOnlyWorker, guarded
from wafer_viewer.gui.widgets.controls import (
    Command,
    HtmlBlock,
    ToggleGroup,
    button,
    command_button,
    in_a_row,
    set_prop,
    with_precondition,
)
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.surface.comparison import (
    ALIGN_TITLES,
    Align,
    ComparisonFace,
    SurfaceName,
    comparison_of,
    show_of,
)
from wafer_viewer.session.state.snapshot import Compared, Snapshot

NOTHING_TO_COMPARE = "Nothing else yet"
ICON = viser.Icon


class CompareSection:
    """Section shown in the step Surface if there is a surface, with the numbers of the displayed comparison."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._pairs: dict[str, tuple[SurfaceName, SurfaceName]] = {}
        self._requested: Hashable = None
        self._unfolded = False
        self._looking = LatestOnlyWorker("choices of comparing")
        page.on_close(self._looking.close)
        self._folder = page.gui.add_folder(None, visible=False)
        with self._folder:
            self._build()
        page.on_pick("compare-new", lambda _: self.unfold())
        page.on_pick("compare-look", lambda key: self._look(int(key), ComparisonFace.DIFFERENCE))
        page.on_pick("compare-remove", lambda key: self._remove(int(key)))

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Bring the section up to date."""
        visible = view.step == "surface" and snapshot.surface is not None
        set_prop(self._folder, "visible", visible)
        if not visible:
            return
        compared = self._compared(snapshot, view)
        if compared is None and view.show < 0:
            self._page.change(show=0, range_um=None)
        if self._unfolded:
            self._ask_choices(snapshot, view)
        self._show_form(compared)
        self._list.show(_list(snapshot, compared, self._unfolded))
        self._show_compared(compared, view)

    def commands(self) -> list[Command]:
        """Return the comparison commands with their keys."""
        return [
            *with_precondition(
                no_surface, Command("Compare surfaces…", None, self.unfold, ICON.ARROWS_DIFF, group="Surface")
            ),
            *with_precondition(
                no_comparison,
                Command("First or second surface", "B", self.blink, ICON.SWITCH_HORIZONTAL, "shift", "Surface"),
                Command("Close the comparison", None, self.close, ICON.X, group="Surface"),
            ),
        ]

    def unfold(self) -> None:
        """Unfold or fold the form."""
        self._unfolded = not self._unfolded
        self._page.change(step="surface")
        self._page.redraw()

    def blink(self) -> None:
        """Switch between the first and the second surface with the same camera."""
        if (requested := comparison_of(self._page.view.show)) is not None:
            self._look(
                requested[0], ComparisonFace.FIRST if requested[1] is ComparisonFace.SECOND else ComparisonFace.SECOND
            )

    def close(self) -> None:
        """Close the comparison and show the surface again."""
        if self._page.view.show < 0:
            self._page.change(show=0, range_um=None)

    # --- building

    def _build(self) -> None:
        gui = self._page.gui
        self._list = HtmlBlock(gui)
        self._form = gui.add_folder(None, visible=False)
        with self._form:
            self._with: Any = gui.add_dropdown("Compare with", (NOTHING_TO_COMPARE,))
            self._align = gui.add_dropdown("Align", tuple(ALIGN_TITLES.values()))
            self._keep_z = gui.add_checkbox("Keep height and tilt", False)
            begin = guarded(self._page, "Nothing was compared")(lambda _: self._begin())
            self._begin_button = command_button(gui, "Compare", ICON.ARROWS_DIFF, begin, disabled=True)
            other = button(gui, "From a file…", ICON.FOLDER_OPEN, lambda _: self._ask_other())
            in_a_row(gui, [self._begin_button, other], 34)
            self._why_not = HtmlBlock(gui)
        self._on_show = gui.add_folder(None, visible=False)
        with self._on_show:
            self._faces = ToggleGroup(gui, "Look at", words.FACE_CHOICES, self._choose_face)
            close = button(gui, "Close comparison", ICON.X, lambda _: self.close())
            in_a_row(gui, [close])
            self._summary = HtmlBlock(gui)

    # --- what a person does

    def _begin(self) -> None:
        pair = self._pairs.get(self._with.value)
        if pair is None:
            return
        self._compare(*pair)

    def _ask_other(self) -> None:
        """Open the dialog that compares with any dataset or surface file."""
        page = self._page
        below = "A stitched dataset NAME.wafer, or a surface file: it is laid over what is on show and subtracted."
        dialog = Dialog(page, "Compare with another surface", below)
        with dialog.modal:
            files = FileList(dialog, "surface")

        def begin() -> None:
            snapshot, path = page.session.snapshot, files.path()
            if snapshot.dataset is None or snapshot.surface is None:
                raise DatasetError("Nothing is open to compare with: open a dataset with a surface first.")
            opened, field = snapshot.dataset, max(page.view.show, 0)
            first = SurfaceName(path=str(opened.path), result=snapshot.surface.result, field=field)
            self._compare(first, SurfaceName(path=str(path)))

        dialog.answers("Compare", ICON.ARROWS_DIFF, begin, "Nothing was compared")

    def _compare(self, first: SurfaceName, second: SurfaceName) -> None:
        page = self._page
        done = page.session.comparing.begin(first, second, _align(self._align.value), bool(self._keep_z.value))
        self._unfolded = False
        page.redraw()
        page.ask(
            "The surfaces were not compared", done, lambda number: self._look(int(number), ComparisonFace.DIFFERENCE)
        )

    def _look(self, number: int, face: ComparisonFace) -> None:
        self._page.change(show=show_of(number, face), range_um=None, frame_k=None, slice_z_um=None, why=None)

    def _choose_face(self, face: ComparisonFace) -> None:
        if (requested := comparison_of(self._page.view.show)) is not None:
            self._look(requested[0], face)

    def _remove(self, number: int) -> None:
        page = self._page
        if (requested := comparison_of(page.view.show)) is not None and requested[0] == number:
            self.close()
        page.ask("The comparison was not removed", page.session.comparing.remove(number))

    # --- showing

    def _compared(self, snapshot: Snapshot, view: View) -> Compared | None:
        requested = comparison_of(view.show)
        return next((c for c in snapshot.comparisons if requested is not None and c.number == requested[0]), None)

    def _show_form(self, compared: Compared | None) -> None:
        set_prop(self._form, "visible", self._unfolded and compared is None)
        titles = tuple(self._pairs) or (NOTHING_TO_COMPARE,)
        if tuple(self._with.options) != titles:
            self._with.options = titles
        set_prop(self._begin_button, "disabled", not self._pairs)
        why = "" if self._pairs else "Not yet: there is no other surface in the data folder."
        self._why_not.show(Markup('<div class="wv-lab">{}</div>').format(why) if why else Markup())

    def _show_compared(self, compared: Compared | None, view: View) -> None:
        set_prop(self._on_show, "visible", compared is not None)
        requested = comparison_of(view.show)
        if compared is None or requested is None:
            return
        self._faces.show(requested[1])
        self._summary.show(_summary_html(compared, requested[1]))

    def _ask_choices(self, snapshot: Snapshot, view: View) -> None:
        """List the surfaces to compare with on a worker thread, whenever they may have changed."""
        data, info = snapshot.dataset, snapshot.surface
        request = (data and (data.path, data.results), info and info.result, snapshot.datasets, view.show)
        if request != self._requested:
            self._requested = request
            self._looking.ask(
                lambda: guarded(self._page, "The surfaces to compare were not listed")(self._take)(view.show)
            )

    def _take(self, show: int) -> None:
        pairs = self._page.session.comparing.choices(show)
        self._pairs = {words.pair_label(first, second): (first, second) for first, second in pairs}
        self._page.redraw()


def _align(title: str) -> Align:
    return next(key for key, name in ALIGN_TITLES.items() if name == title)


def _list(snapshot: Snapshot, compared: Compared | None, unfolded: bool) -> Markup:
    """Return the header with the link for a new comparison, and the list of comparisons, as HTML."""
    link = (
        Markup()
        if compared is not None
        else Markup('<span class="wv-link" {}>{}</span>').format(html.pick("compare-new"), _fold_word(unfolded))
    )
    head = Markup('<div class="wv-h">Compare<span>{}</span></div>').format(link)
    rows = [_row(c, chosen=compared is not None and c.number == compared.number) for c in snapshot.comparisons]
    return head + (html.table((), rows, " n") + Markup('<div style="height:8px"></div>') if rows else "")


def _fold_word(unfolded: bool) -> str:
    return "Less" if unfolded else "New…"


def _row(compared: Compared, chosen: bool) -> Markup:
    name = words.comparison_name(compared.comparison)
    away = Markup('<span class="wv-link" title="Remove" {}>').format(
        html.command_pick("compare-remove", str(compared.number))
    )
    cells = (name, Markup("{}{}</span>").format(away, html.icon(ICON.X, 14)))
    return html.row(cells, " n", html.pick("compare-look", str(compared.number)), "sel" if chosen else "")


def _summary_html(compared: Compared, face: ComparisonFace) -> Markup:
    comparison: Any = compared.comparison
    side_by_side = (
        Markup('<div class="wv-lab">{}</div>').format(words.SIDE_BY_SIDE) if face is ComparisonFace.BESIDE else Markup()
    )
    return (
        Markup('<div class="wv-lab" style="margin-bottom:8px">{}</div>').format(words.surfaces_sentence(comparison))
        + side_by_side
        + words.change_figures(comparison.change)
        + words.warnings(comparison, compared.outdated)
        + words.change_numbers(comparison.change)
        + words.alignment(comparison.registration)
    )
