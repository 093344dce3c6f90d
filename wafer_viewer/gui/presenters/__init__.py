"""Text and HTML for the page, built from results and settings."""
