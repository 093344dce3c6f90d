"""Measuring tools, their options and their results."""
