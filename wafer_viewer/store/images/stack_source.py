"""Stacks of images taken elsewhere: files in order, planes sorted onto fields and slots, and lengths agreed upon.

What the files say is used; what contradicts it is refused with both values, unless the user overrules it.
"""

from __future__ import annotations

import fnmatch
import math
import re
from collections import defaultdict
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.calibration import engraved_aperture
from wafer_viewer.model.acquisition.image_source import ImageOptions, ImagePlane, Mirror, Stated, Statements
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.numerics.frame_sequence import contradicting_order
from wafer_viewer.store.images.frame_names import FrameOrder, frame_order
from wafer_viewer.store.images.image_files import NOTHING_WRITTEN, Paths, PlanesOf, image_files, planes_of
from wafer_viewer.store.images.name_pattern import Cell, NamedPlane, planes_by_pattern
from wafer_viewer.store.images.tile_places import matched, mirrored, numbered_cells, places_of

Slot = tuple[ImagePlane | None, ...]
"""Planes at one z: one an exposure, None where it is missing."""
K = TypeVar("K", bound=Hashable)
SAME = 1e-3
"""Relative difference up to which two values of one length agree."""


class UnsettledValue(DatasetError):
    """A value or a choice that is missing, or is stated several times and differs.

    name: of the length, or of the axis with several names. values: those that differ, empty if it is missing.
    """

    def __init__(self, message: str, name: str = "", values: tuple[Stated[float], ...] = ()) -> None:
        super().__init__(message)
        self.name, self.values = name, values


@dataclass(frozen=True, slots=True)
class SourceField:
    """One field: its slots in rising z, and its stated place.

    z_um: of each slot from the lowest, None if no file states it; x_um, y_um: centre on the stage, None if unknown;
    cell: row and column as numbered in the names, None without a pattern.
    """

    name: str
    slots: tuple[Slot, ...]
    z_um: tuple[float, ...] | None = None
    x_um: float | None = None
    y_um: float | None = None
    cell: Cell | None = None


@dataclass(frozen=True, slots=True)
class ImportSource:
    """Images as they are taken: fields, agreed lengths, and what is worth telling.

    z_step_um: over 0. exposures_us: of each exposure of the slots, empty if unknown. objective: its name with its
    aperture; taken: date and time; both empty if unknown. order_is_stated: False where only names or the user give the
    order. notes: one sentence each.
    """

    fields: tuple[SourceField, ...]
    pixel_um: Stated[float]
    z_step_um: Stated[float]
    numerical_aperture: Stated[float] | None
    exposures_us: tuple[float, ...]
    objective: str
    taken: str
    simulated: bool
    order_is_stated: bool
    notes: tuple[str, ...]

    @property
    def is_tiled(self) -> bool:
        """True for several fields of a single image each, which have no z step."""
        return len(self.fields) > 1 and all(len(field.slots) == 1 for field in self.fields)


def read_source(src: Paths, options: ImageOptions, planes_of: PlanesOf = planes_of) -> ImportSource:
    """Return the stacks of a folder, a file or a list of files.

    Parameters
    ----------
    src : str, Path or sequence of them
        Folder of images, image file, or several of them.
    options : ImageOptions
        Values and choices of the user.
    planes_of : callable
        Returns the planes of a file; one that remembers them reads no header twice.

    Returns
    -------
    ImportSource
        One field, or one for each stated position.

    Raises
    ------
    DatasetError
        When there are no images, a file is damaged, the order of the frames is not clear, there are several channels
        or times and none is chosen, a length is unknown, or what is given contradicts the files.
    """
    if options.pattern is not None:
        named = planes_by_pattern(src, options.pattern, planes_of)
        order, planes = FrameOrder(()), [one.plane for one in named]
    else:
        named = []
        order, planes = _planes_in_order(src, options, planes_of)
    if not planes:
        raise DatasetError(f"Import stopped: no images were given. {NOTHING_WRITTEN} Name a folder, a file or several.")
    named_z = order.z_um is not None or (options.pattern is not None and "{z}" in options.pattern)
    order_is_stated = len({plane.path for plane in planes}) == 1 or (
        not named_z and all(plane.z_um is not None for plane in planes)
    )
    chosen = planes if named else _chosen(planes, options)
    says = merged_statements(chosen, options)
    aperture = _agreed("numerical aperture", "", "--na", options.numerical_aperture, says.numerical_aperture, options)
    if named:
        fields, step, more = _fields_by_cell(named, says, options)
    else:
        fields, step, more = _fields(chosen, order, says, options)
    pixel = _pixel_um(says, options)
    fields = _in_their_places(fields, pixel.value, options)
    if not named:
        _require_places(fields, pixel.value)
    exposures_us, of_exposures = _exposures_us(fields)
    return ImportSource(
        fields=fields,
        pixel_um=pixel,
        z_step_um=step,
        numerical_aperture=aperture,
        exposures_us=exposures_us,
        objective=_objective(says, aperture),
        taken="" if says.taken is None else says.taken.value,
        simulated=any(plane.simulated for plane in planes),
        order_is_stated=options.as_listed or order_is_stated,
        notes=(*order.notes, *says.notes, *more, *of_exposures, *_sources(pixel, step)),
    )


