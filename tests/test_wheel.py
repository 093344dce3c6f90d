"""The wheel that users install: complete, and at work in an environment without this checkout."""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
import sysconfig
import tomllib
import venv
import zipfile
from pathlib import Path

import pytest

from tests.support.paths import ROOT

pytestmark = pytest.mark.slow
PYTHONS = ("3.11", "3.12", "3.13")


def run(*words: object, cwd: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    clean = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "PIP_"))}
    command = [str(word) for word in words]
    return subprocess.run(command, cwd=cwd, env=clean | environment, capture_output=True, text=True, timeout=300)


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel of a copy of what git would hand out, built by the builder of this environment."""
    if importlib.util.find_spec("hatchling") is None:
        pytest.skip("hatchling is not installed: bash tests/run.sh setup installs the locked environment")
    source, out = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("wheel")
    for name in ("pyproject.toml", "README.md"):
        shutil.copy(ROOT / name, source)
    shutil.copytree(ROOT / "wafer_viewer", source / "wafer_viewer", ignore=shutil.ignore_patterns("__pycache__"))
    (source / "assets").mkdir()
    shutil.copy(ROOT / "assets/LICENSE", source / "assets")
    words = (sys.executable, "-m", "pip", "wheel", "--no-deps", "--no-build-isolation", "--wheel-dir", out, source)
    done = run(*words, cwd=source)
    assert done.returncode == 0, done.stderr
    (built,) = out.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A new environment with the wheel and nothing of the checkout; what it needs is taken from this environment."""
    folder = tmp_path_factory.mktemp("environment")
    venv.create(folder, with_pip=True)
    program = folder / ("Scripts" if os.name == "nt" else "bin")
    code = "import sysconfig; print(sysconfig.get_path('purelib'))"
    site = run(program / "python", "-c", code, cwd=folder).stdout.strip()
    done = run(program / "python", "-m", "pip", "install", "--no-deps", "--no-index", wheel, cwd=folder)
    assert done.returncode == 0, done.stderr
    # A folder of a .pth file comes last, and its own .pth files, as that of this checkout, are not read.
    (Path(site) / "needed.pth").write_text(f"{sysconfig.get_path('purelib')}\n")
    return program


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


def interpreter(version: str) -> str | None:
    """A Python of a version on this machine; a name on the path may be that of a switch, which runs none."""
    own = "{}.{}".format(*sys.version_info)
    pyenv = sorted((Path.home() / ".pyenv/versions").glob(f"{version}.*/bin/python"))
    wanted = [sys.executable if version == own else None, shutil.which(f"python{version}"), *map(str, pyenv[-1:])]
    return next((python for python in wanted if python and run(python, "--version", cwd=ROOT).returncode == 0), None)


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
