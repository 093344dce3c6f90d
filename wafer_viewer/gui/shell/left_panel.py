"""Left panel: map of the sample, and below it the lists of the step."""

from __future__ import annotations

from pathlib import Path

import viser

from wafer_viewer.gui.defects.defect_section import DefectSection
from wafer_viewer.gui.defects.die_map import DefectMap
from wafer_viewer.gui.gauge.gauge_list import GaugeList
from wafer_viewer.gui.measure.result_list import ResultList
from wafer_viewer.gui.page.background_tasks import job_list
from wafer_viewer.gui.page.dialogs import dataset_table, open_dataset
from wafer_viewer.gui.page.import_export_dialogs import import_dialog, open_dialog
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.presenters.review.review import review_list
from wafer_viewer.gui.shell.field_map import FieldMap
from wafer_viewer.gui.shell.saved_views import views_html
from wafer_viewer.gui.state.view_state import View
from wafer_viewer.gui.surface.compare_section import CompareSection
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.controls import HtmlBlock, button, in_a_row, set_prop
from wafer_viewer.gui.widgets.style import LEFT_PX
from wafer_viewer.session.state.snapshot import Snapshot


class LeftPanel:
    """Map, then jobs, saved views, and the lists of the step, such as datasets, defects or results."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self.panel = panel = page.gui.add_panel()
        with panel.add_tab("Sample"):
            self._where = page.gui.add_folder(None)
            with self._where:
                self.map = FieldMap(page.gui)
            self.dies = DefectMap(page)
            self._works = HtmlBlock(page.gui)
            self._views = HtmlBlock(page.gui)
            self.defects = DefectSection(page)
            self._review = HtmlBlock(page.gui)
            self._gauge = GaugeList(page)
            self.compare = CompareSection(page)
            self._build_datasets()
            self.results = ResultList(page)
        panel.dock_left()
        panel.set_width(LEFT_PX)
        page.on_pick("open", lambda path: open_dataset(page, Path(path)))
        page.on_pick("cancel", page.session.cancel)

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Bring the panel up to date."""
        checking = view.step == "gauge"  # its points and earlier checks need the room, as do defects
        dies = self.dies.show(snapshot, view)
        set_prop(self._where, "visible", not checking and not dies)
        if not dies:
            self.map.show(snapshot, view)
        self._works.show(job_list(snapshot, view))
        reviewing = view.step == "review" and snapshot.surface is not None  # the form or the list needs the room
        self._views.show("" if checking or reviewing or dies else views_html(snapshot, view))
        self.defects.show(snapshot, view)
        self._review.show(review_list(snapshot, view))
        self._gauge.show(snapshot, view)
        self.compare.show(snapshot, view)
        set_prop(self._datasets, "visible", view.step in ("plan", "surface"))
        opened = snapshot.dataset.path if snapshot.dataset else None
        self._list.show(html.head("Datasets", _shortened(snapshot.data_folder)) + self._dataset_rows(snapshot, opened))
        self.results.show(snapshot, view)

    def _build_datasets(self) -> None:
        page = self._page
        self._datasets = page.gui.add_folder(None, visible=False)
        with self._datasets:
            self._list = HtmlBlock(page.gui)
            opener = button(page.gui, "Open…", viser.Icon.FOLDER_OPEN, lambda _: open_dialog(page))
            importer = button(page.gui, "Import…", viser.Icon.PHOTO_PLUS, lambda _: import_dialog(page))
            in_a_row(page.gui, [opener, importer])

    def _dataset_rows(self, snapshot: Snapshot, opened: Path | None) -> str:
        if not snapshot.datasets:
            return (
                html.empty("No datasets in", f"{_shortened(snapshot.data_folder)} yet.")
                + '<div style="height:8px"></div>'
            )
        return dataset_table(snapshot.datasets, opened, "open") + '<div style="height:6px"></div>'


def _shortened(folder: Path) -> str:
    """Return a path with the home folder abbreviated to ~."""
    return f"~/{folder.relative_to(Path.home())}" if folder.is_relative_to(Path.home()) else str(folder)