def _listed_files(src: Paths, options: ImageOptions) -> tuple[list[Path], bool]:
    """Return the files that the user means, and whether they were listed one by one."""
    listed = not isinstance(src, str | Path)
    folders = listed and any(Path(one).is_dir() for one in src)
    files = image_files(src)
    if options.only is not None:
        files = [path for path in files if fnmatch.fnmatch(path.name, options.only)]
        if not files:
            raise DatasetError(f"No image is named like {options.only!r}. {NOTHING_WRITTEN} Change the pattern.")
    return files, listed and not folders


def _planes_in_order(src: Paths, options: ImageOptions, planes_of: PlanesOf) -> tuple[FrameOrder, list[ImagePlane]]:
    """Return the planes of all files, each once, and the order of the files.

    Where every file is one frame, its place in the order is its k, and missing numbers are gaps in k. Files that hold a
    stack each and state their place are fields.
    """
    files, listed = _listed_files(src, options)
    by_file = {path: planes_of(path) for path in files}
    alone = [planes[0] for planes in by_file.values() if len(planes) == 1 and planes[0].z_um is not None]
    if 1 < len(files) == len(alone) == len({plane.z_um for plane in alone}) and not options.as_listed:
        ordered = sorted(alone, key=lambda plane: plane.z_um or 0.0)
        return FrameOrder(tuple(plane.path for plane in ordered)), [replace(p, k=n) for n, p in enumerate(ordered)]
    several = len(files) > 1 and all(len(planes) > 1 for planes in by_file.values())
    if several or _are_tiles(by_file, options):
        return FrameOrder(tuple(files)), _stacks(by_file, options)
    order = FrameOrder(tuple(files))
    if len(files) > 1 and not options.as_listed:
        said = {path: planes[0].says.taken for path, planes in by_file.items() if planes}
        clock = {path: taken.value for path, taken in said.items() if taken is not None}
        order = frame_order(files, listed=listed, clock=clock)
    found: dict[tuple[Path, int], ImagePlane] = {}
    k = 0
    for n, path in enumerate(order.files):
        planes = by_file[path] if path is not None else ()
        for plane in planes:
            z_um = order.z_um[n] if order.z_um is not None and plane.z_um is None else plane.z_um
            found.setdefault((plane.path, plane.page), replace(plane, k=k + plane.k, z_um=z_um))
        k += 1 + max((plane.k for plane in planes), default=0)
    return order, list(found.values())


def _are_tiles(by_file: Mapping[Path, Sequence[ImagePlane]], options: ImageOptions) -> bool:
    """Return whether each file is one image at a place of its own, by a table or by what it states."""
    planes = [plane for own in by_file.values() for plane in own]
    if not 1 < len(by_file) == len(planes):
        return False
    places = {(plane.x_um, plane.y_um) for plane in planes if None not in (plane.x_um, plane.y_um)}
    return options.places is not None or len(places) == len(planes)


def _stacks(by_file: Mapping[Path, Sequence[ImagePlane]], options: ImageOptions) -> list[ImagePlane]:
    """Return the planes of files that hold a stack each. Raises DatasetError when they do not say where they lie."""
    found: dict[tuple[Path, int], ImagePlane] = {}
    for path, planes in by_file.items():
        for plane in planes:
            if options.places is None and (plane.x_um is None or plane.y_um is None):
                raise DatasetError(
                    f"There are {len(by_file)} files of several pages each, such as {path.name}, and they do not say "
                    "where they lie: say it with --pattern, as in 'r{row}_c{col}.tif', or with --places, or give one "
                    "of them."
                )
            position = plane.position or path.stem
            found.setdefault((plane.path, plane.page), replace(plane, position=position))
    return list(found.values())


