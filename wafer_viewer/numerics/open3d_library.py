"""Open3D, imported on first use: its import is slow, and fails where a library that it links to is missing."""

from __future__ import annotations

import ctypes
import importlib
import sys
from contextlib import suppress
from typing import Any

from wafer_viewer.model.errors import ComputeError

_USB = "libusb-1.0.so.0"
_DEBIAN_PACKAGES = {
    _USB: "libusb-1.0-0",
    "libGL.so.1": "libgl1",
    "libEGL.so.1": "libegl1",
    "libX11.so.6": "libx11-6",
    "libudev.so.1": "libudev1",
    "libidn2.so.0": "libidn2-0",
}
"""Libraries of the system that Open3D links to beyond the C++ run-time library, and their packages."""


class Open3DMissing(ComputeError):
    """Open3D cannot be loaded. reason: from the import; mend: the command that mends it."""

    def __init__(self, reason: str, mend: str) -> None:
        super().__init__(reason, mend)
        self.reason, self.mend = reason, mend

    def __str__(self) -> str:
        return f"Open3D cannot be loaded ({self.reason}): run '{self.mend}'."


def load_open3d() -> Any:
    """Return the module Open3D. Raises Open3DMissing."""
    try:
        if sys.platform == "linux" and not _loads(_USB):
            _load_packaged_usb()
        return importlib.import_module("open3d")
    except (ImportError, OSError) as fault:
        raise Open3DMissing(str(fault), _mend()) from fault


def _load_packaged_usb() -> None:
    """Load libusb from its package on PyPI: the linker then takes it for the one of the system."""
    with suppress(ImportError, OSError):  # then the import of Open3D gives the reason
        import libusb_package

        ctypes.CDLL(str(libusb_package.get_library_path()))


def _mend() -> str:
    absent = [p for library, p in _DEBIAN_PACKAGES.items() if sys.platform == "linux" and not _loads(library)]
    return f"sudo apt-get install {' '.join(absent)}" if absent else "pip install --force-reinstall wafer-viewer"


def _loads(library: str) -> bool:
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True
