"""Frames to Calibration. Pure."""