# --- order


def order_doubt(names: Sequence[str], sharpness: NDArray[np.float64]) -> str | None:
    """Return a sentence where the images contradict the order of their names; `sharpness` is [frame, place]."""
    found = contradicting_order(sharpness)
    if found is None:
        return None
    supported = [names[k] for k in found.order]
    return (
        "The images contradict the order of their names: sharpness rises and falls several times at most places, and "
        f"once in another order, {', '.join(supported[:3])} ... {supported[-1]}. Give the files in that order, or say "
        "that the present one is right with --as-listed."
    )


# --- statements


_TITLES = {"pixel_um": "pixel size", "z_step_um": "z step", "numerical_aperture": "numerical aperture"}


def merged_statements(planes: Sequence[ImagePlane], options: ImageOptions) -> Statements:
    """Return what the files say together. Raises DatasetError where they contradict each other."""
    merged = planes[0].says
    for name in ("pixel_um", "z_step_um", "numerical_aperture"):
        said = {}
        for plane in planes:
            stated = getattr(plane.says, name)
            if stated is not None:
                said.setdefault(float(f"{stated.value:.4g}"), (stated, plane))
        if len(said) > 1 and not options.overrule:
            (low, a), (high, b) = min(said.items()), max(said.items())
            if not math.isclose(low, high, rel_tol=SAME):
                title = name.removesuffix("_um").replace("_", " ")
                raise UnsettledValue(
                    f"The images contradict each other: the {title} is {low:g} in {a[1].name} and {high:g} in "
                    f"{b[1].name}. Import them one by one, or give the right value with --overrule.",
                    _TITLES[name],
                    tuple(Stated(stated.value, plane.name) for stated, plane in (a, b)),
                )
    for plane in planes:
        merged = merged.merged(plane.says)
    return merged


def _agreed(
    title: str, unit: str, flag: str, given: float | None, stated: Stated[float] | None, options: ImageOptions
) -> Stated[float] | None:
    """Return the given value, else the stated one. Raises DatasetError when both are there and differ."""
    if given is None:
        return stated
    differs = stated is not None and not math.isclose(abs(given), abs(stated.value), rel_tol=SAME)
    if stated is not None and differs and not options.overrule:
        raise UnsettledValue(
            f"The {title} is given as {abs(given):g}{unit}, and the images say {abs(stated.value):g}{unit} "
            f"({stated.source}): leave {flag} out, or give --overrule if the images are wrong.",
            title,
            (Stated(given, "given"), stated),
        )
    return Stated(given, "given")


def _pixel_um(says: Statements, options: ImageOptions) -> Stated[float]:
    if says.pixel_um is not None and says.pixel_y_um is not None and options.pixel_um is None:
        x_um, y_um = says.pixel_um.value, says.pixel_y_um.value
        if not math.isclose(x_um, y_um, rel_tol=SAME):
            raise UnsettledValue(
                f"The images have pixels of {x_um:g} x {y_um:g} um ({says.pixel_um.source}): resample them to square "
                "pixels before, or give --pixel-um with --overrule.",
                "pixel size",
                (says.pixel_um, says.pixel_y_um),
            )
    agreed = _agreed("pixel size", " um", "--pixel-um", options.pixel_um, says.pixel_um, options)
    if agreed is None:
        raise UnsettledValue(
            "The pixel size is missing: give it with --pixel-um, the images do not say it.", "pixel size"
        )
    if not 0 < agreed.value < np.inf:
        raise DatasetError(f"The pixel size is {agreed.value:g} um: it must be over 0.")
    return agreed


def _objective(says: Statements, aperture: Stated[float] | None) -> str:
    """Return the name of the objective with its aperture, as far as they are known."""
    name = "" if says.objective is None else says.objective.value
    if aperture is None or engraved_aperture(name) is not None:
        return name
    return f"{name} NA {round(aperture.value, 4)}".strip()


def _exposures_us(fields: Iterable[SourceField]) -> tuple[tuple[float, ...], list[str]]:
    """Return the stated time of each exposure of the slots, empty unless all frames state theirs, and a note."""
    by_exposure: dict[int, list[float | None]] = defaultdict(list)
    for field in fields:
        for slot in field.slots:
            for exposure, plane in enumerate(slot):
                if plane is not None:
                    by_exposure[exposure].append(plane.exposure_us)
    stated = [[us for us in by_exposure[n] if us] for n in sorted(by_exposure)]
    if any(len(known) < len(by_exposure[n]) for n, known in enumerate(stated)):
        return (), []
    notes = [
        f"The exposure time changes from {min(known):g} to {max(known):g} us between frames: fix it for a whole stack."
        for known in stated
        if max(known) > (1 + _SAME_STEP) * min(known)
    ]
    return tuple(float(np.median(known)) for known in stated), notes


