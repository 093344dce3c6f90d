"""Modal dialogs of the page."""
