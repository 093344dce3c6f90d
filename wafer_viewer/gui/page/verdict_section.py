"""Panel section with the verdict: in Acquire after the scan, in Surface for any open dataset."""

from __future__ import annotations

from wafer_viewer.gui.page.page import Page
from wafer_viewer.gui.presenters import verdict as words
from wafer_viewer.gui.widgets.controls import HtmlBlock
from wafer_viewer.session.state.snapshot import Snapshot


class VerdictSection:
    """Verdict section; empty if the job has no feature to judge."""

    def __init__(self, page: Page) -> None:
        self._cell = HtmlBlock(page.gui)

    def show(self, snapshot: Snapshot) -> None:
        """Update the section."""
        self._cell.show(_content(snapshot))


def awaited(snapshot: Snapshot) -> bool:
    """Return whether the verdict of the open dataset is pending."""
    return has_features(snapshot) and snapshot.operating.verdict is None


def has_features(snapshot: Snapshot) -> bool:
    """Return whether the open dataset's job has a feature to judge."""
    data = snapshot.dataset
    return data is not None and any(feature.has_place for feature in data.job.features)


def _content(snapshot: Snapshot) -> str:
    verdict = snapshot.operating.verdict
    if not has_features(snapshot) or snapshot.scanning:
        return ""
    if verdict is None:
        return words.waiting(snapshot.operating.judging)
    return words.card(verdict) + words.dies(verdict) + words.features(verdict) + '<div style="height:8px"></div>'
