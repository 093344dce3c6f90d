"""How far a lattice of dies that was given lies off the dies that a surface shows."""

from __future__ import annotations

from wafer_viewer.model.spec import NonNegative, Spec


class DieOffset(Spec, frozen=True, kw_only=True):
    """Seen less given: of the corner of die 0,0, of the pitches in parts of a million, of the angle.

    farthest_um: of any corner of a die that lies on the surface.
    """

    origin_x_um: float
    origin_y_um: float
    pitch_x_ppm: float
    pitch_y_ppm: float
    turn_mrad: float
    farthest_um: NonNegative
