"""Where fields lie and how they lean: the door to the solving of poses.

Overlaps measure differences of neighbours, the stage says where each field is by itself. Both go into one least squares
problem over all fields (`network`), in which bad overlaps lose their weight (`settle`) and which is solved by a
multigrid method (`multigrid`); `positions` and `levels` say what it is in the plane and along z, `sureness` how sure
the result is.
"""

from __future__ import annotations

from wafer_viewer.reconstruct.pose_graph.camera_rotation_scale import Camera
from wafer_viewer.reconstruct.pose_graph.lateral_poses import Positions, solve_positions
from wafer_viewer.reconstruct.pose_graph.vertical_poses import Levels, solve_heights

__all__ = ["Camera", "Levels", "Positions", "solve_heights", "solve_positions"]
