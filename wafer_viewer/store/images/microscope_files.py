"""Planes of the files of microscope makers, read by libraries of others: Zeiss CZI, Nikon ND2, Leica LIF, Olympus OIB.

A plane is read when it is asked for, so that a file is never in memory as a whole. The libraries are extras.
"""

from __future__ import annotations

import datetime
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.acquisition.focus_stack import Image
from wafer_viewer.model.acquisition.image_source import ImagePlane, Stated, Statements
from wafer_viewer.model.errors import DatasetError, parser_errors_as
from wafer_viewer.store.images.image_files import NOTHING_WRITTEN, as_grey, damaged, states_simulated
from wafer_viewer.store.images.image_series import Place, Series, Where, planes_in
from wafer_viewer.store.io.guarded_reading import require_pixels

_UM_PER_M, _US_PER_MS, _US_PER_NS = 1e6, 1e3, 1e-3
Own = dict[str, float]
"""Values of a plane of its own, by the names of the fields of `ImagePlane`."""


def _known_axes(name: str, sizes: Mapping[str, int], known: str) -> dict[str, int]:
    """Return the known axes. Raises DatasetError when another one has several values."""
    for axis, size in sizes.items():
        if size > 1 and axis not in known:
            raise DatasetError(
                f"Import stopped at {name}: its axis {axis} has {size} values, and an axis of this kind is not read. "
                f"{NOTHING_WRITTEN} Export one of them as OME-TIFF."
            )
    return {axis: size for axis, size in sizes.items() if axis in known}


def _length(value: Any, source: str, um: float = 1.0) -> Stated[float] | None:
    """Return a stated number times a unit in um; None for what is no number, not finite or 0."""
    try:
        number = float(value) * um
    except (TypeError, ValueError):
        return None
    return Stated(number, source) if np.isfinite(number) and number != 0 else None


def _text(value: Any, source: str) -> Stated[str] | None:
    text = " ".join(str(value).split()) if value is not None else ""
    return Stated(text, source) if text else None


# --- Zeiss CZI


def planes_of_czi(path: Path) -> tuple[ImagePlane, ...]:
    """Return the planes of a Zeiss CZI file; its scenes are positions, placed as their pixels lie in the whole image.

    Raises DatasetError when the file is damaged, or has several values on other axes than scene, time, z and channel.
    """
    from pylibCZIrw.czi import open_czi

    planes: list[ImagePlane] = []
    with parser_errors_as(partial(damaged, path.name)), open_czi(str(path)) as file:
        about = ElementTree.fromstring(file.raw_metadata)
        box = {axis: high - low for axis, (low, high) in file.total_bounding_box_no_pyramid.items() if axis not in "XY"}
        sizes = _known_axes(path.name, box, "TZC")
        says = _czi_statements(about)
        if (n_tiles := _czi_tiles(file)) > 1:
            note = f"The {n_tiles} tiles of a scene were put together by their places alone: seams may show."
            says = replace(says, notes=(note,))
        scenes = file.scenes_bounding_rectangle_no_pyramid or {None: file.total_bounding_rectangle_no_pyramid}
        for scene, area in scenes.items():
            require_pixels(path.name, area.h, area.w)
            series = Series(
                says,
                f"scene {scene}" if len(scenes) > 1 else "",
                [channel.get("Name") or f"channel {n}" for n, channel in enumerate(_czi_channels(about))],
                partial(_czi_own, _czi_place(says, area), _czi_exposures(about)),
                simulated=states_simulated(file.raw_metadata),
            )
            read = partial(_read_czi, path, scene, (area.x, area.y, area.w, area.h))
            planes += planes_in(path, sizes, series, read, len(planes))
    return tuple(planes)


def _read_czi(path: Path, scene: int | None, area: tuple[int, int, int, int], name: str, where: Where) -> Image:
    from pylibCZIrw.czi import open_czi

    with parser_errors_as(partial(damaged, name)), open_czi(str(path)) as file:
        values: NDArray[Any] = file.read(roi=area, plane=dict(where), scene=scene)
    return as_grey(values[:, :, ::-1] if values.shape[2] == 3 else values[:, :, 0], name)  # colours are blue first


