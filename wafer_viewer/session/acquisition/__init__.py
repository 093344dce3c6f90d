"""The rig process, its client and the scan."""
