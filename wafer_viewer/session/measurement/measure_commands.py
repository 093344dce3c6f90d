"""Measurements on the open dataset, with levelling and calibration state."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, TypeVar

from wafer_viewer.model.findings import AnyResult
from wafer_viewer.model.measurement.levelling import Datum, Levelling
from wafer_viewer.model.measurement.measurement import MeasurementResult
from wafer_viewer.model.measurement.measurements import Profile, ProfileCurve
from wafer_viewer.model.measurement.sections import SlabPoints
from wafer_viewer.model.measurement.tool_options import ToolOptions
from wafer_viewer.model.measurement.tools import ToolName
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.height_map import Mosaic
from wafer_viewer.session.state.snapshot import Snapshot

if TYPE_CHECKING:
    from wafer_viewer.measure.base.height_samples import Layer

BY_STAGE = Levelling()
REMEMBERED = 16
Surfaces = Callable[[int], Mosaic]
F = TypeVar("F", bound=MeasurementResult)


class Measuring:
    """Measurements of the displayed surface, from any thread; they change nothing and raise WaferViewerError."""

    def __init__(self, surfaces: Surfaces, snapshot: Callable[[], Snapshot]) -> None:
        self._surfaces, self._snapshot = surfaces, snapshot
        self._datums: dict[object, Datum] = {}

    def measure(
        self,
        tool: ToolName,
        places: tuple[Region, ...],
        show: int = 0,
        levelling: Levelling | None = None,
        options: ToolOptions | None = None,
    ) -> AnyResult:
        """Return the result of a measuring tool at its regions of the displayed surface."""
        from wafer_viewer.measure.registry import measured

        found = measured(self._levelled(levelling, show), tool, places, self._calibrated(), options)
        return self._told(found, show, levelling)

    def profile(
        self, line: Region, show: int = 0, levelling: Levelling | None = None, layer: Layer | None = None
    ) -> tuple[Profile, ProfileCurve]:
        """Return a section along a line."""
        from wafer_viewer.measure.tools.profile import profile

        surface = self._levelled(levelling, show)
        found, curve = profile(surface, line, calibration_valid=self._calibrated(), layer=layer)
        return self._told(found, show, levelling), curve

    def slab(
        self, line: Region, show: int = 0, levelling: Levelling | None = None
    ) -> tuple[Profile, ProfileCurve, SlabPoints]:
        """Return a section through the slab along a line."""
        from wafer_viewer.measure.tools.slab import slab_profile

        surface = self._levelled(levelling, show)
        found, curve, points = slab_profile(surface, line, calibration_valid=self._calibrated())
        return self._told(found, show, levelling), curve, points

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

    def _told(self, found: F, show: int, levelling: Levelling | None) -> F:
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
