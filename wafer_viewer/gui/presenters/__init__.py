"""Text and HTML for the page, made of results and settings."""
