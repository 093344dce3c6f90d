"""The wheel that users install: complete, and at work in an environment without this checkout."""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

from tests.support.installation import build_wheel, install_wheel, run, sharpest_in_the_middle
from tests.support.paths import ROOT
from wafer_viewer.session.surface.kernel_build import HEIGHTS, compile_parts

pytestmark = pytest.mark.slow
PYTHONS = ("3.11", "3.12", "3.13")


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    if importlib.util.find_spec("hatchling") is None:
        pytest.skip("hatchling is not installed: bash tests/run.sh setup installs the locked environment")
    return build_wheel(tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("wheel"))


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return install_wheel(wheel, tmp_path_factory.mktemp("environment"))


def test_the_wheel_holds_every_file_of_the_package_and_nothing_else(wheel: Path) -> None:
    listed = subprocess.run(["git", "ls-files", "wafer_viewer"], cwd=ROOT, capture_output=True, text=True)
    if listed.returncode != 0:
        pytest.skip("this is no checkout of git")
    files = {name for name in listed.stdout.splitlines() if (ROOT / name).exists()}
    names = set(zipfile.ZipFile(wheel).namelist())
    held = {name for name in names if name.startswith("wafer_viewer/")}
    assert files <= held
    assert {name for name in held - files if not (ROOT / name).exists()} == set()
    assert {name.split("/")[0] for name in names - held} == {f"{wheel.name.split('-py3')[0]}.dist-info"}
    assert any(name.endswith("licenses/assets/LICENSE") for name in names)
    assert wheel.name.endswith("-py3-none-any.whl")


@pytest.mark.campaign
def test_the_program_of_the_wheel_works_without_the_checkout(installed: Path, tmp_path: Path) -> None:
    code = "import wafer_viewer; print(wafer_viewer.__file__)"
    where = run(installed / "python", "-c", code, cwd=tmp_path)
    assert Path(where.stdout.strip()).is_relative_to(installed.parent), where.stderr
    doctor = run(installed / "wafer-viewer", "doctor", "--data", tmp_path, cwd=tmp_path)
    assert doctor.returncode == 0, doctor.stdout + doctor.stderr
    assert "Traceback" not in doctor.stderr
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    assert run(installed / "wafer-viewer", "--version", cwd=tmp_path).stdout.strip() == f"wafer-viewer {version}"
    plan = tmp_path / "plan.toml"
    plan.write_text((ROOT / "assets/plans/wafer.toml").read_text())
    assert run(installed / "wafer-viewer", "plan", plan, cwd=tmp_path).returncode == 0


@pytest.mark.campaign
def test_installation_finds_the_kernels_of_the_same_sources(installed: Path, tmp_path: Path) -> None:
    compile_parts(HEIGHTS)
    images = sharpest_in_the_middle(tmp_path / "stack.tif")
    words = ("reconstruct", images, "--z-step-um", 4, "--pixel-um", 1, "-o", tmp_path / "surface.npz")
    shared = {name: os.environ[name] for name in ("WAFER_VIEWER_CACHE",) if name in os.environ}
    done = run(installed / "wafer-viewer", *words, cwd=tmp_path, NUMBA_DEBUG_CACHE="1", **shared)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "surface.npz").exists()
    assert "data loaded from" in done.stdout
    assert "data saved to" not in done.stdout


def test_building_the_wheel_needs_hatchling_alone() -> None:
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())
    assert settings["build-system"]["requires"] == ["hatchling"]
    assert "hooks" not in settings["tool"]["hatch"]["build"]["targets"]["wheel"]


def interpreter(version: str) -> str | None:
    """A Python of a version on this machine; a name on the path may be that of a switch, which runs none."""
    own = "{}.{}".format(*sys.version_info)
    pyenv = sorted((Path.home() / ".pyenv/versions").glob(f"{version}.*/bin/python"))
    wanted = [sys.executable if version == own else None, shutil.which(f"python{version}"), *map(str, pyenv[-1:])]
    return next((python for python in wanted if python and run(python, "--version", cwd=ROOT).returncode == 0), None)


@pytest.mark.campaign(at_least_one=True)
@pytest.mark.parametrize("version", PYTHONS)
def test_every_file_of_the_package_is_read_by_every_python_it_is_for(version: str, tmp_path: Path) -> None:
    """The tests run on one of them; `bash tests/run.sh pythons` installs and runs the package on all that are here."""
    python = interpreter(version)
    if python is None:
        pytest.skip(f"there is no Python {version} on this machine")
    copy = shutil.copytree(ROOT / "wafer_viewer", tmp_path / "p", ignore=shutil.ignore_patterns("__pycache__"))
    done = run(python, "-W", "error", "-m", "compileall", "-q", copy, cwd=tmp_path)
    assert done.returncode == 0, done.stdout
    assert tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["requires-python"] == ">=3.11"
