"""Planning and execution of scans over the device protocols."""
