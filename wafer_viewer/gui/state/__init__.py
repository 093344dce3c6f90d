"""What one browser looks at: view, plot and list state."""