def _czi_tiles(file: Any) -> int:
    """Return the number of tiles of the scene with the most."""
    highest = [0]

    def see(_: int, block: Any) -> bool:
        if block.is_mindex_valid():
            highest.append(int(block.mIndex))
        return True

    file.enumerate_subblocks(see)
    return 1 + max(highest)


def _czi_channels(about: ElementTree.Element) -> list[ElementTree.Element]:
    return about.findall("./Metadata/Information/Image/Dimensions/Channels/Channel")


def _czi_statements(about: ElementTree.Element) -> Statements:
    def scaling(axis: str) -> Stated[float] | None:
        value = about.findtext(f"./Metadata/Scaling/Items/Distance[@Id='{axis}']/Value")
        return _length(value, f"CZI Scaling {axis}", _UM_PER_M)

    information = "./Metadata/Information"
    objectives = about.findall(f"{information}/Instrument/Objectives/Objective")
    used = about.find(f"{information}/Image/ObjectiveSettings/ObjectiveRef")
    objective = next((one for one in objectives if used is not None and one.get("Id") == used.get("Id")), None)
    if objective is None and len(objectives) == 1:
        objective = objectives[0]
    taken = about.findtext(f"{information}/Image/AcquisitionDateAndTime")
    step = scaling("Z")
    increment = about.findtext(f"{information}/Image/Dimensions/Z/Positions/Interval/Increment")
    if step is not None and increment is not None and (own := _length(increment, "")) is not None and own.value < 0:
        step = replace(step, value=-step.value)
    return Statements(
        pixel_um=scaling("X"),
        pixel_y_um=scaling("Y"),
        z_step_um=step,
        numerical_aperture=None if objective is None else _length(objective.findtext("LensNA"), "CZI LensNA"),
        objective=None if objective is None else _text(objective.findtext("Manufacturer/Model"), "CZI Objective"),
        taken=_text(taken or about.findtext(f"{information}/Document/CreationDate"), "CZI date"),
    )


def _czi_exposures(about: ElementTree.Element) -> list[Stated[float] | None]:
    """Return the exposure time of each channel in us."""
    texts = [channel.findtext("ExposureTime") for channel in _czi_channels(about)]
    return [_length(text, "CZI ExposureTime", _US_PER_NS) for text in texts]


def _czi_place(says: Statements, area: Any) -> Own:
    """Return the centre of an area of pixels in um, y up."""
    if says.pixel_um is None:
        return {}
    pixel_um = says.pixel_um.value
    return {"x_um": (area.x + area.w / 2) * pixel_um, "y_um": -(area.y + area.h / 2) * pixel_um}


def _czi_own(centre: Own, exposures: Sequence[Stated[float] | None], place: Place) -> Own:
    exposure = exposures[place.channel] if place.channel < len(exposures) else None
    return centre | ({} if exposure is None else {"exposure_us": exposure.value})


# --- Nikon ND2


def planes_of_nd2(path: Path) -> tuple[ImagePlane, ...]:
    """Return the planes of a Nikon ND2 file.

    Raises DatasetError when the file is damaged, or has several values on other axes than position, time, z and
    channel.
    """
    import nd2

    with parser_errors_as(partial(damaged, path.name)), nd2.ND2File(path) as file:
        require_pixels(path.name, file.sizes["Y"], file.sizes["X"])
        sizes = _known_axes(path.name, {axis: n for axis, n in file.sizes.items() if axis not in "YXS"}, "PTZC")
        frames = {_nd2_place(at): n for n, at in enumerate(file.loop_indices)}
        series = Series(
            _nd2_statements(file),
            channels=[channel.channel.name for channel in file.metadata.channels or ()],
            own=partial(_nd2_own, _nd2_frames(file, frames)),
            simulated=states_simulated("\n".join(map(str, file.text_info.values()))),
        )
        return tuple(planes_in(path, sizes, series, partial(_read_nd2, path, frames)))


FrameKey = tuple[int, int, int]
"""Position, time and z of an ND2 frame, which holds all channels."""


