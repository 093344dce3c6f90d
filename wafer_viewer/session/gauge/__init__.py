"""Gauge checks and studies of the session."""
