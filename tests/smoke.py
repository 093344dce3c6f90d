"""Try an installed package as a user would: scan, reconstruct, stitch, measure, export, and open the documentation.

    python tests/smoke.py [--site]

It runs with the Python of the environment to be tried, in an empty folder, and knows nothing of a checkout. --site also
asks for the site of the documentation, which the wheel of a release brings. It ends with the first thing that fails.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from importlib import metadata
from pathlib import Path

PLAN = """
z_start_um = -6.0
[grid]
rows = 1
cols = 2
field_width_um = 336.4488
field_height_um = 252.3366
overlap_x_fraction = 0.1
x0_um = 648.6
y0_um = 560.0
[sweep]
z_step_um = 2.0
n_frames = 26
"""


def viewer(folder: Path, *words: str) -> str:
    """Run a command of the program, and return what it prints."""
    began = time.monotonic()
    done = subprocess.run(
        [sys.executable, "-P", "-m", "wafer_viewer", *words], cwd=folder, capture_output=True, text=True
    )
    print(f"{time.monotonic() - began:6.1f} s  wafer-viewer {' '.join(words)}", flush=True)
    if done.returncode:
        sys.exit(f"ended with {done.returncode}\n{done.stdout}{done.stderr}")
    return done.stdout


def require(held: bool, what: str) -> None:
    """End the trial if something does not hold."""
    if not held:
        sys.exit(f"wrong: {what}")


def main() -> None:
    """Try everything once."""
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        (folder / "plan.toml").write_text(PLAN)
        version = metadata.version("wafer-viewer")
        require(viewer(folder, "--version").split() == ["wafer-viewer", version], "the version")
        viewer(folder, "doctor", "--data", "data")
        viewer(folder, "plan", "plan.toml")
        require("52 of 52 frames" in viewer(folder, "scan", "plan.toml", "-o", "scan.wafer"), "frames of the scan")
        viewer(folder, "stitch", "scan.wafer")
        viewer(folder, "check", "scan.wafer")
        found = json.loads(viewer(folder, "measure", "flatness", "scan.wafer", "--region", "700", "470", "780", "520"))
        require(found["type"] == "flatness", "the measurement")
        viewer(folder, "reconstruct", "scan.wafer", "-o", "surface.x3p")
        viewer(folder, "report", "scan.wafer", "-o", "report.html")
        require("SIMULATED" in (folder / "report.html").read_text(encoding="utf-8"), "the report")
        if "--site" in sys.argv:
            address = viewer(folder, "docs").strip()
            require(address.endswith("/site/index.html"), f"the address of the documentation, {address}")
    print(f"wafer-viewer {version} works with Python {sys.version.split()[0]} on {sys.platform}.")


if __name__ == "__main__":
    main()
