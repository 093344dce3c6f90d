"""Where fields lie and how they lean: the door to the solving of poses.

Overlaps measure differences of neighbours, the stage says where each field is by itself. Both go into one least squares
problem over all fields (`network`), in which bad overlaps lose their weight (`settle`) and which is solved by a
multigrid method (`multigrid`); `positions` and `levels` say what it is in the plane and along z, `sureness` how sure
the result is.
"""

from __future__ import annotations

from wafer_viewer.reconstruct.camera_axes import Camera
from wafer_viewer.reconstruct.levels import Levels, solve_heights
from wafer_viewer.reconstruct.positions import Positions, solve_positions

__all__ = ["Camera", "Levels", "Positions", "solve_heights", "solve_positions"]
