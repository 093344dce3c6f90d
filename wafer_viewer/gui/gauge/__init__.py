"""Panels and dialogs of the gauge check."""
