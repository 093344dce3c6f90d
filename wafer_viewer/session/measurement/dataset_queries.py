"""Queries of the open dataset, from any thread: surfaces, frames, the height at a point, and measurements."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from wafer_viewer.model.acquisition.focus_stack import Image
from wafer_viewer.model.errors import DatasetError, MeasureError
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.field_poses import Poses
from wafer_viewer.model.surface.height_map import HeightMap, Mosaic, Origin
from wafer_viewer.session.core.dataset_library import Library
from wafer_viewer.session.measurement.measure_commands import Measuring
from wafer_viewer.session.state.snapshot import Snapshot
from wafer_viewer.session.surface.comparison_commands import surface_of


@dataclass(frozen=True, slots=True)
class ReadOut:
    """Surface at a point; z_um is None if it is unmeasured, for the reason given by `origin`."""

    z_um: float | None
    confidence: float
    origin: Origin


class DatasetQueries:
    """Read-only queries of the open dataset. Methods raise WaferViewerError on failure."""

    def __init__(self, library: Library, snapshot: Callable[[], Snapshot]) -> None:
        self._library, self._snapshot = library, snapshot
        self.measuring = Measuring(self.surface_source, snapshot)

    def mosaic(self) -> Mosaic:
        """Return the stitched surface of the open dataset."""
        return self._library.result.mosaic()

    def height_map(self, field_number: int) -> HeightMap:
        """Return the surface of one field."""
        return self._library.result.surface(self._library.dataset.field(field_number))

    def surface_source(self, show: int) -> Mosaic:
        """Return the displayed surface: 0 the stitched one, above 0 the field of that number, below 0 a comparison."""
        if show < 0:
            return surface_of(self._snapshot(), show)
        return self.mosaic() if show == 0 else self.height_map(show)

    def poses(self) -> Poses | None:
        """Return the field poses and overlap measurements of the stitched surface.

        None if only stage positions were used.
        """
        return self._library.result.poses()

    def frame(self, field_number: int, k: int) -> Image:
        """Return one frame of a field, as it was stored."""
        stack = self._library.dataset.stack(field_number, verify=False)
        if not 0 <= k < stack.n_frames or not stack.present[k]:
            raise DatasetError(f"Field {field_number} has no frame {k} of {stack.n_frames}: choose another.")
        return np.array(stack.images[k])

    def frame_near(self, field_number: int, z_um: float) -> Image:
        """Return the frame of a field nearest to a z, as it was stored."""
        stack = self._library.dataset.stack(field_number, verify=False)
        away = np.where(stack.present, np.abs(stack.z_um - z_um), np.inf)
        return np.array(stack.images[int(away.argmin())])

    def thumbnail(self, number: int) -> bytes | None:
        """Return the thumbnail of a result, JPEG; None if there is none."""
        return self._library.result.thumbnail(number)

    def read_out(self, x_um: float, y_um: float, show: int = 0) -> ReadOut:
        """Return the surface at a point. Raises MeasureError if the point is outside."""
        at = self.surface_source(show).window(Region.rectangle(x_um, y_um, x_um, y_um))
        if 0 in at.shape:
            raise MeasureError(f"({x_um:.1f}, {y_um:.1f}) um lies outside of the surface.")
        z_um = float(at.z_um[0, 0])
        return ReadOut(z_um if np.isfinite(z_um) else None, float(at.confidence[0, 0]), Origin(int(at.origin[0, 0])))
