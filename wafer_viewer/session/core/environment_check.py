"""Environment check: what each part of the program finds or lacks on this machine, and how to fix it."""

from __future__ import annotations

import importlib
import os
import shutil
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from wafer_viewer.model.acquisition.plan import Axis
from wafer_viewer.model.acquisition.rig_limits import AxisLimits
from wafer_viewer.model.errors import WaferViewerError
from wafer_viewer.numerics.open3d_library import Open3DMissing, load_open3d
from wafer_viewer.rigs.composed.device_checks import check_devices, check_index_marks, check_stage, positioner_words
from wafer_viewer.rigs.rig_config import RigConfig, device_opener, open_rig

PACKAGES = ("numpy", "scipy", "numba", "distributed", "zarr", "tifffile", "viser", "serial")
ROOM_BYTES = 5e9


@dataclass(frozen=True, slots=True)
class EnvironmentCheck:
    """Result of one check; `mend` says what to do, empty if nothing is wrong."""

    what: str
    found: str
    mend: str = ""

    @property
    def well(self) -> bool:
        """True if there is nothing to do."""
        return not self.mend


def check_environment(
    config: RigConfig, data_folder: Path, compile_kernels: Callable[[], None], *, move: bool = False
) -> Iterator[EnvironmentCheck]:
    """Run all checks, one after the other. The stage moves with `move` only.

    compile_kernels: makes a surface with every kernel; what it compiles is kept, so that no later surface waits for it.
    """
    yield EnvironmentCheck("Python", sys.version.split()[0])
    yield from (_package(name) for name in PACKAGES)
    yield check_open3d()
    yield _processors()
    yield _disk(data_folder)
    yield (cache := _cache())
    if cache.well:
        yield _kernels(compile_kernels)
    yield from _rig(config, move)


def _package(name: str) -> EnvironmentCheck:
    try:
        module = importlib.import_module(name)
    except ImportError as fault:
        return EnvironmentCheck(name, f"cannot be imported: {fault}", "pip install --force-reinstall wafer-viewer")
    return EnvironmentCheck(name, str(getattr(module, "__version__", "there")))


def check_open3d() -> EnvironmentCheck:
    """Check that Open3D can be loaded, which searches faces and refines comparisons."""
    try:
        return EnvironmentCheck("open3d", load_open3d().__version__)
    except Open3DMissing as fault:
        return EnvironmentCheck("open3d", f"cannot be loaded: {fault.reason}", fault.mend)


def _processors() -> EnvironmentCheck:
    return EnvironmentCheck("Processors", f"{os.cpu_count()}")


def _disk(folder: Path) -> EnvironmentCheck:
    place = next(p for p in (folder.absolute(), *folder.absolute().parents) if p.exists())
    free = shutil.disk_usage(place).free
    found = f"{free / 1e9:.0f} GB free at {place}"
    if not os.access(place, os.W_OK):
        return EnvironmentCheck("Data folder", f"{place} cannot be written", "choose another with --data DIR")
    return EnvironmentCheck(
        "Data folder", found, "" if free > ROOM_BYTES else "free some space, or choose another with --data DIR"
    )


def _cache() -> EnvironmentCheck:
    from wafer_viewer.numerics.kernel_cache import cache_folder

    folder = cache_folder()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        (probe := folder / ".probe").touch()
        probe.unlink()
    except OSError as fault:
        return EnvironmentCheck(
            "Kernel cache", f"{folder}: {fault.strerror}", "set WAFER_VIEWER_CACHE to a folder of yours"
        )
    return EnvironmentCheck("Kernel cache", str(folder))


def _kernels(compile_kernels: Callable[[], None]) -> EnvironmentCheck:
    began = time.perf_counter()
    compile_kernels()
    return EnvironmentCheck("Kernels", f"compiled for this processor, ready in {time.perf_counter() - began:.1f} s")


def _rig(config: RigConfig, move: bool) -> Iterator[EnvironmentCheck]:
    """Check a composed rig device by device, any other one as a whole."""
    if (opener := device_opener(config)) is not None:
        yield from (EnvironmentCheck(*check) for check in check_devices(opener, move=move))
        return
    try:
        rig = open_rig(config)
    except WaferViewerError as fault:
        yield EnvironmentCheck(f"Rig '{config.name}'", str(fault), "check its cables and its RIG.toml")
        return
    try:
        yield EnvironmentCheck(f"Rig '{config.name}'", "SIMULATED, answers" if rig.simulated else "answers")
        axes: dict[Axis, AxisLimits] = {"x": rig.limits.x, "y": rig.limits.y, "z": rig.limits.z}
        yield from (EnvironmentCheck(*check) for check in check_stage(rig.stage, rig.box, axes, move=move))
        marks = check_index_marks(rig.stage, rig.box, axes, rig.limits.objective.safe_z_um, move=move)
        yield from (EnvironmentCheck(*check) for check in marks)
        for name, positioner in rig.positioners.items():
            yield EnvironmentCheck(f"Positioner '{name}'", f"SIMULATED, {positioner_words(name, positioner)}")
    finally:
        rig.close()
