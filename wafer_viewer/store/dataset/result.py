"""Reconstruction of a dataset: the folder ``results/NAME`` with its recipe, surfaces, mosaic and findings."""

from __future__ import annotations

import re
from collections.abc import Generator, Iterable
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from wafer_viewer.model.acquisition.plan import Field
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.findings import MeasurementResults
from wafer_viewer.model.spec import Spec
from wafer_viewer.model.surface.comparison import Comparison
from wafer_viewer.model.surface.field_poses import Poses
from wafer_viewer.model.surface.height_map import HeightMap, Mosaic
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.store.formats.npz_file import read_npz, write_npz
from wafer_viewer.store.io.atomic_files import atomic_write, make_folder, os_errors_as_dataset_errors, to_disk
from wafer_viewer.store.io.checksums import SURFACES, load_json, require_good_json, save_json, stored_checksum
from wafer_viewer.store.io.format_version import raise_schema
from wafer_viewer.store.mosaic.missing_shards import require_complete_once
from wafer_viewer.store.mosaic.poses_file import POSES, read_poses, write_poses
from wafer_viewer.store.mosaic.zarr_mosaic import ZarrMosaic
from wafer_viewer.store.records.manifest import load_record, save_record

RECIPE, SETTLED, FINDINGS, COMPARISON = "recipe.json", "settled.json", "findings.json", "comparison.json"
THUMBNAILS, MOSAIC, DRAWING = "thumbnails", "mosaic.zarr", "poses-being-drawn.npz"


