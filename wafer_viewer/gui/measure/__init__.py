"""Sections and docks of the measurement step."""
