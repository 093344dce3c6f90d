"""Import, export and documents."""
