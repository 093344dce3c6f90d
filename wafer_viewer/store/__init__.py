"""What is on disk: datasets, journals, mosaics; and the ways in and out."""
