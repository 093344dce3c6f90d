"""Plans, samples, devices, calibrations and focus stacks."""
