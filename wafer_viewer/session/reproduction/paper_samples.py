"""Samples and methods of the paper's jobs: fields, sweeps, recipes, and the places that are measured."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from wafer_viewer.model.acquisition.plan import FieldGrid, FocusSweep
from wafer_viewer.model.acquisition.rig_limits import RigLimits
from wafer_viewer.model.acquisition.sample import Sample
from wafer_viewer.model.job import Job
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.recipe import Fill, Levy, Outliers, Recipe
from wafer_viewer.rigs.rig_config import RigConfig
from wafer_viewer.rigs.virtual.faults import CalibrationErrors
from wafer_viewer.rigs.virtual.rig import PIXEL_UM, SIZES, Size, virtual_limits
from wafer_viewer.rigs.virtual.scenes import tour_wafer, wafer
from wafer_viewer.rigs.virtual.scenes.catalogue import Scene, scene
from wafer_viewer.session.reproduction.published import FILTERED, MEASURES

Z_STEP_UM = 4.0
SEED = 1000
"""Seed of the camera noise and the stage errors, so that a run can be repeated."""
SHADING = CalibrationErrors(shading_fraction=0.06, black_counts=4)
DEFAULT = "default"


def _methods() -> dict[str, Recipe]:
    """Return the recipe of every method: the paper's with each measure, without and with its filter, and ours."""
    plain: dict[str, object] = {"levy": Levy(mode="none"), "outliers": Outliers(mode="none"), "fill": Fill(mode="none")}
    recipes: dict[str, Recipe] = {}
    for name, measure in MEASURES.items():
        filtered = replace(Recipe.paper(), focus_measure=measure)
        recipes |= {name: replace(filtered, **plain), f"{name}{FILTERED}": filtered}
    return recipes | {DEFAULT: Recipe()}


METHODS = _methods()


@dataclass(frozen=True)
class PaperSample:
    """Sample of the paper as a scene of the virtual rig, with its fields and its sweep.

    width_um, height_um: covered by the fields, about (0, 0); face_px: side of the areas on both gauge blocks;
    drop_um: centre of the gel drop.
    """

    name: str
    scene_name: str
    size: Size
    rows: int
    cols: int
    width_um: float
    height_um: float
    z_start_um: float
    n_frames: int
    face_px: int = 0
    drop_um: tuple[float, float] | None = None

    @cached_property
    def scene(self) -> Scene:
        """Scene of the virtual rig, which knows the true heights."""
        return scene(self.scene_name)

    @property
    def rig(self) -> RigConfig:
        """Rig with stage errors, camera noise, shading and a dark level."""
        return RigConfig(
            name="Virtual rig, the paper's jobs",
            scene=self.scene_name,
            size=self.size,
            seed=SEED,
            calibration_errors=SHADING,
        )

    @property
    def job(self) -> Job:
        """The job: the fields at equal distances, and a sweep in steps of 4 um."""
        return Job(
            product=self.scene.title,
            sample=Sample(name=self.name.replace("_", " ")),
            grid=self._grid(virtual_limits(*SIZES[self.size])),
            z_start_um=self.z_start_um,
            sweep=FocusSweep(z_step_um=Z_STEP_UM, n_frames=self.n_frames),
        )

    def _grid(self, limits: RigLimits) -> FieldGrid:
        across, along = limits.field_width_um, limits.field_height_um
        return FieldGrid(
            rows=self.rows,
            cols=self.cols,
            field_width_um=across,
            field_height_um=along,
            overlap_x_fraction=_overlap(self.width_um, across, self.cols),
            overlap_y_fraction=_overlap(self.height_um, along, self.rows),
        ).centred_on(0.0, 0.0)

    @property
    def faces(self) -> tuple[Region, Region]:
        """Areas on the upper and the lower gauge block, clear of the shadow of the step."""
        side_um = self.face_px * PIXEL_UM
        low, high = SHADOW_UM, SHADOW_UM + side_um
        upper = Region.rectangle(-high, -side_um / 2, -low, side_um / 2)
        return upper, Region.rectangle(low, -side_um / 2, high, side_um / 2)

    @property
    def frame_mpx(self) -> float:
        """Millions of pixels of all frames."""
        rows, cols = SIZES[self.size]
        return self.rows * self.cols * self.n_frames * rows * cols / 1e6

    @property
    def field_mpx(self) -> float:
        """Millions of pixels of all fields."""
        return self.frame_mpx / self.n_frames

    @property
    def mosaic_mpx(self) -> float:
        """Millions of pixels of the stitched surface."""
        return self.width_um * self.height_um / PIXEL_UM**2 / 1e6


SHADOW_UM = 120.0
"""Distance from the joint within which the step hides part of the light from the lower face."""


def _overlap(whole_um: float, field_um: float, n: int) -> float:
    """Return the overlap, as a fraction, of n fields that together cover a length."""
    return 0.1 if n == 1 else 1 - (whole_um - field_um) / (n - 1) / field_um


_DROP_UM = (
    wafer.GEL_COLUMN * wafer.PITCH_X_UM + wafer.TRENCH_UM / 2 + wafer.GEL_U_UM,
    wafer.GEL_ROW * wafer.PITCH_Y_UM + wafer.TRENCH_UM / 2 + wafer.GEL_V_UM,
)
FULL = (
    PaperSample("stair", "stair", "full", 1, 1, 672.9, 504.7, -90.0, 41),
    PaperSample("gauge_blocks", "gauge_blocks", "full", 9, 7, 3000.0, 3200.0, -50.0, 126, face_px=800),
    PaperSample("wafer", "wafer", "full", 16, 13, 6000.0, 6000.0, -180.0, 101, drop_um=_DROP_UM),
)
"""The samples as the paper has them."""
REDUCED = (
    PaperSample("stair", "stair", "small", 1, 1, 336.4, 252.3, -90.0, 41),
    PaperSample("gauge_blocks", "gauge_blocks", "small", 2, 3, 800.0, 440.0, -50.0, 126, face_px=400),
    PaperSample(
        "wafer",
        "tour_wafer",
        "small",
        3,
        3,
        930.0,
        700.0,
        -110.0,
        61,
        drop_um=(tour_wafer.DROP_X_UM, tour_wafer.DROP_Y_UM),
    ),
)
"""A few fields of a quarter of the pixels, of a smaller wafer."""
