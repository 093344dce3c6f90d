"""How long tests wait for something that another process does."""

PATIENCE_S = 240.0
"""Kernels may have to be compiled first, on a machine that does other things as well."""
