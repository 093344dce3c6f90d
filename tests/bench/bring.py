"""Files as people bring them, drawn by seed: which are read rightly, asked about, refused, or silently wrong.

    python tests/bench/bring.py [--quick] [--cases N] [--from SEED] [--each]

A case is a stack of blurred frames of a made-up surface, a matrix of heights, or a surface file (of makers written by
surfalize), in a layout, with names, a format and metadata that are drawn. Right is: all frames and no others, in the
order of z, with the true step, pixel size and gaps; or the true heights. Asked is an error that names the flag which
settles it. Goal: none silently wrong.
"""

from __future__ import annotations

import tempfile
import warnings
from collections import Counter, defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from numpy.typing import NDArray
from PIL import Image
from scipy.ndimage import gaussian_filter

import wafer_viewer as wv
from tests.bench.harness import read_options
from tests.support.surfaces import height_map
from wafer_viewer.model.errors import DatasetError

ROWS, COLS = 96, 128
Frames = NDArray[np.uint8]


@dataclass
class Case:
    """A drawn case. src: what the user names; given: the numbers that the user types; want: images by slot, None for
    a lost one, as numbers of the true frames; is_open: something is asked; is_upright: row 0 is on top."""

    about: str
    src: Any
    given: dict[str, Any]
    frames: Frames
    want: list[int | None]
    step_um: float
    pixel_um: float
    is_open: bool = False
    heights_um: NDArray[np.float64] | None = None
    is_upright: bool = False
    tags: list[str] = field(default_factory=list)


# --- what is drawn


def drawn_frames(rng: np.random.Generator, n: int) -> Frames:
    """Frames of a ramp with a block, blurred by the distance from the focus."""
    texture = gaussian_filter(rng.normal(0, 1, (ROWS, COLS)), 0.7)
    texture = 110 + 45 * texture / texture.std()
    rows, cols = np.mgrid[:ROWS, :COLS]
    focus = 1.5 + (n - 4) * (cols / COLS if rng.random() < 0.5 else rows / ROWS)
    focus[20:50, 30:70] += min(2.0, n / 6)
    levels = np.stack([gaussian_filter(texture, 0.3 + 0.55 * d) for d in range(n + 1)])
    frames = [levels[np.abs(np.rint(focus - k)).astype(int), rows, cols] for k in range(n)]
    noise = rng.normal(0, 1.5, (n, ROWS, COLS))
    return np.clip(np.rint(np.stack(frames) + noise), 0, 255).astype(np.uint8)


NAMES: dict[str, Callable[[np.random.Generator, int, float], list[str]]] = {
    "padded": lambda rng, n, step: [f"img_{k:03d}" for k in range(n)],
    "unpadded": lambda rng, n, step: [f"frame{k + 1}" for k in range(n)],
    "hundreds": lambda rng, n, step: [f"s {97 + k}" for k in range(n)],
    "rollover": lambda rng, n, step: [f"IMG_{(9999 - n // 2 + k - 1) % 9999 + 1:04d}" for k in range(n)],
    "z signed": lambda rng, n, step: [f"z{(k - n // 2) * step:+.2f}um" for k in range(n)],
    "z minus": lambda rng, n, step: [f"pos_z{(k - n // 2) * step:.2f}" for k in range(n)],
    "z comma": lambda rng, n, step: [f"a z={k * step:.2f}um".replace(".", ",") for k in range(n)],
    "z in nm": lambda rng, n, step: [f"z{round(1000 * k * step)}nm" for k in range(n)],
    "dated": lambda rng, n, step: [f"2024-03-01_{k:02d}" for k in range(n)],
    "by tens": lambda rng, n, step: [f"pic{10 * k}" for k in range(n)],
    "copies": lambda rng, n, step: ["pic", *[f"pic ({k})" for k in range(1, n)]],
}
GIVES_STEP = ("z signed", "z comma", "z in nm")
FORMATS = (".png", ".tif", ".jpg", ".bmp", ".pgm", ".webp")


def save(path: Path, image: Frames) -> None:
    """Write an image in the format of its ending."""
    if path.suffix == ".tif":
        tifffile.imwrite(path, image, photometric="minisblack")
    else:
        words = {".jpg": {"quality": 97}, ".webp": {"lossless": True}}.get(path.suffix, {})
        Image.fromarray(image).save(path, **words)


