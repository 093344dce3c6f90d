"""Packages that bring plug-ins, written into a folder as an installer leaves them."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path


def write_package(folder: Path, name: str, source: str, entry_points: Mapping[str, str]) -> Path:
    """Write a module and its metadata; `entry_points`: group to ``name = module:object``. Return the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{name}.py").write_text(source)
    about = folder / f"{name}-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    sections = (f"[wafer_viewer.{group}]\n{line}\n" for group, line in entry_points.items())
    (about / "entry_points.txt").write_text("\n".join(sections))
    return folder


def run_with(folder: Path, *arguments: str, check: bool = True) -> subprocess.CompletedProcess[str]:
    """Run Python with the packages of a folder installed."""
    path = os.pathsep.join(filter(None, (str(folder), os.environ.get("PYTHONPATH"))))
    environment = {**os.environ, "PYTHONPATH": path}
    return subprocess.run(
        [sys.executable, *arguments], env=environment, capture_output=True, text=True, check=check, timeout=120
    )
