"""Queries of and measurements on the open dataset, from any thread, with levelling and calibration state."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from wafer_viewer._version import __version__
from wafer_viewer.measure.base.height_samples import Layer
from wafer_viewer.model.acquisition.focus_stack import Image
from wafer_viewer.model.errors import DatasetError, MeasureError
from wafer_viewer.model.findings import AnyResult
from wafer_viewer.model.measurement.measurements import MeasurementResult, Profile, ProfileCurve
from wafer_viewer.model.measurement.measuring_tool import ToolName
from wafer_viewer.model.measurement.sections import OtherSurface, Section, SectionRequest, SlabPoints
from wafer_viewer.model.measurement.tool_options import Datum, Levelling
from wafer_viewer.model.measurement.tools import ToolOptions
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.field_poses import Poses
from wafer_viewer.model.surface.height_map import HeightMap, Mosaic, Origin
from wafer_viewer.session.core.commands import query
from wafer_viewer.session.core.dataset_library import Library
from wafer_viewer.session.state.snapshot import Snapshot
from wafer_viewer.session.surface.comparison_job import surface_of

if TYPE_CHECKING:
    from wafer_viewer.draw.print_figures import ProfileFormat


# ------------------------------------------------------------------------------------------------------ dataset queries


BY_STAGE = Levelling()
REMEMBERED = 16
Surfaces = Callable[[int], Mosaic]
F = TypeVar("F", bound=MeasurementResult)


class Measuring:
    """Measurements of the displayed surface, from any thread; they change nothing and raise WaferViewerError."""

    def __init__(self, surfaces: Surfaces, snapshot: Callable[[], Snapshot]) -> None:
        self._surfaces, self._snapshot = surfaces, snapshot
        self._datums: dict[object, Datum] = {}

    @query
    def measure(
        self,
        tool: ToolName,
        places: tuple[Region, ...],
        show: int = 0,
        levelling: Levelling | None = None,
        options: ToolOptions | None = None,
    ) -> AnyResult:
        """Return the result of a measuring tool at its regions, heights relative to the stage's zero or levelled."""
        from wafer_viewer.measure.registry import measured

        found = measured(self._levelled(levelling, show), tool, places, self._calibrated(), options)
        return self._labelled(found, show, levelling)

    @query
    def profile(
        self, line: Region, show: int = 0, levelling: Levelling | None = None, layer: Layer | None = None
    ) -> tuple[Profile, ProfileCurve]:
        """Return a section along a line. layer: the heights to cut, by default those that are measured on."""
        from wafer_viewer.measure.tools.profile import profile

        surface = self._levelled(levelling, show)
        found, curve = profile(surface, line, calibration_valid=self._calibrated(), layer=layer)
        return self._labelled(found, show, levelling), curve

    @query
    def slab(
        self, line: Region, show: int = 0, levelling: Levelling | None = None
    ) -> tuple[Profile, ProfileCurve, SlabPoints]:
        """Return a section through the slab along a line."""
        from wafer_viewer.measure.tools.profile import slab_profile

        surface = self._levelled(levelling, show)
        found, curve, points = slab_profile(surface, line, calibration_valid=self._calibrated())
        return self._labelled(found, show, levelling), curve, points

    @query
    def datum(self, levelling: Levelling, show: int = 0) -> Datum:
        """Return the datum of a levelling on the displayed surface; cached for each state of the surface."""
        from wafer_viewer.measure.base.levelled_surface import datum

        key = levelling, show, _stamp(self._snapshot(), show)
        if key not in self._datums:
            self._datums = dict(list(self._datums.items())[1 - REMEMBERED :])
            self._datums[key] = datum(self._surfaces(show), levelling)
        return self._datums[key]

    def _levelled(self, levelling: Levelling | None, show: int) -> Mosaic:
        from wafer_viewer.measure.base.levelled_surface import Levelled

        surface = self._surfaces(show)
        if levelling is None or levelling == BY_STAGE:
            return surface
        return Levelled(surface, self.datum(levelling, show), levelling)

    def _labelled(self, found: F, show: int, levelling: Levelling | None) -> F:
        return replace(found, show=show, levelling=levelling or BY_STAGE)

    def _calibrated(self) -> bool:
        shown = self._snapshot().dataset
        return shown is not None and shown.calibration_problem is None


