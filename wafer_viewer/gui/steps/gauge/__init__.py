"""The step Gauge check: checks against blocks, studies, and calibrations of the instrument."""
