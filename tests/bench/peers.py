"""Other people's programs and libraries on the same stacks: what they make of them, and in what time.

All of them are optional: `missing` says what to install. OpenCV and scikit-image are used plainly, as a page of code
would; enfuse, focus-stack and shinestacker are programs for all-in-focus pictures, and the depth is the frame that
they take each pixel from.
"""

from __future__ import annotations

import contextlib
import importlib.util
import logging
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.ndimage import uniform_filter

from wafer_viewer.model.acquisition.focus_stack import FieldStack

WINDOW = 9
INSTALL_OPENCV = "pip install opencv-python-headless"
INSTALL_SHINESTACKER = "pip install shinestacker for a Python from 3.12 on, named by WAFER_VIEWER_SHINESTACKER_PYTHON"
SHINESTACKER_PYTHON = os.environ.get("WAFER_VIEWER_SHINESTACKER_PYTHON", sys.executable)
Sharpness = Callable[[NDArray], NDArray]


@dataclass(frozen=True, eq=False)
class PeerResult:
    """The frame that each pixel is sharpest in, the picture in which all is in focus, and the seconds it took."""

    frame: NDArray[np.intp] | None
    all_in_focus: NDArray
    seconds: float


@dataclass(frozen=True)
class Peer:
    """How to run it, whether it is there, and the line that installs it."""

    run: Callable[[FieldStack], PeerResult]
    is_there: Callable[[], bool]
    install: str

    @property
    def missing(self) -> str | None:
        """The line that installs it; None when it is there."""
        return None if self.is_there() else f"not installed: {self.install}"


def importable(module: str) -> Callable[[], bool]:
    return lambda: importlib.util.find_spec(module) is not None


def shinestacker_is_there() -> bool:
    look = [SHINESTACKER_PYTHON, "-c", "import shinestacker"]
    return subprocess.run(look, capture_output=True, check=False).returncode == 0


def opencv_sharpness(measure: str) -> Sharpness:
    """Eq. 2, 3 or 4 by the calls that OpenCV has for it, on one thread."""
    import cv2

    cv2.setNumThreads(1)
    size = (WINDOW, WINDOW)
    along, down = np.float32([[1, -2, 1]]), np.float32([[1], [-2], [1]])

    def sml(image: NDArray) -> NDArray:
        xx, yy = (cv2.filter2D(image, cv2.CV_32F, kernel) for kernel in (along, down))
        return cv2.boxFilter(cv2.add(cv2.multiply(xx, xx), cv2.multiply(yy, yy)), cv2.CV_32F, size)

    def tenengrad(image: NDArray) -> NDArray:
        x, y = cv2.Sobel(image, cv2.CV_32F, 1, 0), cv2.Sobel(image, cv2.CV_32F, 0, 1)
        return cv2.boxFilter(cv2.add(cv2.multiply(x, x), cv2.multiply(y, y)), cv2.CV_32F, size)

    def glv(image: NDArray) -> NDArray:
        mean = cv2.boxFilter(image, cv2.CV_32F, size)
        return cv2.subtract(cv2.sqrBoxFilter(image, cv2.CV_32F, size), cv2.multiply(mean, mean))

    return {"sml": sml, "tenengrad": tenengrad, "glv": glv}[measure]


def skimage_sharpness(measure: str) -> Sharpness:
    """The same with scikit-image; means of a window are SciPy's, on which it stands."""
    from skimage.filters import laplace, sobel_h, sobel_v

    def sml(image: NDArray) -> NDArray:
        return uniform_filter(laplace(image.astype(np.float32), 3) ** 2, WINDOW)

    def tenengrad(image: NDArray) -> NDArray:
        grey = image.astype(np.float32)
        return uniform_filter(sobel_h(grey) ** 2 + sobel_v(grey) ** 2, WINDOW)

    def glv(image: NDArray) -> NDArray:
        grey = image.astype(np.float32)
        return uniform_filter(grey**2, WINDOW) - uniform_filter(grey, WINDOW) ** 2

    return {"sml": sml, "tenengrad": tenengrad, "glv": glv}[measure]


def argmax_of(stack: FieldStack, sharpness: Sharpness) -> PeerResult:
    """The sharpest frame of each pixel, a frame at a time as a plain program would."""
    began = time.perf_counter()
    shape = stack.images.shape[1:]
    best, frame, picture = np.full(shape, -np.inf, np.float32), np.zeros(shape, np.intp), np.zeros(shape, np.uint8)
    for k, image in enumerate(stack.images):
        sharp = sharpness(image)
        better = sharp > best
        np.copyto(best, sharp, where=better)
        np.copyto(frame, k, where=better)
        np.copyto(picture, image, where=better)
    return PeerResult(frame, picture, time.perf_counter() - began)


