"""Smoothing, outlier removal and gap filling of height maps."""
