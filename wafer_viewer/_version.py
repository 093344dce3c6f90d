"""Version of the package, importable on its own."""

__version__ = "0.1.0"
