"""Pose estimation of all fields from overlap measurements, with the stage positions as prior.

Overlaps measure differences of neighbours, the stage measures the position of each field. Both enter one least squares
problem over all fields (`pose_graph`), in which bad overlaps lose their weight (`robust_solver`) and which is solved by
a multigrid method (`amg_solver`). `lateral_poses` and `vertical_poses` formulate it in the plane and along z,
`pose_covariance` computes the uncertainty of the result.
"""