def _sources(pixel: Stated[float], step: Stated[float]) -> Iterator[str]:
    """Yield where a length was found that the user did not give."""
    for title, stated in (("A pixel", pixel), ("The z step", step)):
        if stated.source != "given":
            yield f"{title} is {stated.value:.6g} um: {stated.source}."


# --- choices


def _chosen(planes: list[ImagePlane], options: ImageOptions) -> list[ImagePlane]:
    """Return the planes of the chosen channel, time and position. Raises DatasetError where a choice is missing.

    The position is first, as those of a file may have other channels and times each.
    """
    planes = _on_axis(planes, "position", options.position, needed=False)
    positions = list(dict.fromkeys(plane.position for plane in planes))
    unplaced = options.places is None and any(plane.x_um is None or plane.y_um is None for plane in planes)
    if len(positions) > 1 and unplaced:
        raise DatasetError(
            f"The images have {len(positions)} positions and do not say where these lie. {_choose(positions)[:-1]}, or "
            "give a table of their places with --places."
        )
    for axis in ("channel", "time"):
        planes = _on_axis(planes, axis, getattr(options, axis), needed=True)
    return planes


def _choose(positions: Sequence[str]) -> str:
    return f"Choose one with --position: {', '.join(positions[:8])}{' ...' if len(positions) > 8 else ''}."


def _require_places(fields: Sequence[SourceField], pixel_um: float) -> None:
    """Raise DatasetError when two positions lie at the same place."""
    places: dict[tuple[int, int], str] = {}
    for field in fields if len(fields) > 1 else ():
        at = round((field.x_um or 0.0) / pixel_um), round((field.y_um or 0.0) / pixel_um)
        if at in places:
            choose = _choose([one.name for one in fields])
            raise DatasetError(f"The positions {places[at]} and {field.name} lie at the same place. {choose}")
        places[at] = field.name


def _on_axis(planes: list[ImagePlane], axis: str, choice: str | None, *, needed: bool) -> list[ImagePlane]:
    names = list(dict.fromkeys(getattr(plane, axis) for plane in planes))
    if choice is None:
        if needed and len(names) > 1:
            shown = ", ".join(name or "unnamed" for name in names[:8]) + (" ..." if len(names) > 8 else "")
            raise UnsettledValue(
                f"The images have {len(names)} {axis}s: {shown}. Say which to take, as in --{axis} '{names[0]}', or "
                "its number, from 0.",
                axis,
            )
        return planes
    wanted = next((name for name in names if name.casefold() == choice.casefold()), None)
    if wanted is None and choice.isdigit() and int(choice) < len(names):
        wanted = names[int(choice)]
    if wanted is None:
        raise DatasetError(
            f"There is no {axis} {choice!r}: the images have {', '.join(name or 'one' for name in names[:8])}."
        )
    return [plane for plane in planes if getattr(plane, axis) == wanted]


# --- fields and slots


def _fields(
    planes: list[ImagePlane], order: FrameOrder, says: Statements, options: ImageOptions
) -> tuple[tuple[SourceField, ...], Stated[float], list[str]]:
    """Sort planes onto fields and slots in rising z."""
    by_field = _grouped(planes, lambda plane: plane.position)
    z_source = "names of the files" if order.z_um is not None else "positions of the planes"
    step, notes = _step(by_field, says, z_source, options, _have_no_z(by_field))
    if step.source == "given" and options.overrule:
        by_field = {name: [replace(plane, z_um=None) for plane in own] for name, own in by_field.items()}
        planes = []
    down = step.value < 0
    lowest = min((plane.z_um for plane in planes if plane.z_um is not None), default=0.0)
    fields = tuple(_field(name, own, abs(step.value), down, lowest) for name, own in by_field.items())
    return _alike(fields), replace(step, value=abs(step.value)), notes


def _grouped(planes: Iterable[ImagePlane], key: Callable[[ImagePlane], K]) -> dict[K, list[ImagePlane]]:
    groups: dict[K, list[ImagePlane]] = defaultdict(list)
    for plane in planes:
        groups[key(plane)].append(plane)
    return groups


