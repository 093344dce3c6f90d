"""Placed fields blended into one surface."""
