"""Table of the surface files of instrument makers, which SurfaceTopography reads."""

from __future__ import annotations

from dataclasses import dataclass

from wafer_viewer.model.surface_format import SurfaceFormat


@dataclass(frozen=True, slots=True)
class MakerFile:
    """Kind of file of a maker.

    suffixes: lower-case suffixes with their dot. title: as in "it is a Zygo MetroPro DAT file". reader: its name in
    SurfaceTopography. magic: first bytes, one of which each file has; none for a kind that is known by its suffix only.
    """

    title: str
    reader: str
    suffixes: tuple[str, ...]
    magic: tuple[bytes, ...] = ()


MAKER_FILES = (
    MakerFile("Alicona AL3D", "al3d", (".al3d",), (b"AliconaImaging\0\r\n",)),
    MakerFile("Digital Surf SUR", "sur", (".sur", ".pro"), (b"DIGITAL SURF", b"DSCOMPRESSED")),
    MakerFile("Digital Surf MNT", "mnt", (".mnt",)),
    MakerFile("ISO 25178-71 SDF", "sdf", (".sdf",), (b"aISO-1.0", b"bISO-1.0")),
    MakerFile("Keyence VK", "vk", (".vk3", ".vk4", ".vk6", ".vk7"), (b"VK3_", b"VK4_", b"VK6", b"VK7")),
    MakerFile("Keyence ZON", "zon", (".zon",), (b"KPK0", b"KPK1")),
    MakerFile("KLA Zeta ZMG", "zmg", (".zmg",), (b"Zeta-Instruments",)),
    MakerFile("FRT MicroProf", "frt", (".frt",), (b"FRTM_GLIDERV",)),
    MakerFile("NanoFocus NMS", "nms", (".nms",)),
    MakerFile("Olympus LEXT", "lext", (".lext",)),
    MakerFile("OmniSurf3D", "os3d", (".os3d",), (b"OmniSurf3D",)),
    MakerFile("Sensofar PLU", "plu", (".plu", ".apx")),
    MakerFile("Sensofar PLUX", "plux", (".plux",)),
    MakerFile("TrueMap TMD", "tmd", (".tmd",), (b"Binary TrueMap Data File v2.0",)),
    MakerFile("Wyko OPD", "opd", (".opd",), (b"\1\0Directory",)),
    MakerFile("Bruker Dektak OPDx", "opdx", (".opdx",), (b"VCA DATA\1\0\0\x55",)),
    MakerFile("Zygo MetroPro DAT", "metropro", (".dat",), (b"\x88\x1b\x03o", b"\x88\x1b\x03p", b"\x88\x1b\x03q")),
    MakerFile("Zygo DATX", "datx", (".datx",), (b"\x89HDF\r\n\x1a\n",)),
    MakerFile("MATLAB MAT", "mat", (".mat",), (b"MATLAB ",)),
    MakerFile("Bruker Nanoscope", "di", (".spm",), (b"\\*File list", b"?*File list", b"\\*Force file list")),
    MakerFile("Asylum (Igor) IBW", "ibw", (".ibw",)),
    MakerFile("Keysight MI", "mi", (".mi",), (b"fileType",)),
    MakerFile("Nanosurf NID", "ezd", (".nid", ".ezd"), (b"[DataSet]",)),
    MakerFile("NT-MDT", "mdt", (".mdt",), (b"\1\xb0\x93\xff",)),
)
MAKER_FORMAT = SurfaceFormat(
    suffixes=tuple(suffix for kind in MAKER_FILES for suffix in kind.suffixes),
    title="Files of instrument makers",
    layout="as in the file; by `pip install 'wafer-viewer[surfaces]'`",
    reader="wafer_viewer.store.formats.maker_files:read_maker_file",
    magic=tuple(magic for kind in MAKER_FILES for magic in kind.magic),
)