def _step(
    by_field: Mapping[str, list[ImagePlane]], says: Statements, source: str, options: ImageOptions, tiled: bool
) -> tuple[Stated[float], list[str]]:
    """Return the z step, under 0 where k goes down; 1 of tiles. Raises DatasetError when unknown, 0 or contradicted."""
    stated = _stated_step(by_field, source)
    notes: list[str] = []
    if stated is not None and says.z_step_um is not None:
        known = says.z_step_um
        ratio = abs(stated.value / known.value)
        if not 1 / _LIKE_STEP < ratio < _LIKE_STEP and not options.overrule:
            raise DatasetError(
                f"The images contradict themselves: the planes lie {abs(stated.value):.4g} um apart ({stated.source}), "
                f"and {known.source} is {abs(known.value):g} um. Give the right one with --z-step-um and --overrule."
            )
        if not math.isclose(abs(stated.value), abs(known.value), rel_tol=_SAME_STEP):
            notes.append(
                f"The planes lie {abs(stated.value):.4g} um apart ({stated.source}), and {known.source} is "
                f"{abs(known.value):g} um: the places are taken."
            )
    stated = stated or says.z_step_um
    given = options.z_step_um
    if given is not None and (given == 0 or not np.isfinite(given)):
        raise DatasetError(f"The z step is {given:g} um: give the distance between frames, under 0 if taken downward.")
    if given is not None and stated is not None and stated.source == source and not options.overrule:
        if not math.isclose(abs(given), abs(stated.value), rel_tol=_SAME_STEP):
            _agreed("z step", " um", "--z-step-um", given, stated, options)
        return stated, notes
    agreed = _agreed("z step", " um", "--z-step-um", given, stated, options)
    if agreed is None and tiled:
        return Stated(1.0, "given"), notes
    if agreed is None:
        raise UnsettledValue("The z step is missing: give it with --z-step-um, the images do not say it.", "z step")
    return agreed, notes


def _have_no_z(by_field: Mapping[str, list[ImagePlane]]) -> bool:
    """Return whether there are several fields, each of one image."""
    return len(by_field) > 1 and all(len({plane.k for plane in own}) == 1 for own in by_field.values())


_SAME_STEP, _LIKE_STEP = 0.02, 1.5
"""Relative difference of a mean step from a planned one, as stages do not repeat their steps exactly; and the ratio
from which one of them is wrong, as where a piezo drive takes the steps and the place of the stage is stated."""


def _stated_step(by_field: Mapping[str, list[ImagePlane]], source: str) -> Stated[float] | None:
    """Return the median step of the stated z along k; None unless every plane states its own."""
    steps: list[float] = []
    for planes in by_field.values():
        by_k = {plane.k: plane.z_um for plane in planes}
        if any(z is None for z in by_k.values()):
            return None
        ks = sorted(by_k)
        z_um = np.array([by_k[k] for k in ks], np.float64)
        if len(ks) < 2 or len(np.unique(z_um)) < len(ks):
            return None
        steps += list(np.diff(z_um) / np.diff(ks))
    return Stated(float(np.median(steps)), source) if steps else None


def _fields_by_cell(
    named: Sequence[NamedPlane], says: Statements, options: ImageOptions
) -> tuple[tuple[SourceField, ...], Stated[float], list[str]]:
    """Sort planes that a pattern names onto fields; a slot that other fields have and one lacks is empty."""
    by_z = options.pattern is not None and "{z}" in options.pattern
    zs = sorted({one.plane.z_um for one in named if one.plane.z_um is not None}) if by_z else []
    planes = [
        replace(one.plane, position=str(one.cell), k=zs.index(one.plane.z_um or 0.0) if by_z else one.plane.k)
        for one in named
    ]
    cells = {str(one.cell): one.cell for one in named}
    by_field = _grouped(planes, lambda plane: plane.position)
    step, notes = _step(by_field if by_z else {}, says, "names of the files", options, _have_no_z(by_field))
    ks, exposures = (sorted({getattr(plane, part) for plane in planes}) for part in ("k", "exposure"))
    fields: list[SourceField] = []
    for name in sorted(by_field, key=cells.__getitem__):
        by_slot = {(plane.k, plane.exposure): plane for plane in by_field[name]}
        slots = [tuple(by_slot.get((k, exposure)) for exposure in exposures) for k in ks]
        row, col = cells[name]
        fields.append(
            SourceField(
                f"the field in row {row}, column {col}",
                tuple(slots[:: -1 if step.value < 0 else 1]),
                tuple(z - zs[0] for z in zs) if by_z else None,
                cell=cells[name],
            )
        )
    return tuple(fields), replace(step, value=abs(step.value)), notes


