"""Gauge checks and repeatability studies."""
