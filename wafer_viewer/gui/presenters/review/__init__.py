"""Text and HTML of the review of defects and results."""
