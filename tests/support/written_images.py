"""A small focus stack in every image format that can be written here, with a text about it where the format has one."""

from __future__ import annotations

import gc
import struct
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray
from PIL import Image, PngImagePlugin

STEP_UM, PIXEL_UM, EXPOSURE_MS = 2.5, 0.65, 12.0
Stack = NDArray[np.uint16] | NDArray[np.uint8]
REASON = "pip install -e '.[dev]'"


def tiff(folder: Path, images: Stack, text: str) -> Path:
    path = folder / "stack.tif"
    words = {"axes": "ZYX", "spacing": STEP_UM, "unit": "um", "Info": text}
    tifffile.imwrite(path, images, imagej=True, resolution=(1 / PIXEL_UM, 1 / PIXEL_UM), metadata=words)
    return path


def _one_by_one(folder: Path, images: Stack, ending: str, save: Callable[[Image.Image, Path], None]) -> Path:
    for k, image in enumerate(images):
        save(Image.fromarray(image), folder / f"f{k}{ending}")
    return folder


def png(folder: Path, images: Stack, text: str) -> Path:
    about = PngImagePlugin.PngInfo()
    about.add_text("Description", text)
    return _one_by_one(folder, images, ".png", lambda image, path: image.save(path, pnginfo=about))


def jpeg(folder: Path, images: Stack, text: str) -> Path:
    return _one_by_one(folder, images, ".jpg", lambda image, path: image.save(path, comment=text, quality=100))


def bmp(folder: Path, images: Stack, _: str) -> Path:
    return _one_by_one(folder, images, ".bmp", lambda image, path: image.save(path))


def pgm(folder: Path, images: Stack, text: str) -> Path:
    for k, image in enumerate(images):
        head = f"P5\n# {text}\n{image.shape[1]} {image.shape[0]}\n255\n"
        (folder / f"f{k}.pgm").write_bytes(head.encode() + image.tobytes())
    return folder


def webp(folder: Path, images: Stack, text: str) -> Path:
    about = Image.Exif()
    about[0x010E] = text
    return _one_by_one(folder, images, ".webp", lambda image, path: image.save(path, exif=about, lossless=True))


def czi(folder: Path, images: Stack, text: str) -> Path:
    api = pytest.importorskip("pylibCZIrw.czi", reason=REASON)
    path = folder / "stack.czi"
    with api.create_czi(str(path)) as file:
        for k, image in enumerate(images):
            file.write(np.ascontiguousarray(image[:, :, None]), plane={"Z": k, "C": 0, "T": 0})
        file.write_metadata(text or "stack", None, *(um * 1e-6 for um in (PIXEL_UM, PIXEL_UM, STEP_UM)))
    return path


_LIF = """<LMSDataContainerHeader Version="2"><Element Name="file" Visibility="1"><Children>
<Element Name="{name}" Visibility="1" UniqueID="u1"><Data><Image TextDescription="{text}"><ImageDescription><Channels>
<ChannelDescription DataType="0" ChannelTag="0" Resolution="{bits}" NameOfMeasuredQuantity="" Min="0"
Max="1" Unit="" LUTName="Gray" IsLUTInverted="0" BytesInc="0" BitInc="0"/></Channels>
<Dimensions>{dimensions}</Dimensions></ImageDescription>
<Attachment Name="HardwareSetting"><ATLConfocalSettingDefinition ObjectiveName="HC PL 20x" NumericalAperture="0.5"/>
</Attachment></Image></Data><Memory Size="{size}" MemoryBlockID="MemBlock_1"/></Element></Children></Element>
</LMSDataContainerHeader>"""
_LIF_AXIS = (
    '<DimensionDescription DimID="{}" NumberOfElements="{}" Origin="0" Length="{}" Unit="m" BitInc="0" BytesInc="{}"/>'
)


