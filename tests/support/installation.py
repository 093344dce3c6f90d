"""The program as users install it: its wheel, and an environment that holds it and nothing of this checkout."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import sysconfig
import venv
from pathlib import Path

import numpy as np
import tifffile

from tests.support.paths import ROOT

SECONDS = 1800
"""Patience with the compilation of kernels on a busy machine, where they are not compiled yet."""


def run(*words: object, cwd: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run a command that knows nothing of this checkout and its environment."""
    clean = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "PIP_", "WAFER_"))}
    command = [str(word) for word in words]
    return subprocess.run(command, cwd=cwd, env=clean | environment, capture_output=True, text=True, timeout=SECONDS)


def build_wheel(source: Path, out: Path) -> Path:
    """Build the wheel of a copy of what git would hand out, by the builder of this environment."""
    for name in ("pyproject.toml", "README.md", "assets/LICENSE"):
        (source / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, source / name)
    shutil.copytree(ROOT / "wafer_viewer", source / "wafer_viewer", ignore=shutil.ignore_patterns("__pycache__"))
    words = (sys.executable, "-m", "pip", "wheel", "--no-deps", "--no-build-isolation", "--wheel-dir", out, source)
    done = run(*words, cwd=source)
    if done.returncode:
        raise RuntimeError(done.stderr)
    (built,) = out.glob("*.whl")
    return built


def install_wheel(wheel: Path, folder: Path) -> Path:
    """Make an environment with the wheel; what it needs is taken from this one. Return its folder of programs."""
    venv.create(folder)
    programs = folder / ("Scripts" if os.name == "nt" else "bin")
    code = "import sysconfig; print(sysconfig.get_path('purelib'))"
    site = run(programs / "python", "-c", code, cwd=folder).stdout.strip()
    pip = (sys.executable, "-m", "pip", "--python", programs / "python")
    done = run(*pip, "install", "--no-deps", "--no-index", wheel, cwd=folder)
    if done.returncode:
        raise RuntimeError(done.stderr)
    # A folder of a .pth file comes last, and its own .pth files, as that of this checkout, are not read.
    (Path(site) / "needed.pth").write_text(f"{sysconfig.get_path('purelib')}\n")
    return programs


def sharpest_in_the_middle(file: Path) -> Path:
    """Write a small focus stack that no kernel has seen."""
    noise = np.random.default_rng(0).normal(0, 1, (12, 200, 260))
    sharp = 5 + 40 * np.exp(-((np.arange(12) - 6) ** 2.0))[:, None, None]
    tifffile.imwrite(file, (128 + sharp * noise).clip(0, 255).astype(np.uint8), photometric="minisblack")
    return file
