"""State of one browser: view, plot and defect list."""
