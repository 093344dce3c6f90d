"""Tests that a focus peak must pass to become a height."""
