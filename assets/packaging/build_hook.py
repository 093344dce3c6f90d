"""Build hook: compile the kernels of the program while it is installed, so that no user waits for a compiler.

The wheel holds them for the processor, the Python and the numba that it is built with, which are those of the user
where pip builds it from the sources. Elsewhere nothing of them is loaded, and the program compiles at its first use.
An editable installation has no wheel of its own: what it compiles goes to the user's cache folder.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

SWITCH = "WAFER_VIEWER_COMPILE"
"""0 in the environment leaves the kernels out, as for a wheel that goes to other machines."""
INSTALLED = "wafer_viewer/numerics/compiled"
COMPILE = "from wafer_viewer.session.surface.kernel_build import compile_all; compile_all()"


class KernelHook(BuildHookInterface):  # type: ignore[type-arg]
    """Compiles before the files of a wheel are collected."""

    PLUGIN_NAME = "custom"

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Add the compiled kernels to the wheel; without them the wheel is whole all the same."""
        if os.environ.get(SWITCH) == "0":
            return
        if version == "editable":
            self._compile({})
            return
        self._folder = tempfile.TemporaryDirectory()
        kernels = Path(self._folder.name) / "kernels"
        if self._compile({"WAFER_VIEWER_CACHE": self._folder.name}) and kernels.is_dir():
            build_data["force_include"][str(kernels)] = INSTALLED

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Remove what was compiled beside the sources."""
        if folder := getattr(self, "_folder", None):
            folder.cleanup()

    def _compile(self, settings: dict[str, str]) -> bool:
        """Run the compilation in a process that imports the program from its sources."""
        path = os.pathsep.join(filter(None, (self.root, os.environ.get("PYTHONPATH"))))
        environment = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1", "PYTHONPATH": path, **settings}
        done = subprocess.run([sys.executable, "-c", COMPILE], env=environment, capture_output=True, text=True)
        if done.returncode:
            reason = done.stderr.strip().rpartition("\n")[2]
            self.app.display_warning(f"The kernels were not compiled ({reason}): the first use of the program does.")
        return done.returncode == 0
