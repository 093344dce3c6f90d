"""Pure algorithms that several rooms need: compiled kernels, robust fits, NaN-aware filters, image shifts."""
