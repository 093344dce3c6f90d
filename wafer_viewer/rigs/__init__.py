"""The devices: real ones and the simulated one, one file each."""