def a_folder(rng: np.random.Generator, folder: Path, case: Case) -> None:
    """One file a frame, with names of a kind; some lost, doubled, or beside strangers; a list in three of ten."""
    n = len(case.frames)
    kind = str(rng.choice(list(NAMES)))
    ending = str(rng.choice(FORMATS))
    names = NAMES[kind](rng, n, case.step_um)
    case.about = f"folder, {kind}, {ending}"
    case.tags += [kind, ending]
    trouble = str(rng.choice(["none", "none", "none", "lost", "result", "twin", "second series", "thumbs"]))
    if kind in ("copies", "rollover") and trouble in ("twin", "second series", "lost"):
        trouble = "none"
    paths = []
    for k, name in enumerate(names):
        paths.append(folder / f"{name}{ending}")
        save(paths[-1], case.frames[k])
    if kind in GIVES_STEP and rng.random() < 0.5:
        case.given.pop("z_step_um")
    elif kind not in GIVES_STEP and rng.random() < 0.1:
        case.given.pop("z_step_um")
        case.is_open = True
    if trouble == "lost":
        at = int(rng.integers(2, n - 2))
        paths.pop(at).unlink()
        case.want[at] = None
        case.is_open |= kind == "by tens"
    elif trouble == "result":
        save(folder / str(rng.choice(["output.png", "fused.png", "result_edf.png"])), case.frames.max(0))
    elif trouble == "twin":
        at, other = int(rng.integers(n)), ".png" if ending != ".png" else ".tif"
        save(folder / f"{names[at]}{other}", case.frames[at])
        case.is_open = True
    elif trouble == "second series":
        for k in range(n):
            save(folder / f"other_{k:03d}{ending}", case.frames[n - 1 - k])
        case.is_open = True
    elif trouble == "thumbs":
        (folder / "Thumbs.db").write_bytes(b"x" * 40)
        (folder / "notes.txt").write_text("focus stack")
    case.about += f", {trouble}"
    case.tags.append(trouble)
    case.src = folder
    if trouble in ("none", "lost") and rng.random() < 0.3:
        case.src, case.about = paths, f"{case.about}, listed"
        case.tags.append("listed")


def a_tiff(rng: np.random.Generator, folder: Path, case: Case) -> None:
    """One file with all frames, as ImageJ, OME or nobody writes it; some with channels, times or positions."""
    kind = str(rng.choice(["bare", "imagej", "ome"]))
    axis = str(rng.choice(["none", "none", "C", "T"])) if kind != "bare" else "none"
    path = folder / ("a.ome.tif" if kind == "ome" else "a.tif")
    values: NDArray[Any] = case.frames if rng.random() < 0.5 else case.frames.astype(np.uint16) * 200
    case.frames = values
    words: dict[str, Any] = {}
    axes = "ZYX"
    if axis != "none":
        other = values[::-1] // 2
        stacked = np.stack([values, other], 1 if axis == "C" else 0)
        axes = "ZCYX" if axis == "C" else "TZYX"
        case.is_open = True
        if rng.random() < 0.6:
            case.given["channel" if axis == "C" else "time"] = "0"
            case.is_open = False
        values = stacked
    if kind == "imagej":
        words = {"axes": axes, "spacing": case.step_um, "unit": str(rng.choice(["um", "micron", r"\u00B5m"]))}
        pixels = 1 / case.pixel_um
        tifffile.imwrite(path, values, imagej=True, resolution=(pixels, pixels), metadata=words)
    elif kind == "ome":
        nm = rng.random() < 0.3
        scale, unit = (1000.0, "nm") if nm else (1.0, "µm")
        sizes = {"X": case.pixel_um, "Y": case.pixel_um, "Z": case.step_um}
        words = {"axes": axes}
        for name, um in sizes.items():
            words |= {f"PhysicalSize{name}": um * scale, f"PhysicalSize{name}Unit": unit}
        tifffile.imwrite(path, values, ome=True, photometric="minisblack", metadata=words)
    else:
        tifffile.imwrite(path, values, photometric="minisblack")
    case.about, case.src = f"{kind} TIFF, {axis}", path
    case.tags += [f"{kind} TIFF", f"axis {axis}"]
    if kind == "bare":
        return
    drawn = rng.random()
    if drawn < 0.5:
        case.given.pop("z_step_um")
        case.given.pop("pixel_um")
        case.tags.append("nothing given")
    elif drawn < 0.7:
        wrong = str(rng.choice(["z_step_um", "pixel_um"]))
        case.given[wrong] *= 1.25
        case.about += f", {wrong} contradicts"
        case.tags.append("contradicts")
        case.is_open = True


