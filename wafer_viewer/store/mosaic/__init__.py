"""The stitched surface as a Zarr pyramid."""
