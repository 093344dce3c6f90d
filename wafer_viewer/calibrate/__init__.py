"""Calibration of wafer alignment and z scale. Pure functions."""
