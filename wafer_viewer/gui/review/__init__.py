"""The panel of the review step."""
