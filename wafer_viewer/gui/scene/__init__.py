"""Nodes of the 3D scene: reconciliation, picking, handles, labels."""
