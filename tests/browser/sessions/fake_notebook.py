"""The groups of verbs for the notebook and for papers, as a session that stands still has them."""

from __future__ import annotations

import dataclasses
from concurrent.futures import Future
from pathlib import Path
from typing import Any

from tests.browser.recording import Recording, done
from wafer_viewer.model.job import Judgement, Notebook, SavedView
from wafer_viewer.model.report import Contents, Holds, ReportOrder
from wafer_viewer.model.spec import replace
from wafer_viewer.session.files.file_jobs import Documents
from wafer_viewer.session.measurement.results import NotebookController


class FakeNotebook(Recording):
    """Remembers what it is asked and changes the notebook of the snapshot at once."""

    def __init__(self, session: Any) -> None:
        super().__init__(NotebookController, session._done, "notebook.")
        self._session = session
        self._before: list[Notebook] = []

    @property
    def _book(self) -> Notebook:
        return self._session.snapshot.notebook.book

    def save_view(self, view: SavedView) -> Future[Any]:
        number = len(self._book.views) + 1
        kept = replace(view, number=number, name=view.name or f"View {number}")
        return self._put("save_view", kept, views=(*self._book.views, kept))

    def rename_view(self, number: int, name: str) -> Future[Any]:
        views = tuple(replace(v, name=name) if v.number == number else v for v in self._book.views)
        return self._put("rename_view", None, views=views)

    def delete_view(self, number: int) -> Future[Any]:
        return self._put("delete_view", None, views=tuple(v for v in self._book.views if v.number != number))

    def judge(self, key: str, verdict: Any = None, note: str | None = None) -> Future[Any]:
        old = self._book.judgement(key)
        new = Judgement(key=key, verdict=verdict or old.verdict, note=old.note if note is None else note)
        others = tuple(j for j in self._book.judgements if j.key != key)
        return self._put("judge", None, judgements=(*others, new))

    def undo(self) -> Future[Any]:
        if self._before:
            self._show(self._before.pop())
        return self._session._done("notebook.undo", (), {})

    def _put(self, verb: str, came_to: Any, **changes: Any) -> Future[Any]:
        self._before.append(self._book)
        self._show(replace(self._book, **changes))
        self._session._done(f"notebook.{verb}", (), changes)
        return done(came_to)

    def _show(self, book: Notebook) -> None:
        state = dataclasses.replace(self._session.snapshot.notebook, book=book, can_undo=bool(self._before))
        self._session.change(notebook=state)


HELD: Contents = {
    "verdict": Holds("the job has no feature with limits", nothing=True),
    "results": Holds("no results yet", nothing=True),
    "gauge": Holds("no gauge-block check was kept", nothing=True),
    "pictures": Holds("no pictures yet: key P takes one", nothing=True),
    "surface": Holds("1 440 × 1 080 points"),
    "plan": Holds("9 fields of 61 frames"),
    "recipe": Holds("the settings that were used"),
    "calibration": Holds("lengths are calibrated"),
    "warnings": Holds("no warnings"),
    "audit": Holds("no entry on this dataset", nothing=True),
    "checksums": Holds("of data and results; versions of the program"),
    "signatures": Holds("measured by, checked by, approved by"),
}


class FakePapers(Recording):
    """Pictures and reports go to a folder of a test."""

    def __init__(self, session: Any) -> None:
        super().__init__(Documents, session._done, "papers.")
        self._session = session
        self.folder, self.pictures_kept = Path(), 0
        self.saved_reports: dict[str, Path] = {}
        self.fails_with: Exception | None = None

    def contents(self) -> Future[Any]:
        return done({**HELD, "results": self._results()})

    def _results(self) -> Holds:
        n = len(self._session.snapshot.findings)
        return Holds(f"{n} results, 0 judged") if n else Holds("no results yet", nothing=True)

    def keep_picture(self, png: bytes) -> Future[Path]:
        path = self.folder / "coupon-07-picture-1.png"
        path.write_bytes(png)
        return done(path)

    def write_report(self, order: ReportOrder, path: Path | None = None) -> Future[Path]:
        self._session._done("write_report", (order, path), {})
        if self.fails_with is not None:
            failed: Future[Path] = Future()
            failed.set_exception(self.fails_with)
            return failed
        path = self.folder / (path.name if path else "memory-report-1.html")
        path.write_text(f"<h1>{order.title}</h1>")
        return done(path)
