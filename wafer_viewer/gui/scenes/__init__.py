"""The contents of the 3D scene at each step."""
