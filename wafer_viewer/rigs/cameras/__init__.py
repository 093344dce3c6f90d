"""Drivers of connected cameras, in the table `CAMERAS` of `drivers`; a library is imported when it is needed."""
