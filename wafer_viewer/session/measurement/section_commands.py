"""Sections of the open dataset and of other datasets: curves for the page, files for spreadsheets and print."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from wafer_viewer.model.measurement.levelling import Datum, Levelling
from wafer_viewer.model.measurement.sections import OtherSurface, Section, SectionAsked
from wafer_viewer.model.surface.height_map import Mosaic
from wafer_viewer.session.measurement.dataset_queries import DatasetQueries
from wafer_viewer.session.measurement.section_export import cut, file_of, other_layer
from wafer_viewer.session.state.snapshot import Snapshot


class Sections:
    """Section queries, from any thread. Methods raise WaferViewerError on failure."""

    def __init__(self, questions: DatasetQueries, snapshot: Callable[[], Snapshot]) -> None:
        self._questions, self._snapshot = questions, snapshot
        self._zero: tuple[tuple[OtherSurface, Levelling], Datum] | None = None

    def section(self, asked: SectionAsked) -> Section:
        """Return a section along a line of the displayed surface, or of another one."""
        if asked.of is not None:
            return self._of_other(asked, asked.of)
        shown = self._snapshot().dataset
        name = shown.name if shown is not None else ""
        source, measuring = name if asked.show <= 0 else f"{name}, field {asked.show}", self._questions.measuring
        if asked.slab:
            found, curve, points = measuring.slab(asked.line, asked.show, asked.levelling)
            return Section(asked, found, curve, source, points)
        layer = other_layer(self._questions.surface_source(asked.show)) if asked.cleaned else None
        return Section(asked, *measuring.profile(asked.line, asked.show, asked.levelling, layer), source)

    def others(self) -> tuple[OtherSurface, ...]:
        """Return the stitched surfaces of the data folder, except the displayed one."""
        now = self._snapshot()
        shown = str(now.dataset.path) if now.dataset is not None else ""
        found = (
            OtherSurface(str(entry.path), mosaic.parent.name)
            for entry in now.datasets
            for mosaic in sorted(entry.path.glob("results/*/mosaic.zarr"))
        )
        looked_at = (shown, now.surface.result if now.surface is not None else "")
        return tuple(other for other in found if (other.folder, other.result) != looked_at)

    def _of_other(self, asked: SectionAsked, other: OtherSurface) -> Section:
        """Return the section along the same line of another surface, levelled in the same way."""
        from wafer_viewer.session.core.dataset_library import today
        from wafer_viewer.store.dataset.dataset import Dataset

        dataset = Dataset.open(Path(other.folder))
        calibrated = dataset.calibration_problem(today()) is None
        surface = self._levelled(other, dataset.result(other.result).mosaic(), asked.levelling)
        return cut(asked, surface, calibrated, other.title)

    def _levelled(self, other: OtherSurface, surface: Mosaic, levelling: Levelling) -> Mosaic:
        from wafer_viewer.measure.base.levelled_surface import Levelled, datum

        if levelling.by == "stage":
            return surface
        if self._zero is None or self._zero[0] != (other, levelling):
            self._zero = (other, levelling), datum(surface, levelling)
        return Levelled(surface, self._zero[1], levelling)

    def file(self, sections: Sequence[Section], ending: str) -> bytes:
        """Return the sections as the content of a file with that ending, ``.csv`` or ``.png``."""
        return file_of(sections, ending)
