"""The wheel that users install: complete, and at work in an environment without this checkout."""

from __future__ import annotations

import importlib.util
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from importlib import metadata
from pathlib import Path

import pytest

from tests.support.installation import build_wheel, install_wheel, run, sharpest_in_the_middle
from tests.support.paths import ROOT
from wafer_viewer.session.surface.kernel_build import PARTS

pytestmark = pytest.mark.slow
COMPILED = "wafer_viewer/numerics/compiled/"
PYTHONS = ("3.11", "3.12", "3.13")
COMPILE = "from wafer_viewer.session.surface.kernel_build import compile_all; compile_all()"
"""What the hook runs."""
WITHOUT = """
import sys
from pathlib import Path

sys.modules.update(dict.fromkeys({others}))
with Path({started}).open("a") as file:
    file.write(repr(sys.orig_argv) + chr(10))
"""
"""A sitecustomize module, by which each process notes that it started, and cannot import the modules named."""


@pytest.fixture(scope="module")
def bare(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder for PYTHONPATH with which only that can be imported which pip installs where it builds the wheel."""
    folder = tmp_path_factory.mktemp("bare")
    text = WITHOUT.format(others=sorted(others_than_asked_for()), started=repr(str(folder / "started")))
    (folder / "sitecustomize.py").write_text(text)
    return folder


@pytest.fixture(scope="module")
def wheel(bare: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    if importlib.util.find_spec("hatchling") is None:
        pytest.skip("hatchling is not installed: bash tests/run.sh setup installs the locked environment")
    return build_wheel(tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("wheel"), PYTHONPATH=str(bare))


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return install_wheel(wheel, tmp_path_factory.mktemp("environment"))


def test_the_wheel_holds_every_file_of_the_package_and_nothing_else(wheel: Path) -> None:
    listed = subprocess.run(["git", "ls-files", "wafer_viewer"], cwd=ROOT, capture_output=True, text=True)
    if listed.returncode != 0:
        pytest.skip("this is no checkout of git")
    files = {name for name in listed.stdout.splitlines() if (ROOT / name).exists()}
    names = set(zipfile.ZipFile(wheel).namelist())
    held = {name for name in names if name.startswith("wafer_viewer/") and not name.startswith(COMPILED)}
    assert files <= held
    assert {name for name in held - files if not (ROOT / name).exists()} == set()
    rest = {name for name in names - held if not name.startswith(COMPILED)}
    assert {name.split("/")[0] for name in rest} == {f"{wheel.name.split('-py3')[0]}.dist-info"}
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


def test_the_first_surface_after_an_installation_waits_for_no_compiler(installed: Path, tmp_path: Path) -> None:
    images, cache = sharpest_in_the_middle(tmp_path / "stack.tif"), tmp_path / "cache"
    words = ("reconstruct", images, "--z-step-um", 4, "--pixel-um", 1, "-o", tmp_path / "surface.npz")
    done = run(installed / "wafer-viewer", *words, cwd=tmp_path, WAFER_VIEWER_CACHE=str(cache))
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "surface.npz").exists()
    assert [kernel.name for kernel in cache.rglob("*.nbi")] == []


def test_what_the_kernels_are_built_with_is_what_the_program_runs_with() -> None:
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())
    hook = settings["tool"]["hatch"]["build"]["targets"]["wheel"]["hooks"]["custom"]
    assert set(hook["dependencies"]) <= set(settings["project"]["dependencies"])


def test_the_kernels_compile_where_only_what_the_hook_asks_for_is_installed(wheel: Path, bare: Path) -> None:
    """The hook leaves all kernels out of the wheel when a single one did not compile."""
    compiled = [name for name in zipfile.ZipFile(wheel).namelist() if name.startswith(COMPILED)]
    assert compiled, run(sys.executable, "-c", COMPILE, cwd=ROOT, PYTHONPATH=str(bare)).stderr
    started = (bare / "started").read_text().splitlines()
    assert sum(COMPILE in line for line in started) == 1
    assert sum("spawn_main" in line for line in started) >= len(PARTS)
    other = run(sys.executable, "-c", "import pytest", cwd=ROOT, PYTHONPATH=str(bare))
    assert "ModuleNotFoundError: import of pytest halted" in other.stderr


def others_than_asked_for() -> set[str]:
    """Modules of this environment that pip, and what it runs, does not find where it builds the wheel."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())
    hook = settings["tool"]["hatch"]["build"]["targets"]["wheel"]["hooks"]["custom"]
    asked_for = *settings["build-system"]["requires"], *hook["dependencies"], "pip"
    here = {name_of(distribution.name) for distribution in metadata.distributions()}
    wanted, held = [name_of(text) for text in asked_for], set[str]()
    while wanted:
        if (name := wanted.pop()) not in held and name in here:
            held.add(name)
            wanted += [name_of(text) for text in metadata.requires(name) or () if "extra ==" not in text]
    there = metadata.packages_distributions()
    installed = {module for module, names in there.items() if held & set(map(name_of, names))}
    return set(there) - installed - {"wafer_viewer"}


def name_of(requirement: str) -> str:
    """The normalised name of a distribution that is required."""
    return re.sub(r"[-_.]+", "-", re.split(r"[^\w.-]", requirement, maxsplit=1)[0]).lower()


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