@dataclass(frozen=True, slots=True)
class Result:
    """Folder of a reconstruction; holds no open files, so it can be passed between workers."""

    path: Path

    @classmethod
    def of(cls, folder: Path, name: str) -> Result:
        """Return the named result in the results folder. Raises DatasetError for an invalid folder name."""
        if not re.fullmatch(r"[\w][\w .+-]*", name):
            raise DatasetError(f"A result cannot be called {name!r}: use letters, digits, spaces and . + - _ only.")
        return cls(folder / name)

    @property
    def name(self) -> str:
        """Name of the result."""
        return self.path.name

    @property
    def exists(self) -> bool:
        """True if anything was saved to the result."""
        return self.path.is_dir()

    def recipe(self) -> Recipe:
        """Return the recipe of the result. Raises DatasetError when none was saved."""
        return load_json(self.path / RECIPE, Recipe)

    def save_recipe(self, recipe: Recipe) -> None:
        """Save the recipe, and delete the settled recipe if the new recipe yields other heights."""
        if (self.path / RECIPE).exists() and not self.matches_recipe(recipe):
            (self.path / SETTLED).unlink(missing_ok=True)
        self._save(RECIPE, recipe)

    def matches_recipe(self, recipe: Recipe) -> bool:
        """Return whether the surfaces match a recipe; False if the result's own recipe files are damaged."""
        try:
            self.settled()
            return recipe.makes_heights_of(self.recipe())
        except DatasetError:
            return False

    def settled(self) -> Recipe | None:
        """Return the recipe with the values that ``auto`` chose for the scan, or None if not chosen yet."""
        return load_json(self.path / SETTLED, Recipe) if (self.path / SETTLED).exists() else None

    def save_settled(self, recipe: Recipe) -> None:
        """Save the recipe to be used for all remaining fields."""
        self._save(SETTLED, recipe)

    def surface(self, field: Field, *, verify: bool = True) -> HeightMap:
        """Return the surface of a field, memory-mapped; `verify`: test its checksum, which reads the file once.

        Raises DatasetError when the surface is not reconstructed yet or is damaged.
        """
        path = self._surface_file(field)
        if not path.exists():
            raise DatasetError(f"Result {self.name!r} has no surface of field {field.number}: reconstruct it first.")
        return read_npz(path, verify=verify)

    def save_surface(self, field: Field, surface: HeightMap) -> None:
        """Save the surface of a field, replacing an earlier one."""
        path = self._surface_file(field)
        make_folder(path.parent)
        with atomic_write(path) as temporary:
            write_npz(surface, temporary)

    def surfaces_done(self, fields: Iterable[Field]) -> set[int]:
        """Return the numbers of those fields that have a surface; the folder is listed once."""
        folder = self.path / SURFACES
        names = {path.stem for path in folder.glob("*.npz")}
        return {f.number for f in fields if f.name in names} if names else set()

    @property
    def is_difference(self) -> bool:
        """True if the result compares two surfaces and its mosaic is their difference."""
        return (self.path / COMPARISON).exists()

    def comparison(self) -> Comparison:
        """Return the comparison and its outcome. Raises DatasetError when the result is no comparison."""
        return load_record(self.path / COMPARISON, Comparison)

    @property
    def mosaic_path(self) -> Path:
        """Path of the stitched surface, written by `write_mosaic`."""
        return self.path / MOSAIC

    @property
    def has_mosaic(self) -> bool:
        """True if the fields were stitched."""
        return self.mosaic_path.is_dir()

    def mosaic(self) -> Mosaic:
        """Return the stitched surface. Raises DatasetError when it does not exist yet, or files of it are missing."""
        if not self.has_mosaic:
            raise DatasetError(f"Result {self.name!r} has no stitched surface: stitch its fields first.")
        mosaic = ZarrMosaic.open(self.mosaic_path)
        if not self.broken_off:
            require_complete_once(mosaic)
        return mosaic

    def poses(self) -> Poses | None:
        """Return the field poses of the stitched surface; None if it uses stage positions or does not exist."""
        return read_poses(self.path / POSES) if (self.path / POSES).exists() else None

    def begin_mosaic_update(self, poses: Poses) -> Path:
        """Save the poses of a mosaic update; until `commit_mosaic_update` only some fields may be drawn at them."""
        make_folder(self.path)
        write_poses(poses, self.path / DRAWING)
        return self.path / DRAWING

    def commit_mosaic_update(self) -> None:
        """Commit the poses of the finished mosaic update."""
        with os_errors_as_dataset_errors(self.path / POSES):
            (self.path / DRAWING).replace(self.path / POSES)
            to_disk(self.path)

    def shows_all(self, fields: Iterable[Field]) -> bool:
        """Return whether the mosaic contains every surface, all of them placed in one solution."""
        poses = self.poses() if self.has_mosaic and not self.broken_off else None
        return poses is not None and poses.final and set(poses.numbers.tolist()) == self.surfaces_done(fields)

    @property
    def broken_off(self) -> bool:
        """True if a mosaic update did not finish; the mosaic must then be rewritten completely."""
        return (self.path / DRAWING).exists()

    def field_stamp(self, field: Field) -> int:
        """Return the time in ns at which the surface of a field was written. Raises DatasetError if it is missing."""
        with self._surface_of(field) as path:
            return path.stat().st_mtime_ns

    def field_mark(self, field: Field) -> int:
        """Return a number that identifies the content of the surface of a field, as `Poses.marks` have it.

        It is the checksum in the file. Raises DatasetError if the surface is missing or has none.
        """
        with self._surface_of(field) as path:
            return stored_checksum(path)

    @contextmanager
    def _surface_of(self, field: Field) -> Generator[Path]:
        """Provide the path of a surface. Raises DatasetError when its file cannot be read."""
        try:
            yield self._surface_file(field)
        except OSError as fault:
            raise DatasetError(f"The surface of field {field.number} is gone: reconstruct it again.") from fault

    def findings(self) -> MeasurementResults:
        """Return the measurement results; empty if none were saved."""
        if not (self.path / FINDINGS).exists():
            return MeasurementResults()
        return load_record(self.path / FINDINGS, MeasurementResults)

    def save_findings(self, findings: MeasurementResults) -> None:
        """Save measurement results, replacing the earlier ones. Raises DatasetError when those are damaged."""
        require_good_json(self.path / FINDINGS)
        make_folder(self.path)
        save_record(self.path / FINDINGS, findings)

    def thumbnail(self, number: int) -> bytes | None:
        """Return the thumbnail of a measurement result as JPEG; None if there is none."""
        path = self._thumbnail_file(number)
        return path.read_bytes() if path.exists() else None

    def save_thumbnail(self, number: int, jpeg: bytes) -> None:
        """Save the thumbnail of a measurement result."""
        path = self._thumbnail_file(number)
        make_folder(path.parent)
        with atomic_write(path) as temporary:
            temporary.write_bytes(jpeg)

    def highest_thumbnail(self) -> int:
        """Return the highest thumbnail number, 0 if there is none; numbers are never reused."""
        return max((int(path.stem) for path in (self.path / THUMBNAILS).glob("[0-9]*.jpg")), default=0)

    def _thumbnail_file(self, number: int) -> Path:
        return self.path / THUMBNAILS / f"{number}.jpg"

    def _surface_file(self, field: Field) -> Path:
        return self.path / SURFACES / f"{field.name}.npz"

    def _save(self, name: str, spec: Spec) -> None:
        make_folder(self.path)
        raise_schema(self.path.parents[1])
        save_json(self.path / name, spec)