def lif(folder: Path, images: Stack, text: str) -> Path:
    pytest.importorskip("liffile", reason=REASON)
    n, rows, cols = images.shape
    size = images.dtype.itemsize
    axes = ((1, cols, PIXEL_UM, size), (2, rows, PIXEL_UM, size * cols), (3, n, STEP_UM, size * cols * rows))
    dimensions = "".join(_LIF_AXIS.format(axis, m, (m - 1) * um * 1e-6, by) for axis, m, um, by in axes)
    xml = _LIF.format(name="stack", text=text, bits=8 * size, dimensions=dimensions, size=images.nbytes)
    head, block = xml.encode("utf-16-le"), "MemBlock_1".encode("utf-16-le")
    path = folder / "stack.lif"
    path.write_bytes(
        struct.pack("<iibi", 0x70, 5 + len(head), 0x2A, len(head) // 2)
        + head
        + struct.pack("<iibqbi", 0x70, 14 + len(block), 0x2A, images.nbytes, 0x2A, len(block) // 2)
        + block
        + images.tobytes()
    )
    return path


_OIF = """[Axis Parameter Common]
AxisCount=3
AxisOrder="XYZ"
[Axis 3 Parameters Common]
AxisCode="Z"
Interval={step}
MaxSize={n}
UnitName="nm"
[Acquisition Parameters Common]
ImageCaputreDate='2024-05-06 07:08:09'
[File Info]
UserComment="{text}"
[ProfileSaveInfo]
Name="COFAImages"
Version="2.0.0.0"
"""
_PTY = """[Acquisition Parameters Common]
ObjectiveLens NAValue=0.75
ObjectiveLens Name="UPLFLN   40X"
[Axis 3 Parameters]
AbsPositionUnitName="nm"
AbsPositionValue={z}
[Image Parameters]
HeightConvertValue={pixel}
HeightUnit="um"
ImageHeight={rows}
ImageWidth={cols}
WidthConvertValue={pixel}
WidthUnit="um"
"""


def oif(folder: Path, images: Stack, text: str) -> Path:
    pytest.importorskip("oiffile", reason=REASON)
    path, beside = folder / "stack.oif", folder / "stack.oif.files"
    beside.mkdir()
    path.write_text(_OIF.format(step=1e3 * STEP_UM, n=len(images), text=text), encoding="utf-16")
    for k, image in enumerate(images):
        tifffile.imwrite(beside / f"s_C001Z{k + 1:03d}.tif", image)
        words = _PTY.format(z=1e3 * k * STEP_UM, pixel=PIXEL_UM, rows=image.shape[0], cols=image.shape[1])
        (beside / f"s_C001Z{k + 1:03d}.pty").write_text(words, encoding="utf-16")
    return path


def zarr_04(folder: Path, images: Stack, text: str) -> Path:
    return _zarr(folder / "stack.ome.zarr", images, text, 2)


def zarr_05(folder: Path, images: Stack, text: str) -> Path:
    return _zarr(folder / "stack5.ome.zarr", images, text, 3)


def _zarr(path: Path, images: Stack, text: str, zarr_format: int) -> Path:
    import zarr

    group = zarr.open_group(str(path), mode="w", zarr_format=zarr_format)
    group.create_array("0", data=images[None], chunks=(1, 1, *images.shape[1:]))
    axes = [{"name": "c", "type": "channel"}]
    axes += [{"name": name, "type": "space", "unit": "micrometer"} for name in "zyx"]
    scale = [{"type": "scale", "scale": [1, STEP_UM, PIXEL_UM, PIXEL_UM]}]
    multiscale = {"axes": axes, "datasets": [{"path": "0", "coordinateTransformations": scale}], "name": text}
    about = {"multiscales": [{**multiscale, "version": "0.4"}]}
    group.attrs.update(about if zarr_format == 2 else {"ome": {"version": "0.5", "multiscales": [multiscale]}})
    return path


def ndtiff(folder: Path, images: Stack, text: str) -> Path:
    api = pytest.importorskip("ndtiff.ndtiff_dataset", reason=REASON)
    with warnings.catch_warnings(action="ignore"):  # it leaves a file open
        data = api.NDTiffDataset(str(folder), summary_metadata={"comment": text}, name="stack", writable=True)
        for k in np.random.default_rng(0).permutation(len(images)):
            words = {"Exposure": EXPOSURE_MS, "PixelSizeUm": PIXEL_UM, "ZPosition_um_Intended": 50 + k * STEP_UM}
            data.put_image({"z": int(k), "channel": "BF"}, images[k].astype(np.uint16), words)
        data.finish()
        data.close()
        del data
        gc.collect()
    return folder / "stack_1"


def video(folder: Path, images: Stack, text: str) -> Path:
    av = pytest.importorskip("av", reason=REASON)
    path = folder / "stack.mkv"
    with av.open(str(path), "w") as container:
        container.metadata["comment"] = text
        stream = container.add_stream("ffv1", rate=25)
        stream.height, stream.width = images.shape[1:]
        stream.pix_fmt = "gray"
        for image in images:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, "gray")))
        container.mux(stream.encode())
    return path


_CFA, _PATTERN = 32803, (0, 1, 1, 2)
"""Photometric interpretation of a sensor behind red, green, green and blue filters."""


def dng(folder: Path, images: Stack, text: str) -> Path:
    pytest.importorskip("rawpy", reason=REASON)
    tags = [
        (50706, "B", 4, (1, 4, 0, 0), True),  # version
        (50708, "s", 0, "Test camera", True),
        (33421, "H", 2, (2, 2), True),
        (33422, "B", 4, _PATTERN, True),
        (50714, "H", 1, 0, True),  # black level
        (50717, "H", 1, 65535, True),  # white level
        (50721, "2i", 9, (1, 1, 0, 1, 0, 1, 0, 1, 1, 1, 0, 1, 0, 1, 0, 1, 1, 1), True),  # colour matrix
        (33434, "2I", 1, (12, 1000), True),  # exposure
    ]
    for k, image in enumerate(images):
        path = folder / f"f{k}.dng"
        tifffile.imwrite(path, image, photometric=_CFA, description=text, metadata=None, extratags=tags)
    return folder


WRITERS = {
    function.__name__: function
    for function in (tiff, png, jpeg, bmp, pgm, webp, czi, lif, oif, zarr_04, zarr_05, ndtiff, video, dng)
}
"""Function of each format: writes a stack into a folder, with a text, and returns what is to be opened."""
BYTES = ("png", "jpeg", "bmp", "pgm", "webp", "video")
"""Formats that are written with 8 bits."""
