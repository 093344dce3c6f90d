"""Measurements, sections and results of the session."""
