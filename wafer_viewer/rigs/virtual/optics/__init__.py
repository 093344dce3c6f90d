"""The imaging model of the virtual microscope."""