def _in_their_places(
    fields: tuple[SourceField, ...], pixel_um: float, options: ImageOptions
) -> tuple[SourceField, ...]:
    """Return the fields where running numbers or a table put them, with the axes that the user has mirrored."""
    if options.pattern is not None and re.search(r"\{(n|series)\b", options.pattern):
        cells = numbered_cells([field.cell[1] for field in fields if field.cell is not None], options)
        numbers = [field.cell[1] if field.cell else 0 for field in fields]
        fields = tuple(
            replace(field, cell=cells[n], name=f"field {n}") for field, n in zip(fields, numbers, strict=True)
        )
    else:
        numbers = [None] * len(fields)
    if options.places is not None:
        names = [_names_in_table(field, number) for field, number in zip(fields, numbers, strict=True)]
        found = [place.um(pixel_um) for place in matched(places_of(options.places), names, options.places.name)]
        fields = tuple(replace(field, x_um=x, y_um=y) for field, (x, y) in zip(fields, found, strict=True))
    return tuple(_mirrored(field, options.mirror) for field in fields)


def _names_in_table(field: SourceField, number: int | None) -> list[str]:
    """Return the names by which a table may call a field: its files, their stems, position, cell and number."""
    paths = dict.fromkeys(plane.path for slot in field.slots for plane in slot if plane is not None)
    names = [name for path in paths for name in (path.name, path.stem, path.name.split(".")[0])]
    if number is not None:
        return [str(number), *names]
    return [*names, field.name, *([] if field.cell is None else [f"{field.cell[0]},{field.cell[1]}"])]


def _mirrored(field: SourceField, mirror: Mirror) -> SourceField:
    if field.x_um is not None and field.y_um is not None:
        x_um, y_um = mirrored(field.x_um, field.y_um, mirror)
        field = replace(field, x_um=x_um, y_um=y_um)
    if field.cell is not None:
        col, row = mirrored(field.cell[1], field.cell[0], mirror)
        field = replace(field, cell=(int(row), int(col)))
    return field


def _field(name: str, planes: list[ImagePlane], step_um: float, down: bool, lowest_um: float) -> SourceField:
    by_slot = _grouped(planes, lambda plane: plane.k)
    exposures = sorted({plane.exposure for plane in planes})
    ks = range(min(by_slot), max(by_slot) + 1)
    slots = [tuple(_at(by_slot.get(k, ()), exposure) for exposure in exposures) for k in ks]
    stated = [{plane.z_um for plane in by_slot.get(k, ())} for k in ks]
    z_um: tuple[float, ...] | None = None
    if all(one and None not in one for one in stated if one) and any(stated):
        z_um = _filled([next(iter(one)) if one else None for one in stated], -step_um if down else step_um)
    order = list(range(len(slots)))[:: -1 if down else 1]
    if z_um is not None:
        order.sort(key=z_um.__getitem__)
    x_um, y_um = (_mean(getattr(plane, axis) for plane in planes) for axis in ("x_um", "y_um"))
    return SourceField(
        name,
        tuple(slots[n] for n in order),
        None if z_um is None else tuple(z_um[n] - lowest_um for n in order),
        x_um,
        y_um,
    )


def _at(planes: Iterable[ImagePlane], exposure: int) -> ImagePlane | None:
    return next((plane for plane in planes if plane.exposure == exposure), None)


def _filled(stated: list[float | None], step_um: float) -> tuple[float, ...] | None:
    """Return the z of all slots; a missing one lies a step from its neighbour. None if two have the same z."""
    z_um = list[float]()
    for n, one in enumerate(stated):
        z_um.append(one if one is not None else (z_um[n - 1] + step_um if n else 0.0))
    return tuple(z_um) if len(set(z_um)) == len(z_um) else None


def _mean(values: Iterable[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None


def _alike(fields: tuple[SourceField, ...]) -> tuple[SourceField, ...]:
    """Return fields with the same number of slots; what a field lacks at its end is missing."""
    longest = max(len(field.slots) for field in fields)
    n_exposures = max(len(field.slots[0]) for field in fields)
    empty: Slot = (None,) * n_exposures
    return tuple(
        replace(field, slots=(*field.slots, *[empty] * (longest - len(field.slots))))
        if len(field.slots) < longest
        else field
        for field in fields
    )
