"""The simulated rig: a sample, optics, a stage and a pulse box on the far end of a cable."""
