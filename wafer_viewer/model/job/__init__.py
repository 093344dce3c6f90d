"""Verdicts, revisions and reviews of jobs."""