def _nd2_place(at: Mapping[str, int]) -> FrameKey:
    return at.get("P", 0), at.get("T", 0), at.get("Z", 0)


def _read_nd2(path: Path, frames: Mapping[FrameKey, int], name: str, where: Where) -> Image:
    import nd2

    with parser_errors_as(partial(damaged, name)), nd2.ND2File(path) as file:
        frame: NDArray[Any] = np.asarray(file.read_frame(frames[_nd2_place(where)]))
        return as_grey(frame[where["C"]] if "C" in where else frame, name)


def _nd2_statements(file: Any) -> Statements:
    channels = file.metadata.channels or ()
    if not channels:
        return Statements()
    volume, lens = channels[0].volume, channels[0].microscope
    x_um, y_um, _ = (
        um if known else None for um, known in zip(volume.axesCalibration, volume.axesCalibrated, strict=True)
    )
    loop = next((one.parameters for one in file.experiment if one.type == "ZStackLoop"), None)
    down = loop is not None and not loop.bottomToTop
    return Statements(
        pixel_um=_length(x_um, "ND2 axesCalibration"),
        pixel_y_um=_length(y_um, "ND2 axesCalibration"),
        z_step_um=None if loop is None else _length(loop.stepUm, "ND2 ZStackLoop", -1.0 if down else 1.0),
        numerical_aperture=_length(lens.objectiveNumericalAperture, "ND2 objectiveNumericalAperture"),
        objective=_text(lens.objectiveName, "ND2 objectiveName"),
        taken=_nd2_date(file),
    )


_JULIAN_DAY_OF_1970 = 2440587.5


def _nd2_date(file: Any) -> Stated[str] | None:
    """Return the time of the first frame, UTC."""
    day = _nd2_channel(file, 0).time.absoluteJulianDayNumber
    if not day:
        return None
    taken = datetime.datetime(1970, 1, 1) + datetime.timedelta(days=day - _JULIAN_DAY_OF_1970)
    return Stated(f"{taken:%Y-%m-%dT%H:%M:%SZ}", "ND2 absoluteJulianDayNumber")


def _nd2_channel(file: Any, frame: int) -> Any:
    return file.frame_metadata(frame).channels[0]


def _nd2_frames(file: Any, frames: Mapping[FrameKey, int]) -> dict[FrameKey, Own]:
    """Return place, exposure and time of each frame; z only where the stage took the steps, not a piezo drive alone."""
    exposures = [_nd2_exposure(event) for event in file.events()]
    found: dict[FrameKey, Own] = {}
    to_image = _nd2_axes(file)
    for key, frame in frames.items():
        one = _nd2_channel(file, frame)
        at = one.position.stagePositionUm
        x_um, y_um = map(float, to_image @ (at.x, at.y))
        found[key] = {"x_um": x_um, "y_um": y_um, "z_um": at.z, "time_us": one.time.relativeTimeMs * _US_PER_MS}
        if frame < len(exposures) and exposures[frame]:
            found[key]["exposure_us"] = exposures[frame]
    if len({key[2] for key in found}) > len({own["z_um"] for own in found.values()}):
        for own in found.values():
            del own["z_um"]
    return found


def _nd2_exposure(event: Mapping[str, Any]) -> float:
    """Return the exposure time of a frame in us; 0 if unknown."""
    return next((ms * _US_PER_MS for name, ms in event.items() if name.endswith("Exposure Time [ms]")), 0.0)


def _nd2_axes(file: Any) -> NDArray[np.float64]:
    """Return the matrix that turns places of the stage to the axes of the image, x to the right and y up."""
    matrix = file.metadata.channels[0].volume.pixelToStageTransformationMatrix
    if matrix is None:
        return np.eye(2)
    of_pixels = np.array([[matrix[0], -matrix[1]], [matrix[3], -matrix[4]]])  # along x, and upwards
    turn = of_pixels / np.hypot(*of_pixels[:, 0])
    return np.linalg.inv(turn)


def _nd2_own(frames: Mapping[FrameKey, Own], place: Place) -> Own:
    return frames.get((place.position, place.time, place.k), {})


# --- Leica LIF


