"""Gauge R&R section of the gauge check panel: studies of a table or of repeat scans."""

from __future__ import annotations

from pathlib import Path

import viser

from wafer_viewer.gui.page.dialogs import Dialog
from wafer_viewer.gui.page.file_dialog import FileList
from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.presenters.gauge_rr import METHODS, study
from wafer_viewer.gui.widgets import html
from wafer_viewer.gui.widgets.controls import HtmlBlock, button, in_a_row
from wafer_viewer.gui.widgets.error_guard import guarded
from wafer_viewer.gui.widgets.number_field import OptionalNumber
from wafer_viewer.model.gauge.gauge_rr import Method

FAILED = "The study was not read"
METHOD_OF: dict[str, Method] = {word.capitalize(): method for method, word in METHODS.items()}
HEAD = "Repeatability and reproducibility"


class StudySection:
    """Result of the last study in this browser, and the button for a new one."""

    def __init__(self, page: Page) -> None:
        self._page = page
        self._told = ""
        self._cell = HtmlBlock(page.gui)
        ask = guarded(page, FAILED)(lambda _: self.ask())
        in_a_row(page.gui, [button(page.gui, "Gauge R&R study…", viser.Icon.TABLE_IMPORT, ask)])

    def show(self) -> None:
        """Bring the section up to date."""
        what = "Share of the variation that comes from the gauge, by AIAG."
        waits = f'<div class="wv-lab" style="margin-bottom:6px">{what}</div>'
        self._cell.show(html.head(HEAD) + (self._told or waits))

    def ask(self) -> None:
        """Open the dialog that reads a study with a method and a tolerance."""
        below = "A CSV with the columns part, appraiser and value, or a folder of repeat scans of wafers with a job."
        dialog = Dialog(self._page, "Gauge R&R study", below)
        gui = self._page.gui
        with dialog.modal:
            files = FileList(dialog, "study", rows=6)
            files.add_upload("text/csv")
            method = gui.add_dropdown("Method", tuple(METHOD_OF))
            tolerance = OptionalNumber(gui, "Tolerance", over=0)

        def read() -> None:
            self._read(files.path(), method.value, tolerance.value)

        dialog.answers("Read the study", viser.Icon.TABLE_IMPORT, read, FAILED)

    def _read(self, path: Path, method: str, tolerance: float | None) -> None:
        made = self._page.session.studies.gauge_rr(path, METHOD_OF[method], tolerance)
        self._told = "".join(study(one) for one in made)
        self._page.redraw()
