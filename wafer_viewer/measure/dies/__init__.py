"""The die lattice: period, evidence, refinement, status."""
