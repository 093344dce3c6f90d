"""Sections of surfaces along lines and their export to files, for the session and the command line."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from wafer_viewer._version import __version__
from wafer_viewer.measure.base.height_samples import Layer
from wafer_viewer.model.errors import DatasetError, MeasureError
from wafer_viewer.model.measurement.sections import Section, SectionAsked
from wafer_viewer.model.surface.height_map import Mosaic


def cut(asked: SectionAsked, surface: Mosaic, calibrated: bool, source: str) -> Section:
    """Return a section of a surface. Raises MeasureError when nothing was measured along the line."""
    from wafer_viewer.measure.tools.profile import profile

    layer = other_layer(surface) if asked.cleaned else None
    try:
        found, curve = profile(surface, asked.line, calibration_valid=calibrated, layer=layer)
    except MeasureError as fault:
        if asked.of is None:
            raise
        raise MeasureError(f"{source} has no heights along line {asked.letter}. {fault}") from fault
    return Section(asked, found, curve, source)


def other_layer(surface: Mosaic) -> Layer:
    """Return the layer that is not measured on, of measured and filtered heights."""
    return "unsmoothed" if surface.provenance.recipe.measure_on == "smoothed" else "filled"


def file_of(sections: Sequence[Section], ending: str) -> bytes:
    """Return sections as the content of a file with that ending. Raises DatasetError as `require_known` does."""
    require_known(ending)
    return FILES[ending.lower()](sections)


def require_known(ending: str) -> None:
    """Raise DatasetError if sections cannot be written to a file with that ending."""
    if ending.lower() not in FILES:
        raise DatasetError(f"Profiles cannot be written as '{ending}': use {' or '.join(FILES)}.")


def write_sections(sections: Sequence[Section], path: Path) -> None:
    """Write sections to a file atomically; its ending determines the format."""
    from wafer_viewer.store.io.atomic_files import atomic_write

    content = file_of(sections, path.suffix)
    with atomic_write(path) as beside:
        beside.write_bytes(content)


def _table(sections: Sequence[Section]) -> bytes:
    from wafer_viewer.store.tables.profile_csv import profiles_csv

    return profiles_csv(sections, __version__).encode()


def _picture(sections: Sequence[Section]) -> bytes:
    from wafer_viewer.draw.print.profile_figure import profile_png

    return profile_png(sections)


FILES: dict[str, Callable[[Sequence[Section]], bytes]] = {".csv": _table, ".png": _picture}
"""Section writers by file ending."""
