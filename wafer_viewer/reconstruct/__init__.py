"""Stack to height map to mosaic. Pure."""
