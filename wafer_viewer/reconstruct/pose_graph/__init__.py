"""Where every field is: from what overlaps measure and where the stage says that fields are.

Overlaps measure differences of neighbours, the stage says where each field is by itself. Both go into one least squares
problem over all fields (`pose_graph`), in which bad overlaps lose their weight (`robust_solver`) and which is solved by
a multigrid method (`amg_solver`). `lateral_poses` and `vertical_poses` state it in the plane and along z,
`pose_covariance` says how certain the result is.
"""
