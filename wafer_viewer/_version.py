"""Version of the package, importable on its own."""

__version__ = "1.0.0rc1"
