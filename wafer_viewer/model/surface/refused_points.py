"""Heights rejected by a gate, stored in addition to the height map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.errors import MeasureError


@dataclass(frozen=True, slots=True, eq=False)
class RefusedHeights:
    """Peaks of a field that failed a gate, with the heights they would have had.

    Pixels filled afterwards are included: their origin in the height map is FILLED, their reason is stored here.

    Parameters
    ----------
    at
        Pixel numbers in row-major order, ascending; uint32 [n].
    z_um
        Height of the refused peak in um; float32 [n].
    reason
        Code of `Origin` of the first gate that failed; uint8 [n].

    Raises
    ------
    MeasureError
        If the three differ in length.
    """

    at: NDArray[np.uint32]
    z_um: NDArray[np.float32]
    reason: NDArray[np.uint8]

    def __post_init__(self) -> None:
        lengths = {len(self.at), len(self.z_um), len(self.reason)}
        if len(lengths) != 1:
            raise MeasureError(f"Refused heights have arrays of the lengths {sorted(lengths)}: give one length.")

    def __len__(self) -> int:
        return len(self.at)

    def of_rows(self, first: int, end: int, cols: int) -> slice:
        """Return the slice of points in the rows [first, end) of a map with `cols` columns."""
        low, high = np.searchsorted(self.at, [max(0, first) * cols, max(0, end) * cols])
        return slice(int(low), int(high))
