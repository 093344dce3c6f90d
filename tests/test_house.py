"""The habits of the house that no linter knows."""

from __future__ import annotations

import subprocess
import sys

import pytest

from tests.support.paths import ROOT

MODULES = sorted((ROOT / "wafer_viewer").rglob("*.py"))
ROOMS = sorted(p.name for p in (ROOT / "wafer_viewer").iterdir() if (p / "__init__.py").exists())


@pytest.mark.parametrize("module", MODULES, ids=lambda p: str(p.relative_to(ROOT)))
def test_a_file_has_one_subject(module):
    assert len(module.read_text().splitlines()) <= 600


@pytest.mark.parametrize("room", ROOMS)
def test_the_picture_of_the_architecture_shows_every_room(room):
    assert f"{room}/" in (ROOT / "assets/docs/explanation/architecture.md").read_text()


def test_importing_the_package_pulls_in_nothing_heavy():
    heavy = ["numba", "viser", "open3d", "zarr", "distributed", "scipy", "trimesh", "tifffile", "skimage"]
    code = f"import sys, wafer_viewer; print([m for m in {heavy!r} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
