"""The steps of work, one file each."""
