"""Offset of a given lattice of dies from the dies found on a surface."""

from __future__ import annotations

from wafer_viewer.model.spec import NonNegative, Spec


class DieOffset(Spec, frozen=True, kw_only=True):
    """Found minus given: corner of die 0,0, pitches in ppm, rotation.

    farthest_um: largest offset of any die corner on the surface.
    """

    origin_x_um: float
    origin_y_um: float
    pitch_x_ppm: float
    pitch_y_ppm: float
    turn_mrad: float
    farthest_um: NonNegative
