"""Samples of the virtual microscope: one module each, all pure functions of stage micrometres."""
