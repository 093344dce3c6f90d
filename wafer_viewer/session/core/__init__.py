"""Command queue, control, undo and notifications."""
