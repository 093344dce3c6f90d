"""The panel of the acquisition step."""
