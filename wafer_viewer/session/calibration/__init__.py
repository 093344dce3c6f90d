"""Calibrations of the instrument: procedures on the rig, records, and the list of what is due."""
