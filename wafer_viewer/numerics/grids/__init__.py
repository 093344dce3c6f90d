"""Resampling, blending and differences of grids."""
