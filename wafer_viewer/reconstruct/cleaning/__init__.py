"""Smoothing, outlier removal and filling of height maps."""
