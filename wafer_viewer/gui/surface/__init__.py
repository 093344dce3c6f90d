"""Sections of the surface step."""
