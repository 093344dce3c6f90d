"""Simulated motion controllers: what answers at the far end of a serial cable and moves the virtual stage."""
