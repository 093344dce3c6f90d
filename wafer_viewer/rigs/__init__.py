"""Drivers of the rigs: pulse box protocol, and the virtual rig."""
