"""The simulated rig: a sample, optics, a stage, a camera, and a pulse box on a virtual serial port."""