def a_matrix(rng: np.random.Generator, folder: Path, case: Case) -> None:
    """Heights as text: separators, decimal commas, words for gaps, headings."""
    rows, cols = (int(size) for size in rng.integers(4, 30, 2))
    heights = np.round(rng.normal(5, 2, (rows, cols)), 4)
    separator = str(rng.choice([",", ";", "\t", " "]))
    comma = separator != "," and rng.random() < 0.3
    gap = str(rng.choice(["", "NaN", "BAD", "***", "nan", "-"])) if rng.random() < 0.6 else None
    if gap == "" and separator == " ":
        gap = "NaN"
    lines = [[f"{value:.4f}".replace(".", "," if comma else ".") for value in row] for row in heights]
    if gap is not None:
        for _ in range(max(1, rows * cols // 20)):
            row, col = int(rng.integers(rows)), int(rng.integers(cols))
            lines[row][col], heights[row, col] = gap, np.nan
    path = folder / f"heights{rng.choice(['.csv', '.txt'])}"
    path.write_text("\n".join(separator.join(line) for line in lines) + "\n")
    case.src, case.heights_um, case.given = path, heights, {"z_unit": "um", "pixel_um": 0.5}
    case.is_open = cols <= 4
    case.about = f"matrix {rows} x {cols}, {separator!r}, {'comma' if comma else 'point'}, gap {gap!r}"
    case.tags += ["matrix", f"separator {separator!r}", "decimal comma" if comma else "decimal point", f"gap {gap!r}"]


def sdf_text(z_um: NDArray[np.float64], pixel_um: float) -> bytes:
    """An ISO 25178-71 file as text, with heights in pm."""
    words = np.where(np.isnan(z_um), "BAD", np.nan_to_num(np.round(z_um * 1e6)).astype(np.int64).astype(str))
    rows, cols = z_um.shape
    lengths = f"Xscale = {pixel_um}e-6", f"Yscale = {pixel_um}e-6", "Zscale = 1e-12", "Zresolution = -1"
    head = "aISO-1.0", "ManufacID = X", f"NumPoints = {cols}", f"NumProfiles = {rows}", *lengths
    return "\r\n".join((*head, "Compression = 0", "DataType = 7", "*", *map(" ".join, words), "*")).encode()


SURFACES = {
    **dict.fromkeys((".x3p", ".gsf", ".gwy", ".tif", ".ome.tif", ".npz", ".ply", ".xyz"), "ours"),
    **dict.fromkeys((".al3d", ".sur", ".sur packed", ".sdf", ".sdf binary"), "surfalize"),
    ".sdf text": "text",
}
"""Kinds of surface files, and what writes them."""
UNITLESS = (".ply", ".xyz")


def a_surface(rng: np.random.Generator, folder: Path, case: Case) -> None:
    """Heights of an instrument in a surface file, some with gaps, some with a given value that contradicts the file."""
    rows, cols = (int(size) for size in rng.integers(12, 60, 2))
    heights = gaussian_filter(rng.normal(0, 20, (rows, cols)), 2)
    if rng.random() < 0.5:
        top, left = int(rng.integers(rows - 4)), int(rng.integers(cols - 4))
        heights[top : top + 3, left : left + 3] = np.nan
    kind = str(rng.choice(list(SURFACES)))
    ending, _, variant = kind.partition(" ")
    path = folder / f"surface{ending}"
    if SURFACES[kind] == "ours":
        wv.write_surface(height_map(heights, case.pixel_um), path)
    elif SURFACES[kind] == "text":
        path.write_bytes(sdf_text(heights, case.pixel_um))
    else:
        import surfalize

        words = {".sur": {"compressed": variant == "packed"}, ".sdf": {"binary": variant == "binary"}}
        surfalize.Surface(heights, case.pixel_um, case.pixel_um).save(str(path), **words.get(ending, {}))
    if rng.random() < 0.3:
        path = path.rename(folder / "surface.dat") if ending in (".gwy", ".sur", ".al3d") else path
        kind = f"{kind}, as {path.suffix}"
    case.src, case.heights_um, case.given, case.is_upright = path, heights, {}, True
    case.about = f"surface {rows} x {cols}, {kind}"
    case.tags += ["surface", f"surface {kind}"]
    if ending in UNITLESS:
        case.given["z_unit"] = "um"
    if rng.random() < 0.2 and ending not in (".npz", *UNITLESS):
        wrong, value = ("pixel_um", 1.25 * case.pixel_um) if rng.random() < 0.5 else ("z_unit", "mm")
        case.given[wrong], case.is_open = value, True
        case.about += f", {wrong} contradicts"
        case.tags.append("contradicts")


def drawn_case(seed: int, folder: Path) -> Case:
    """The case of a seed, written to `folder`."""
    rng = np.random.default_rng((seed, 37))
    n = int(rng.integers(9, 16))
    step, pixel = float(rng.choice([0.5, 1.25, 2.5, 4.0])), float(rng.choice([0.32, 0.65, 1.1]))
    frames = drawn_frames(rng, n)
    given = {"z_step_um": step, "pixel_um": pixel}
    case = Case("", folder, given, frames, list(range(n)), step, pixel)
    kinds = [a_folder, a_folder, a_folder, a_tiff, a_tiff, a_matrix, a_surface, a_surface]
    make = rng.choice(kinds)  # type: ignore[arg-type]
    make(rng, folder, case)
    return case


# --- what is read


def outcome(case: Case) -> tuple[str, str]:
    """Return right, asked, refused or wrong, and why."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            if case.heights_um is not None:
                return judged_heights(case, wv.read_surface(case.src, **case.given))
            return judged_stack(case, wv.open_stack(case.src, **case.given))
    except DatasetError as fault:
        text = str(fault)
        asks = "--" in text or "Choose" in text or "choose" in text
        return ("asked" if asks else "refused"), text


def judged_heights(case: Case, surface: wv.HeightMap) -> tuple[str, str]:
    """Return whether the heights are the true ones, either way up if the file does not say it, in a lattice as true."""
    want = case.heights_um
    if case.is_upright and abs(surface.pixel_um / case.pixel_um - 1) > 1e-3:
        return "wrong", f"pixel {surface.pixel_um}, not {case.pixel_um}"
    for z_um in (surface.z_um, surface.z_um[::-1])[: 1 if case.is_upright else 2]:
        if want is not None and z_um.shape == want.shape and np.allclose(z_um, want, atol=1e-3, equal_nan=True):
            return "right", ""
    return "wrong", f"{surface.z_um.shape}, {np.isnan(surface.z_um).sum()} gaps"


def judged_stack(case: Case, stack: wv.FieldStack) -> tuple[str, str]:
    """Return whether all frames stand in their places, with the true lengths."""
    seen = [
        _nearest(case.frames, image) if there else None
        for image, there in zip(stack.images, stack.present, strict=True)
    ]
    z_um = stack.z_um - stack.z_um[0]
    if seen != case.want:
        return "wrong", f"frames {seen}, not {case.want}"
    if not np.allclose(z_um, np.arange(len(z_um)) * case.step_um, atol=0.02 * case.step_um):
        return "wrong", f"z {z_um[:4]} ..., step {case.step_um}"
    if abs(stack.pixel_um / case.pixel_um - 1) > 1e-3:
        return "wrong", f"pixel {stack.pixel_um}, not {case.pixel_um}"
    return "right", ""


def _nearest(frames: NDArray[Any], image: NDArray[Any]) -> int | None:
    if image.shape != frames.shape[1:]:
        return -1
    off = np.abs(frames.astype(np.int32) - image.astype(np.int32)).mean((1, 2))
    return int(off.argmin()) if off.min() < 3 * (1 + int(frames.max()) // 256) else -2


def main() -> None:
    """Draw the cases, read them, and print the counts."""
    asked = read_options(__doc__, cases=600, first_seed=1, each=False)
    n = 60 if asked.quick else asked.cases
    counts, by_tag = Counter[str](), defaultdict[str, Counter[str]](Counter)
    for seed in range(asked.first_seed, asked.first_seed + n):
        with tempfile.TemporaryDirectory() as name:
            case = drawn_case(seed, Path(name))
            found, why = outcome(case)
        if found in ("asked", "refused") and not case.is_open:
            found = f"{found} needlessly"
        counts[found] += 1
        for tag in case.tags:
            by_tag[tag][found] += 1
        if found == "wrong" or asked.each:
            print(f"seed {seed}: {found}: {case.about}; {why}"[:300])
    print(
        f"{n} cases from seed {asked.first_seed}: " + ", ".join(f"{count} {found}" for found, count in counts.items())
    )
    for tag, found in sorted(by_tag.items()):
        print(f"  {tag:24}" + ", ".join(f"{count} {one}" for one, count in sorted(found.items())))


if __name__ == "__main__":
    main()
