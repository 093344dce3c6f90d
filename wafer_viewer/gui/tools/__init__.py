"""Regions and lines that are placed on the surface with handles."""
