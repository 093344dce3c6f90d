"""Subpixel edges in the all-in-focus image."""