def planes_of_lif(path: Path) -> tuple[ImagePlane, ...]:
    """Return the planes of a Leica LIF, LOF or XLEF file; its images are positions. Sections across z are left out.

    Raises DatasetError when the file is damaged, or an image has several values on other axes than tile, time, z and
    channel or wavelength.
    """
    import liffile

    planes: list[ImagePlane] = []
    left_out: list[str] = []
    with parser_errors_as(partial(damaged, path.name)), liffile.LifFile(path) as file:
        several = len(file.images) > 1
        for number, image in enumerate(file.images):
            if tuple(axis for axis in image.dims if axis != "S")[-2:] != ("Y", "X"):
                left_out.append(image.path)
                continue
            require_pixels(path.name, image.sizes["Y"], image.sizes["X"])
            series = Series(
                _lif_statements(image),
                image.path if several else "",
                _lif_channels(image),
                partial(_lif_own, image),
                simulated=states_simulated(ElementTree.tostring(image.xml_element, "unicode")),
            )
            sizes = {axis: n for axis, n in image.sizes.items() if axis not in "YXS"}
            renamed = {_lif_axis(axis): n for axis, n in _known_axes(path.name, sizes, "MTZCλΛ").items()}
            if len(renamed) < len(sizes):
                raise DatasetError(
                    f"Import stopped at {path.name}: {image.path} has channels and wavelengths. {NOTHING_WRITTEN} "
                    "Export one of them as OME-TIFF."
                )
            planes += planes_in(path, renamed, series, partial(_read_lif, path, number), len(planes))
    if not planes:
        raise DatasetError(f"Import stopped at {path.name}: it holds no image of x and y. {NOTHING_WRITTEN}")
    if left_out:
        note = f"Of {path.name}, {', '.join(left_out)} was left out: it is no image of x and y."
        planes = [replace(plane, says=replace(plane.says, notes=(*plane.says.notes, note))) for plane in planes]
    return tuple(planes)


def _lif_axis(axis: str) -> str:
    return "C" if axis in "λΛ" else axis


def _read_lif(path: Path, number: int, name: str, where: Where) -> Image:
    import liffile

    with parser_errors_as(partial(damaged, name)), liffile.LifFile(path) as file:
        image: Any = file.images[number]
        at = {axis: where[_lif_axis(axis)] for axis in image.dims if _lif_axis(axis) in where}
        return as_grey(np.asarray(image.frame(**at)), name)


def _lif_statements(image: Any) -> Statements:
    def step(axis: str) -> Stated[float] | None:
        at = image.coords.get(axis)
        return None if at is None or len(at) < 2 else _length(np.mean(np.diff(at)), f"LIF {axis}", _UM_PER_M)

    settings = [one.attrib for one in image.xml_element.iter() if "ObjectiveName" in one.attrib]
    about = settings[0] if settings else {}
    taken = image.timestamps
    return Statements(
        pixel_um=step("X"),
        pixel_y_um=step("Y"),
        z_step_um=step("Z"),
        numerical_aperture=_length(about.get("NumericalAperture"), "LIF NumericalAperture"),
        objective=_text(about.get("ObjectiveName"), "LIF ObjectiveName"),
        taken=None if taken is None or not len(taken) else Stated(str(taken[0])[:19], "LIF TimeStamp"),
    )


def _lif_channels(image: Any) -> list[str]:
    """Return the names of the channels: their colours, or their wavelengths."""
    for axis in "λΛ":
        if axis in image.sizes and axis in image.coords:
            return [f"{m * 1e9:.4g} nm" for m in image.coords[axis]]
    names = [one.get("LUTName") or "" for one in image.xml_element.iter("ChannelDescription")]
    return [name if name and names.count(name) == 1 else f"channel {n}" for n, name in enumerate(names)]


def _lif_own(image: Any, place: Place) -> Own:
    own: Own = {}
    if (z_m := image.coords.get("Z")) is not None and "Z" in image.sizes:
        own["z_um"] = float(z_m[place.k]) * _UM_PER_M
    if (at_s := image.coords.get("T")) is not None and "T" in image.sizes and place.time < len(at_s):
        own["time_us"] = float(at_s[place.time]) * 1e6
    return own


