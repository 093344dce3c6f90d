"""Height map to numbers. Pure."""
