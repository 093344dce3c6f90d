"""Stacks whose truth is known, their light kept so that a run that was stopped goes on where it was."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tests.truth.layouts import Layout, Taken, take
from tests.truth.scenes import SWEEP_UM

KEPT_LIGHT = Path(tempfile.gettempdir()) / "wafer-viewer-truth"


def seen(layout: Layout, side: int, z_um: NDArray[np.float64] = SWEEP_UM) -> Taken:
    """A square frame of a layout."""
    return take(layout, (side, side), z_um, KEPT_LIGHT)