# --- Olympus OIB and OIF

_OIF_NAME = re.compile(r"s_((?:[CZT]\d+)+)\.tif")


def planes_of_oif(path: Path) -> tuple[ImagePlane, ...]:
    """Return the planes of an Olympus OIB file, or of an OIF file with its folder. Raises DatasetError when damaged."""
    from oiffile import OifFile

    with parser_errors_as(partial(damaged, path.name)), OifFile(path) as file:
        places = {_oif_place(match[1]): name for name in file.glob() if (match := _OIF_NAME.fullmatch(Path(name).name))}
        if not places:
            raise ValueError("it holds no images")
        sizes = {axis: 1 + max(place[n] for place in places) for n, axis in enumerate("TZC")}
        about = {place: _oif_settings(file, name) for place, name in places.items()}
        first = about[min(about)]
        require_pixels(path.name, *(int(first["Image Parameters"][f"Image{side}"]) for side in ("Height", "Width")))
        series = Series(
            _oif_statements(file.mainfile, first),
            channels=[f"CH{n + 1}" for n in range(sizes["C"])],
            own=partial(_oif_own, about),
            simulated=states_simulated(str(file.mainfile)),
        )
        planes = planes_in(path, sizes, series, partial(_read_oif, path, places))
        is_there = [place in places for place in np.ndindex(*sizes.values())]
        return tuple(plane for plane, there in zip(planes, is_there, strict=True) if there)


def _oif_place(letters: str) -> tuple[int, int, int]:
    """Return time, z and channel of ``C001Z002T003``, from 0."""
    at = {letter: int(number) - 1 for letter, number in re.findall(r"([CZT])(\d+)", letters)}
    return at.get("T", 0), at.get("Z", 0), at.get("C", 0)


def _read_oif(path: Path, places: Mapping[tuple[int, int, int], str], name: str, where: Where) -> Image:
    from oiffile import OifFile

    with parser_errors_as(partial(damaged, name)), OifFile(path) as file:
        return as_grey(np.asarray(file.asarray(places[where["T"], where["Z"], where["C"]])), name)


def _oif_settings(file: Any, name: str) -> dict[str, Any]:
    from oiffile import SettingsFile

    with file.open_file(name.removesuffix(".tif") + ".pty") as content:
        return SettingsFile(content, name=name)


def _oif_statements(main: Mapping[str, Any], frame: Mapping[str, Any]) -> Statements:
    image, lens = frame["Image Parameters"], frame.get("Acquisition Parameters Common", {})
    z = main.get("Axis 3 Parameters Common", {})
    step = z.get("Interval") if z.get("MaxSize", 0) > 1 else None
    return Statements(
        pixel_um=_length(image.get("WidthConvertValue"), "OIF WidthConvertValue", _unit_um(image.get("WidthUnit"))),
        pixel_y_um=_length(
            image.get("HeightConvertValue"), "OIF HeightConvertValue", _unit_um(image.get("HeightUnit"))
        ),
        z_step_um=_length(step, "OIF Interval", _unit_um(z.get("UnitName"))),
        numerical_aperture=_length(lens.get("ObjectiveLens NAValue"), "OIF ObjectiveLens NAValue"),
        objective=_text(lens.get("ObjectiveLens Name"), "OIF ObjectiveLens Name"),
        taken=_text(main.get("Acquisition Parameters Common", {}).get("ImageCaputreDate"), "OIF ImageCaputreDate"),
    )


def _unit_um(unit: Any) -> float:
    """Return a unit of length in um; 0 if it is none."""
    return {"nm": 1e-3, "um": 1.0, "mm": 1e3}.get(str(unit), 0.0)


def _oif_own(about: Mapping[tuple[int, int, int], Mapping[str, Any]], place: Place) -> Own:
    z = about.get((place.time, place.k, place.channel), {}).get("Axis 3 Parameters", {})
    factor = _unit_um(z.get("AbsPositionUnitName"))
    return {"z_um": float(z["AbsPositionValue"]) * factor} if factor else {}
