"""Pure algorithms used by several packages: compiled kernels, robust fits, NaN-aware filters, image shifts."""
