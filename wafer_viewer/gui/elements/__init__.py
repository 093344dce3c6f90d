"""A step of work as data: what it shows, and the reconciler that brings viser's widgets to it."""
