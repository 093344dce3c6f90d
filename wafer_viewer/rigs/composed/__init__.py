"""Rigs composed of devices by role, and their checks."""
