"""Panels and dialogs of planning, jobs and alignment."""
