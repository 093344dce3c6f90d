"""Surface file formats of other programs, one module each: strip-wise export, and import."""
