"""Gauge checks, capability and repeatability studies."""
