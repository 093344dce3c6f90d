"""Sections of surfaces along lines: curves for the page, files for other programs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from wafer_viewer._version import __version__
from wafer_viewer.measure.base.height_samples import Layer
from wafer_viewer.model.errors import DatasetError, MeasureError
from wafer_viewer.model.measurement.levelling import Datum, Levelling
from wafer_viewer.model.measurement.sections import OtherSurface, Section, SectionRequest
from wafer_viewer.model.surface.height_map import Mosaic
from wafer_viewer.session.core.commands import query
from wafer_viewer.session.measurement.dataset_queries import DatasetQueries
from wafer_viewer.session.state.snapshot import Snapshot

if TYPE_CHECKING:
    from wafer_viewer.draw.print_figures import ProfileFormat


def cut(request: SectionRequest, surface: Mosaic, calibrated: bool, source: str) -> Section:
    """Return a section of a surface. Raises MeasureError when nothing was measured along the line."""
    from wafer_viewer.measure.tools.profile import profile

    layer = other_layer(surface) if request.cleaned else None
    try:
        measurement, curve = profile(surface, request.line, calibration_valid=calibrated, layer=layer)
    except MeasureError as fault:
        if request.of is None:
            raise
        raise MeasureError(f"{source} has no heights along line {request.letter}. {fault}") from fault
    return Section(request, measurement, curve, source)


def other_layer(surface: Mosaic) -> Layer:
    """Return the layer that is not measured on, of measured and filtered heights."""
    return "unsmoothed" if surface.provenance.recipe.measure_on == "smoothed" else "filled"


def file_of(sections: Sequence[Section], ending: str) -> bytes:
    """Return sections as the content of a file with that ending. See `require_section_format`."""
    require_section_format(ending)
    return FILES[ending.lower()](sections)


def require_section_format(ending: str) -> None:
    """Raise DatasetError if sections cannot be written to a file with that ending."""
    endings = list(FILES)
    if ending.lower() not in endings:
        raise DatasetError(f"Profiles cannot be written as '{ending}': use {', '.join(endings[:-1])} or {endings[-1]}.")


def write_sections(sections: Sequence[Section], path: Path) -> None:
    """Write sections to a file atomically; its ending determines the format."""
    from wafer_viewer.store.io.atomic_files import atomic_write

    content = file_of(sections, path.suffix)
    with atomic_write(path) as temporary:
        temporary.write_bytes(content)


def _table(sections: Sequence[Section]) -> bytes:
    from wafer_viewer.store.tables.csv_tables import profiles_csv

    return profiles_csv(sections, __version__).encode()


def _figure(sections: Sequence[Section], kind: ProfileFormat) -> bytes:
    from wafer_viewer.draw.print_figures import profile_figure

    return profile_figure(sections, kind)


FILES: dict[str, Callable[[Sequence[Section]], bytes]] = {
    ".csv": _table,
    ".png": partial(_figure, kind="png"),
    ".pdf": partial(_figure, kind="pdf"),
    ".svg": partial(_figure, kind="svg"),
}
"""Section writers by file ending."""


class Sections:
    """Section queries, from any thread. Methods raise WaferViewerError on failure."""

    def __init__(self, questions: DatasetQueries, snapshot: Callable[[], Snapshot]) -> None:
        self._questions, self._snapshot = questions, snapshot
        self._zero: tuple[tuple[OtherSurface, Levelling], Datum] | None = None

    @query
    def section(self, request: SectionRequest) -> Section:
        """Return a section along a line of the displayed surface, or of another one."""
        if request.of is not None:
            return self._of_other(request, request.of)
        shown = self._snapshot().dataset
        name = shown.name if shown is not None else ""
        source, measuring = name if request.show <= 0 else f"{name}, field {request.show}", self._questions.measuring
        if request.slab:
            measurement, curve, points = measuring.slab(request.line, request.show, request.levelling)
            return Section(request, measurement, curve, source, points)
        layer = other_layer(self._questions.surface_source(request.show)) if request.cleaned else None
        return Section(request, *measuring.profile(request.line, request.show, request.levelling, layer), source)

    @query
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

    def _of_other(self, request: SectionRequest, other: OtherSurface) -> Section:
        """Return the section along the same line of another surface, levelled in the same way."""
        from wafer_viewer.session.core.dataset_library import today
        from wafer_viewer.store.dataset.dataset import Dataset

        dataset = Dataset.open(Path(other.folder))
        calibrated = dataset.calibration_problem(today()) is None
        surface = self._levelled(other, dataset.result(other.result).mosaic(), request.levelling)
        return cut(request, surface, calibrated, other.title)

    def _levelled(self, other: OtherSurface, surface: Mosaic, levelling: Levelling) -> Mosaic:
        from wafer_viewer.measure.base.levelled_surface import Levelled, datum

        if levelling.by == "stage":
            return surface
        if self._zero is None or self._zero[0] != (other, levelling):
            self._zero = (other, levelling), datum(surface, levelling)
        return Levelled(surface, self._zero[1], levelling)

    @query
    def file(self, sections: Sequence[Section], ending: str) -> bytes:
        """Return the sections as the content of a file with that ending, one of `FILES`."""
        return file_of(sections, ending)
