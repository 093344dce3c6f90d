"""Wafer Viewer: shape from focus over whole wafers, from the scan to the measured surface.

All names are loaded on first use, so that importing the package takes almost no time: ``__init__.pyi`` lists them.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
