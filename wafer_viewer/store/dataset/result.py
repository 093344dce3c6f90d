"""One reconstruction of a dataset: the folder ``results/NAME`` with its recipe, surfaces, mosaic and findings."""

from __future__ import annotations

import re
from collections.abc import Iterable
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
from wafer_viewer.store.io.atomic_files import replacing, writing
from wafer_viewer.store.io.checksums import SURFACES, load_json, require_good_json, save_json
from wafer_viewer.store.mosaic.missing_shards import require_whole_once
from wafer_viewer.store.mosaic.poses_file import POSES, read_poses, write_poses
from wafer_viewer.store.mosaic.zarr_mosaic import ZarrMosaic

RECIPE, SETTLED, FINDINGS, COMPARISON = "recipe.json", "settled.json", "findings.json", "comparison.json"
THUMBNAILS, MOSAIC, DRAWING = "thumbnails", "mosaic.zarr", "poses-being-drawn.npz"


@dataclass(frozen=True, slots=True)
class Result:
    """Where a reconstruction lies; nothing is held open, so workers can pass it among themselves."""

    path: Path

    @classmethod
    def of(cls, folder: Path, name: str) -> Result:
        """The result with a name in the folder of results. Raises DatasetError when the name is not a folder's name."""
        if not re.fullmatch(r"[\w][\w .+-]*", name):
            raise DatasetError(f"A result cannot be called {name!r}: use letters, digits, spaces and . + - _ only.")
        return cls(folder / name)

    @property
    def name(self) -> str:
        """The name of the result."""
        return self.path.name

    @property
    def exists(self) -> bool:
        """Whether anything was saved to it."""
        return self.path.is_dir()

    def recipe(self) -> Recipe:
        """The recipe it was made with. Raises DatasetError when none was saved."""
        return load_json(self.path / RECIPE, Recipe)

    def save_recipe(self, recipe: Recipe) -> None:
        """Keep the recipe; what one that makes other heights was settled to is forgotten."""
        if (self.path / RECIPE).exists() and not self.has_heights_of(recipe):
            (self.path / SETTLED).unlink(missing_ok=True)
        self._save(RECIPE, recipe)

    def has_heights_of(self, recipe: Recipe) -> bool:
        """Whether its surfaces are what a recipe makes; damaged files of its own recipe count as another one."""
        try:
            self.settled()
            return recipe.makes_heights_of(self.recipe())
        except DatasetError:
            return False

    def settled(self) -> Recipe | None:
        """The recipe with what ``auto`` chose for the whole scan; None as long as no field spoke for it."""
        return load_json(self.path / SETTLED, Recipe) if (self.path / SETTLED).exists() else None

    def save_settled(self, recipe: Recipe) -> None:
        """Let all fields that follow be made with this recipe."""
        self._save(SETTLED, recipe)

    def surface(self, field: Field, *, verify: bool = True) -> HeightMap:
        """The surface of a field, memory-mapped; `verify`: test its checksum, for which all of it is read once.

        Raises DatasetError when it was not reconstructed yet or is damaged.
        """
        path = self._surface_file(field)
        if not path.exists():
            raise DatasetError(f"Result {self.name!r} has no surface of field {field.number}: reconstruct it first.")
        return read_npz(path, verify=verify)

    def save_surface(self, field: Field, surface: HeightMap) -> None:
        """Keep the surface of a field, in place of an earlier one."""
        path = self._surface_file(field)
        self._make_folder(path.parent)
        with replacing(path) as beside:
            write_npz(surface, beside)

    def surfaces_done(self, fields: Iterable[Field]) -> set[int]:
        """Numbers of those fields that have a surface."""
        return {f.number for f in fields if self._surface_file(f).exists()}

    @property
    def is_difference(self) -> bool:
        """Whether it is two surfaces compared, and its mosaic their difference."""
        return (self.path / COMPARISON).exists()

    def comparison(self) -> Comparison:
        """What was compared and how it came out. Raises DatasetError when it is no comparison."""
        return load_json(self.path / COMPARISON, Comparison)

    @property
    def mosaic_path(self) -> Path:
        """Where `write_mosaic` puts the stitched surface."""
        return self.path / MOSAIC

    @property
    def has_mosaic(self) -> bool:
        """Whether the fields were stitched."""
        return self.mosaic_path.is_dir()

    def mosaic(self) -> Mosaic:
        """The stitched surface. Raises DatasetError when the fields were not stitched yet, or files of it are gone."""
        if not self.has_mosaic:
            raise DatasetError(f"Result {self.name!r} has no stitched surface: stitch its fields first.")
        mosaic = ZarrMosaic.open(self.mosaic_path)
        if not self.broken_off:
            require_whole_once(mosaic)
        return mosaic

    def poses(self) -> Poses | None:
        """Where the fields of the stitched surface lie; None where they lie where the stage says, or none are."""
        return read_poses(self.path / POSES) if (self.path / POSES).exists() else None

    def begin_drawing(self, poses: Poses) -> Path:
        """Say where fields will lie; until `end_drawing` the mosaic may show some of them so and others not."""
        self._make_folder(self.path)
        write_poses(poses, self.path / DRAWING)
        return self.path / DRAWING

    def end_drawing(self) -> None:
        """The mosaic shows the fields where they were said to lie."""
        with writing(self.path / POSES):
            (self.path / DRAWING).replace(self.path / POSES)

    def shows_all(self, fields: Iterable[Field]) -> bool:
        """Whether the mosaic shows every surface that there is, all of them placed together."""
        poses = self.poses() if self.has_mosaic and not self.broken_off else None
        return poses is not None and poses.final and set(poses.numbers.tolist()) == self.surfaces_done(fields)

    @property
    def broken_off(self) -> bool:
        """Whether a drawing of the mosaic was begun and not ended: all of it is to be made anew."""
        return (self.path / DRAWING).exists()

    def field_stamp(self, field: Field) -> int:
        """A number that changes when the surface of a field is made again. Raises DatasetError when there is none."""
        try:
            return self._surface_file(field).stat().st_mtime_ns
        except OSError as fault:
            raise DatasetError(f"The surface of field {field.number} is gone: reconstruct it again.") from fault

    def findings(self) -> MeasurementResults:
        """What was measured; nothing at first."""
        if not (self.path / FINDINGS).exists():
            return MeasurementResults()
        return load_json(self.path / FINDINGS, MeasurementResults)

    def save_findings(self, findings: MeasurementResults) -> None:
        """Keep what was measured, in place of what was kept before. Raises DatasetError when that is damaged."""
        require_good_json(self.path / FINDINGS)
        self._save(FINDINGS, findings)

    def thumbnail(self, number: int) -> bytes | None:
        """The small picture, JPEG, that was kept with a finding; None without one."""
        path = self._thumbnail_file(number)
        return path.read_bytes() if path.exists() else None

    def save_thumbnail(self, number: int, jpeg: bytes) -> None:
        """Keep a small picture beside a finding."""
        path = self._thumbnail_file(number)
        self._make_folder(path.parent)
        with replacing(path) as beside:
            beside.write_bytes(jpeg)

    def highest_thumbnail(self) -> int:
        """The highest number that a small picture was kept for, 0 without any: numbers are not given twice."""
        return max((int(path.stem) for path in (self.path / THUMBNAILS).glob("[0-9]*.jpg")), default=0)

    def _thumbnail_file(self, number: int) -> Path:
        return self.path / THUMBNAILS / f"{number}.jpg"

    def _surface_file(self, field: Field) -> Path:
        return self.path / SURFACES / f"{field.name}.npz"

    def _save(self, name: str, spec: Spec) -> None:
        self._make_folder(self.path)
        save_json(self.path / name, spec)

    def _make_folder(self, folder: Path) -> None:
        with writing(folder):
            folder.mkdir(parents=True, exist_ok=True)