def enfuse(stack: FieldStack) -> PeerResult:
    """Enfuse as its manual has it for focus stacks; its hard masks say which frame a pixel is from."""
    with _as_files(stack) as files:
        folder = files[0].parent
        weights = ["--exposure-weight=0", "--saturation-weight=0", "--contrast-weight=1", "--hard-mask"]
        windows = ["--contrast-window-size=9", "--gray-projector=l-star"]
        masks = f"--save-masks={folder}/soft-%n.tif:{folder}/hard-%n.tif"
        began = time.perf_counter()
        command = ["enfuse", *weights, *windows, masks, f"--output={folder}/all.tif", *map(str, files)]
        subprocess.run(command, check=True, capture_output=True, cwd=folder)
        seconds = time.perf_counter() - began
        hard = [_grey(file) for file in sorted(folder.glob("hard-*.tif"), key=_number)]
        return PeerResult(np.argmax(hard, axis=0), _grey(folder / "all.tif"), seconds)


def focus_stack(stack: FieldStack) -> PeerResult:
    """The package focus-stack of PyPI, from the frames on: aligning them would only spoil a stack that needs none."""
    from focus_stack import FocusStacker

    logging.getLogger("focus_stack.focus_stack").setLevel(logging.WARNING)
    images = [np.repeat(image[..., None], 3, axis=2) for image in stack.images]
    began = time.perf_counter()
    stacker = FocusStacker()
    laplacians = stacker._compute_laplacian(images)
    picture = stacker._find_focus_regions(images, laplacians)
    seconds = time.perf_counter() - began
    return PeerResult(np.abs(laplacians).argmax(axis=0), picture[..., 0], seconds)


def shinestacker(stack: FieldStack, method: str = "depth map") -> PeerResult:
    """A method of shinestacker with its own settings, in a Python of its own; its pyramid tells no frames."""
    with _as_files(stack) as files:
        folder = files[0].parent
        command = [SHINESTACKER_PYTHON, str(Path(__file__).with_name("peer_shinestacker.py")), str(folder)]
        subprocess.run([*command, str(folder / "result.npz"), method], check=True, capture_output=True)
        found = np.load(folder / "result.npz")
        frame = found["frame"] if method == "depth map" else None
        return PeerResult(frame, found["all_in_focus"], float(found["seconds"]))


def focusweave(stack: FieldStack) -> PeerResult:
    """FocusWeave, fusion of Laplacian pyramids, without aligning the frames; it tells no frames."""
    from focusweave import FocusStackConfig, run

    images = [np.repeat(image[..., None], 3, axis=2) for image in stack.images]
    began = time.perf_counter()
    picture = run(FocusStackConfig(images=images, no_align=True, workers=1)).image
    return PeerResult(None, picture[..., 0], time.perf_counter() - began)


PEERS: dict[str, Peer] = {
    "OpenCV plain, SML": Peer(lambda s: argmax_of(s, opencv_sharpness("sml")), importable("cv2"), INSTALL_OPENCV),
    "OpenCV plain, Tenengrad": Peer(
        lambda s: argmax_of(s, opencv_sharpness("tenengrad")), importable("cv2"), INSTALL_OPENCV
    ),
    "scikit-image plain, Tenengrad": Peer(
        lambda s: argmax_of(s, skimage_sharpness("tenengrad")), importable("skimage"), "pip install scikit-image"
    ),
    "enfuse, hard mask": Peer(enfuse, lambda: shutil.which("enfuse") is not None, "apt-get install enfuse"),
    "focus-stack (PyPI)": Peer(
        focus_stack, lambda: importable("cv2")() and importable("focus_stack")(), "pip install focus-stack"
    ),
    "shinestacker, depth map": Peer(shinestacker, shinestacker_is_there, INSTALL_SHINESTACKER),
}
"""Those that tell which frame each pixel is from."""

PICTURE_PEERS: dict[str, Peer] = {
    **{name: PEERS[name] for name in ("enfuse, hard mask", "focus-stack (PyPI)", "shinestacker, depth map")},
    "shinestacker, pyramid": Peer(lambda s: shinestacker(s, "pyramid"), shinestacker_is_there, INSTALL_SHINESTACKER),
    "FocusWeave, pyramid": Peer(focusweave, importable("focusweave"), "pip install focusweave"),
}
"""Those that make a picture in which all is in focus."""


@contextlib.contextmanager
def _as_files(stack: FieldStack) -> Iterator[list[Path]]:
    with tempfile.TemporaryDirectory() as folder:
        files = [Path(folder) / f"frame{k:04d}.tif" for k in range(stack.n_frames)]
        for file, image in zip(files, stack.images, strict=True):
            Image.fromarray(image).convert("RGB").save(file)
        yield files


def _grey(file: Path) -> NDArray:
    image = np.asarray(Image.open(file))
    return image if image.ndim == 2 else image[..., 0]


def _number(file: Path) -> int:
    return int(file.stem.split("-")[-1])
