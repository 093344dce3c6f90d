"""Sections, docks and dialogs of defect inspection."""
