"""Dies beside trenches: the layouts that may be looked at while methods are tuned, and those that are kept out of it.

Fixed before any method was tuned on them. A, B, C, D are four optical settings; R is A with the dies' rims rolled off.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tests.truth.scene import TruthScene
from tests.truth.scenes import SCENES, SWEEP_UM
from tests.truth.views import Camera, Optics, light_of, sharp_of, stack_from, white_light_of
from wafer_viewer.model.acquisition.focus_stack import FieldStack

GENERATOR = 3
"""Counts the changes of the generator that change pixels: kept light of another generator is not used."""


@dataclass(frozen=True)
class Layout:
    """A scene by name, its seed and settings, and how it is seen."""

    name: str
    optics: Optics
    seed: int
    camera: Camera = Camera()
    scene: str = "dies"
    settings: dict[str, float] = field(default_factory=dict)
    about: str = ""


@dataclass(frozen=True, eq=False)
class Taken:
    """A layout with its truth, its focus stack, and the picture in which all is in focus, in grey of the stack."""

    layout: Layout
    scene: TruthScene
    stack: FieldStack
    sharp_grey: NDArray[np.float32]


FINE = Optics(0.28, views=500)
"""Bright thin lines show the single views for longer."""
PILLBOX, APODISED, WIDE = Optics(0.28), Optics(0.28, apodised=True), Optics(0.40)
BRIGHT = Camera(clipped_share=0.11)
A = Layout("A", PILLBOX, 11, about="pillbox pupil NA 0.28, specular trench")
B = Layout("B", APODISED, 12, about="apodised pupil")
C = Layout(
    "C",
    PILLBOX,
    13,
    BRIGHT,
    settings={"glossy": 0, "trench_grey": 0.6, "trench_contrast": 0.35},
    about="diffuse, 11 % clipped",
)
D = Layout("D", WIDE, 14, about="pillbox pupil NA 0.40, specular trench")
R = Layout("R", PILLBOX, 15, settings={"roll_um": 7.0}, about="as A, rims rolled off 7 um over 14 px")

TUNING: dict[str, Layout] = {layout.name: layout for layout in (A, B, C, D, R)}


def _other(base: Layout, name: str, seed: int, about: str, **settings: float) -> Layout:
    return replace(base, name=name, seed=seed, about=about, settings={**base.settings, **settings})


HELD_OUT: dict[str, Layout] = {
    layout.name: layout
    for layout in (
        _other(A, "A-other", 9101, "A, other dies"),
        _other(A, "A-turned17", 9102, "A, turned by 17 degrees", angle_deg=17.0),
        _other(B, "B-corners", 9103, "B, turned by 30 degrees, rounded corners", angle_deg=30.0, corner_fraction=0.5),
        _other(C, "C-turned17", 9104, "C, turned by 17 degrees", angle_deg=17.0),
        _other(D, "D-turned30", 9105, "D, turned by 30 degrees", angle_deg=30.0),
        _other(R, "R-turned17", 9106, "R, turned by 17 degrees", angle_deg=17.0),
        _other(A, "A-round", 9107, "A, round dies", corner_fraction=1.0),
        _other(D, "D-round", 9108, "D, round dies", corner_fraction=1.0),
        _other(B, "B-small", 9109, "B, small dies, narrow trenches", pitch_px=170.0, trench_px=44.0),
        _other(C, "C-large", 9110, "C, large dies, wide trenches", pitch_px=420.0, trench_px=110.0),
        _other(A, "A-reversed", 9111, "A, dies six times as bright as the trench", die_grey=0.6, trench_grey=0.1),
        _other(A, "A-equal", 9112, "A, both sides equally bright", die_grey=0.35, trench_grey=0.5),
        replace(R, name="rim", seed=9113, scene="rim", optics=FINE, settings={}, about="R, polished rims"),
        replace(A, name="A-4ke", seed=9114, camera=Camera(4_000.0), about="A, full well of 4000 electrons"),
        replace(A, name="A-60ke", seed=9115, camera=Camera(60_000.0), about="A, full well of 60000 electrons"),
    )
}


def scene_of(layout: Layout, shape: tuple[int, int] = (320, 320)) -> TruthScene:
    """The scene of a layout."""
    return SCENES[layout.scene](layout.seed, shape, **layout.settings)


def take(
    layout: Layout,
    shape: tuple[int, int] = (320, 320),
    z_um: NDArray[np.float64] = SWEEP_UM,
    keep_in: Path | None = None,
) -> Taken:
    """The truth and the stack of a layout. keep_in: a folder where the light is kept, so that the rays run once."""
    scene = scene_of(layout, shape)
    light = _kept_light(layout, scene, z_um, keep_in) if keep_in else light_of(scene, layout.optics, z_um)
    stack = stack_from(scene, light, z_um, layout.camera, layout.seed)
    white_light = white_light_of(scene, light, z_um, layout.camera.clipped_share)
    sharp_grey = np.minimum(sharp_of(scene, light, z_um) / white_light, 1) * layout.camera.white
    return Taken(layout, scene, stack, sharp_grey)


def _kept_light(layout: Layout, scene: TruthScene, z_um: NDArray[np.float64], folder: Path) -> NDArray[np.float32]:
    rows, cols = scene.shape
    sweep = f"{z_um[0]:g}-{z_um[-1]:g}-{len(z_um)}"
    file = folder / f"{GENERATOR}-{layout.name}-{layout.seed}-{rows}x{cols}-{sweep}.npy"
    if not file.exists():
        folder.mkdir(parents=True, exist_ok=True)
        half = file.with_suffix(f".{os.getpid()}.npy")
        np.save(half, light_of(scene, layout.optics, z_um))
        half.rename(file)
    return np.load(file)