def _stamp(snapshot: Snapshot, show: int) -> object:
    """Return a key that changes whenever the displayed surface does."""
    shown, surface = snapshot.dataset, snapshot.surface
    if shown is None:
        return None
    if show < 0:
        return shown.path, tuple(compared.stamp for compared in snapshot.comparisons)
    return shown.path, shown.stamps.get(show) if show else surface and surface.stamp


@dataclass(frozen=True, slots=True)
class ReadOut:
    """Surface at a point; z_um is None if it is unmeasured, for the reason given by `origin`.

    u_um: standard uncertainty (k = 1) of the height, None if it is not known.
    """

    z_um: float | None
    confidence: float
    origin: Origin
    u_um: float | None = None


class DatasetQueries:
    """Read-only queries of the open dataset. Methods raise WaferViewerError on failure."""

    def __init__(self, library: Library, snapshot: Callable[[], Snapshot]) -> None:
        self._library, self._snapshot = library, snapshot
        self.measuring = Measuring(self.surface_source, snapshot)

    @query
    def mosaic(self) -> Mosaic:
        """Return the stitched surface of the open dataset."""
        return self._library.result.mosaic()

    @query
    def height_map(self, field: int) -> HeightMap:
        """Return the surface of one field."""
        return self._library.result.surface(self._library.dataset.field(field))

    @query
    def surface_source(self, show: int) -> Mosaic:
        """Return the displayed surface: 0 the stitched one, above 0 the field of that number, below 0 a comparison."""
        if show < 0:
            return surface_of(self._snapshot(), show)
        return self.mosaic() if show == 0 else self.height_map(show)

    @query
    def poses(self) -> Poses | None:
        """Return the field poses and overlap measurements of the stitched surface.

        None if only stage positions were used.
        """
        return self._library.result.poses()

    @query
    def frame(self, field: int, k: int) -> Image:
        """Return one frame of a field, as it was stored."""
        stack = self._library.dataset.stack(field, verify=False)
        if not 0 <= k < stack.n_frames or not stack.present[k]:
            raise DatasetError(f"Field {field} has no frame {k} of {stack.n_frames}: choose another.")
        return np.array(stack.images[k])

    @query
    def frame_near(self, field: int, z_um: float) -> Image:
        """Return the frame of a field nearest to a z, as it was stored."""
        stack = self._library.dataset.stack(field, verify=False)
        away = np.where(stack.present, np.abs(stack.z_um - z_um), np.inf)
        return np.array(stack.images[int(away.argmin())])

    @query
    def thumbnail(self, number: int) -> bytes | None:
        """Return the thumbnail of a result, JPEG; None if there is none."""
        return self._library.result.thumbnail(number)

    @query
    def read_out(self, x_um: float, y_um: float, show: int = 0) -> ReadOut:
        """Return the surface at a point. Raises MeasureError if the point is outside."""
        pixel = self.surface_source(show).window(Region.rectangle(x_um, y_um, x_um, y_um))
        if 0 in pixel.shape:
            raise MeasureError(f"({x_um:.1f}, {y_um:.1f}) um lies outside of the surface.")
        z_um, u_um = float(pixel.z_um[0, 0]), np.nan if pixel.u_um is None else float(pixel.u_um[0, 0])
        return ReadOut(
            z_um if np.isfinite(z_um) else None,
            float(pixel.confidence[0, 0]),
            Origin(int(pixel.origin[0, 0])),
            u_um if np.isfinite(u_um) else None,
        )


# ------------------------------------------------------------------------------------------------------------- sections


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
