"""The difference of two surfaces."""
