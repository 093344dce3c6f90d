"""Plan to frames, over the device protocols."""
