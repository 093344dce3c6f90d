"""Texture and roughness as Gwyddion, SurfaceTopography and surfalize have them, on surfaces that anyone can make again.

    python tests/bench/texture_peers.py [--quick] [--all]

Parameter by parameter: how far the worst of the surfaces is off a peer, in per cent; --all prints every value. A peer
that is not installed is left out and named: apt install gwyddion, pip install SurfaceTopography surfalize.
Gwyddion's own library is called, the one that its program calls; nothing of it is linked or copied.
"""

from __future__ import annotations

import ctypes
import ctypes.util
import importlib.util
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from tests.bench.harness import read_options, show
from tests.support.surfaces import height_map
from wafer_viewer.measure.texture.areal_texture import developed_fraction, scale_limited, texture
from wafer_viewer.measure.texture.roughness import roughness
from wafer_viewer.model.measurement.tool_options import TextureOptions
from wafer_viewer.model.region import Region
from wafer_viewer.model.surface.height_map import HeightMap
from wafer_viewer.numerics.filters.gaussian import ALPHA

PIXEL_UM = 0.5
QUICK_PX, FULL_PX = 256, 1000
S_UM, L_UM = 4.0, 40.0
AGREES = 0.1
"""Per cent; what is off by more is marked."""
MATERIAL_CLASSES = 100_000
"""surfalize ends peaks and valleys at the nearest class: with its 10 000 Spk is off by up to .3 %."""
WHY = {
    "Gwyddion": "Sdr: it counts half a pixel more all round, flatter than the rest; with a level border we agree.",
    "SurfaceTopography": "Sdq: it leaves out the last row and column.",
    "surfalize": "Sdr: it halves each square both ways, Gwyddion and we make four triangles about its middle. "
    "Sal, Str: it looks along lattice points only.",
}
"""Where definitions differ; the norm leaves these open."""
Floats = NDArray[np.float64]
Values = dict[str, float]


def main() -> None:
    asked = read_options(__doc__, all=False)
    surfaces = made(QUICK_PX if asked.quick else FULL_PX)
    own = {name: ours(z_um) for name, z_um in surfaces.items()}
    for peer, (found, how) in PEERS.items():
        if not found():
            print(f"{peer} is not installed ({how}): left out.")
            continue
        told = {name: values for name, z_um in surfaces.items() if (values := PEER_VALUES[peer](z_um))}
        show(f"{peer}: deviation, per cent", ["parameter", *told, "worst"], _deviations(own, told))
        print(f"  {WHY[peer]}")
        if asked.all:
            show(f"{peer}: ours, theirs", ["parameter", *told], _values(own, told))


def made(n: int) -> dict[str, Floats]:
    """Surfaces [row, col] in um: even, with a lay, of all scales, honed plateaus, a regular one, and one with holes."""
    rng = np.random.default_rng(7)
    y_um, x_um = np.mgrid[:n, :n] * PIXEL_UM
    plane = 0.004 * x_um - 0.003 * y_um + 12

    def noise(*sigma_px: float) -> Floats:
        even = gaussian_filter(rng.normal(size=(n, n)), sigma_px, mode="wrap")
        return even / even.std()

    fractal = _fractal(rng, n)
    scratches = np.minimum(0, noise(60, 1) + 0.8 * noise(1, 60) + 1.2)
    egg = np.sin(2 * np.pi * x_um / 12.3) * np.sin(2 * np.pi * y_um / 9.1)
    turned = np.sin(2 * np.pi * (0.8 * x_um + 0.6 * y_um) / 10)
    holed = 0.3 * noise(4, 4)
    holed[rng.random((n, n)) < 0.2] = np.nan
    holed[n // 4 : n // 2, n // 3 : n // 2] = np.nan
    return {
        "even": 0.3 * noise(4, 4) + plane,
        "with a lay": 0.5 * noise(25, 3) + plane,
        "all scales": 0.8 * fractal + plane,
        "honed": 0.6 * scratches + 0.05 * noise(2, 2) + plane,
        "egg box": 0.4 * egg + plane,
        "grating": 0.2 * turned + 0.05 * noise(3, 3) + plane,
        "20 % holes": holed + plane,
    }


def _fractal(rng: np.random.Generator, n: int) -> Floats:
    """Self-affine, Hurst exponent 0.8, down to eight pixels."""
    f = np.hypot(np.fft.fftfreq(n)[:, None], np.fft.rfftfreq(n)[None, :])
    f[0, 0] = np.inf
    spectrum = f**-1.8 * np.exp(-((8 * f) ** 2))
    z = np.fft.irfft2(spectrum * np.exp(2j * np.pi * rng.random(spectrum.shape)), (n, n))
    return z / z.std()


def ours(z_um: Floats) -> Values:
    """Every parameter as the Python API gives it; filters away from the border, where peers end them differently."""
    n = len(z_um)
    side_um = (n - 1) * PIXEL_UM
    surface = as_map(z_um)
    found = texture(surface, Region.rectangle(0, 0, side_um, side_um))
    values = {name: _number(getattr(found, field)) for name, field in FIELDS.items()}
    inner = _inner(n)
    values[LEVEL_BORDER] = _number(developed_fraction(_fading(z_um), PIXEL_UM))
    for name, options in FILTERED.items():
        left = scale_limited(z_um, PIXEL_UM, options)[inner]
        values[name] = float(np.sqrt(np.nanmean((left - np.nanmean(left)) ** 2)))
    if np.isfinite(row := z_um[n // 2]).all():
        line = roughness(as_map(row[None, :]), Region.line(0, 0, side_um, 0))
        values |= {"Ra": line.ra.value_um, "Rq": line.rq.value_um, "Rt": line.rt.value_um}
    return values


FIELDS = {
    **{name: name.lower() for name in ("Sa", "Sq", "Sp", "Sv", "Sz", "Ssk", "Sku", "Sdq", "Sk", "Spk", "Svk", "Sal")},
    "Sdr": "sdr_fraction",
    "Smr1": "smr1_fraction",
    "Smr2": "smr2_fraction",
    "Str": "str_ratio",
    "Std": "std",
}
LEVEL_BORDER = "Sdr, level border"
FILTERED = {
    f"Sq, S {S_UM:g} um": TextureOptions(s_filter_um=S_UM),
    f"Sq, L {L_UM:g} um": TextureOptions(l_filter_um=L_UM),
    "Sq, form 3": TextureOptions(form_order=3),
}


def as_map(z_um: Floats) -> HeightMap:
    return height_map(z_um, PIXEL_UM, y0_um=(len(z_um) - 1) * PIXEL_UM)


def gwyddion(z_um: Floats) -> Values:
    """By the library of the program: masked heights, its own plane, its own filters."""
    gwy = Gwyddion(z_um)
    gwy.level()
    ra, rms, skew, kurtosis = gwy.statistics()
    low, high, mean = gwy.extremes()
    values = {"Sa": ra, "Sq": rms, "Sp": high - mean, "Sv": mean - low, "Sz": high - low, "Ssk": skew}
    values |= {"Sku": kurtosis + 3, "Sdq": gwy.slope()}
    if np.isfinite(z_um).all():  # of a masked area it counts the heights that lie under the mask
        values |= {"Sdr": gwy.developed_fraction(), LEVEL_BORDER: _level_border_sdr(z_um)}
        values |= gwy.filtered() | gwy.profile(len(z_um) // 2)
    return values


def _level_border_sdr(z_um: Floats) -> float:
    """Of the same heights fading out, over the squares between pixels as we count them: its strips are level then."""
    n = len(z_um)
    return Gwyddion(_fading(z_um)).developed_fraction() * (n / (n - 1)) ** 2


class Gwyddion:
    """A data field of Gwyddion with its mask, through ctypes; lengths in um."""

    INCLUDE = 1

    def __init__(self, z_um: Floats) -> None:
        self._lib = _library()
        self._n = len(z_um)
        known = np.isfinite(z_um)
        self._field = self._new(np.where(known, z_um, 0.0))
        self._mask = self._new(known.astype(np.float64))
        self._all = (0, 0, self._n, self._n)

    def level(self) -> None:
        """Take its own plane off the measured points."""
        a, bx, by = (ctypes.c_double() for _ in range(3))
        fit = self._lib.gwy_data_field_area_fit_plane_mask
        fit(self._field, self._mask, self.INCLUDE, *self._all, *map(ctypes.byref, (a, bx, by)))
        self._lib.gwy_data_field_plane_level(self._field, *map(ctypes.c_double, (a.value, bx.value, by.value)))

    def statistics(self) -> tuple[float, float, float, float]:
        """Ra, rms, skewness, excess kurtosis."""
        told = [ctypes.c_double() for _ in range(5)]
        get = self._lib.gwy_data_field_area_get_stats_mask
        get(self._field, self._mask, self.INCLUDE, *self._all, *map(ctypes.byref, told))
        return tuple(value.value for value in told[1:])  # type: ignore[return-value]

    def extremes(self) -> tuple[float, float, float]:
        """Lowest, highest and mean height."""
        low, high, mean = (ctypes.c_double() for _ in range(3))
        get = self._lib.gwy_data_field_area_get_min_max_mask
        get(self._field, self._mask, self.INCLUDE, *self._all, ctypes.byref(low), ctypes.byref(high))
        stats = self._lib.gwy_data_field_area_get_stats_mask
        stats(self._field, self._mask, self.INCLUDE, *self._all, ctypes.byref(mean), None, None, None, None)
        return low.value, high.value, mean.value

    def slope(self) -> float:
        """Sdq."""
        return float(
            self._lib.gwy_data_field_area_get_surface_slope_mask(self._field, self._mask, self.INCLUDE, *self._all)
        )

    def developed_fraction(self) -> float:
        """Sdr; strips of half a pixel round the border are in it, which slope along the border only."""
        area = float(self._lib.gwy_data_field_area_get_surface_area(self._field, None, *self._all))
        return area / (self._n * PIXEL_UM) ** 2 - 1

    def filtered(self) -> Values:
        """Sq of the middle after its Gaussian filter and after its polynomial."""
        z_um, inner = self._read(self._field), _inner(self._n)
        values: Values = {}
        for (name, options), cutoff_um in zip(FILTERED.items(), (S_UM, L_UM, None), strict=True):
            field = self._new(z_um)
            if cutoff_um is None:
                powers = [(i, j) for i in range(4) for j in range(4 - i)]
                self._subtract(field, powers)
                left = self._read(field)
            else:
                sigma = ctypes.c_double(ALPHA * cutoff_um / PIXEL_UM / np.sqrt(2 * np.pi))
                self._lib.gwy_data_field_filter_gaussian(field, sigma)
                left = self._read(field) if options.s_filter_um else z_um - self._read(field)
            values[name] = float(left[inner].std())
        return values

    def profile(self, row: int) -> Values:
        """Ra, Rq, Rt of a row about its own straight line."""
        lib = self._lib
        line = lib.gwy_data_line_new(self._n, ctypes.c_double(self._n * PIXEL_UM), 0)
        self._fill(lib.gwy_data_line_get_data(line), self._read(self._field)[row])
        a, b = ctypes.c_double(), ctypes.c_double()
        lib.gwy_data_line_get_line_coeffs(line, ctypes.byref(a), ctypes.byref(b))
        lib.gwy_data_line_line_level(line, a, b)
        rt = float(lib.gwy_data_line_get_max(line)) - float(lib.gwy_data_line_get_min(line))
        return {"Ra": float(lib.gwy_data_line_get_ra(line)), "Rq": float(lib.gwy_data_line_get_rms(line)), "Rt": rt}

    def _subtract(self, field: int, powers: list[tuple[int, int]]) -> None:
        flat = (ctypes.c_int * (2 * len(powers)))(*(p for pair in powers for p in pair))
        coefficients = (ctypes.c_double * len(powers))()
        self._lib.gwy_data_field_fit_poly(field, None, len(powers), flat, 0, coefficients)
        self._lib.gwy_data_field_subtract_poly(field, len(powers), flat, coefficients)

    def _new(self, z: Floats) -> int:
        side = ctypes.c_double(self._n * PIXEL_UM)
        field: int = self._lib.gwy_data_field_new(self._n, self._n, side, side, 0)
        self._fill(self._lib.gwy_data_field_get_data(field), z)
        return field

    def _fill(self, at: Any, z: Floats) -> None:
        np.ctypeslib.as_array(at, (z.size,))[:] = z.ravel()

    def _read(self, field: int) -> Floats:
        data = self._lib.gwy_data_field_get_data(field)
        return np.ctypeslib.as_array(data, (self._n * self._n,)).reshape(self._n, self._n).copy()


def _library() -> Any:
    """Gwyddion's library of data processing; every pointer is 64 bits wide."""
    ctypes.CDLL(ctypes.util.find_library("gwyddion2") or "libgwyddion2.so.0", ctypes.RTLD_GLOBAL)
    lib = ctypes.CDLL(ctypes.util.find_library("gwyprocess2") or "libgwyprocess2.so.0")
    pointer, real = ctypes.c_void_p, ctypes.c_double
    for name in ("gwy_data_field_new", "gwy_data_line_new"):
        getattr(lib, name).restype = pointer
    for name in ("gwy_data_field_get_data", "gwy_data_line_get_data"):
        getattr(lib, name).restype, getattr(lib, name).argtypes = ctypes.POINTER(real), [pointer]
    masked = [pointer, pointer, *[ctypes.c_int] * 5]
    slope, area = lib.gwy_data_field_area_get_surface_slope_mask, lib.gwy_data_field_area_get_surface_area
    slope.restype, slope.argtypes = real, masked
    area.restype, area.argtypes = real, [pointer, pointer, *[ctypes.c_int] * 4]
    lib.gwy_data_field_area_get_stats_mask.argtypes = [*masked, *[pointer] * 5]
    lib.gwy_data_field_area_get_min_max_mask.argtypes = [*masked, pointer, pointer]
    lib.gwy_data_field_area_fit_plane_mask.argtypes = [*masked, *[pointer] * 3]
    lib.gwy_data_field_plane_level.argtypes = [pointer, real, real, real]
    lib.gwy_data_field_filter_gaussian.argtypes = [pointer, real]
    lib.gwy_data_field_fit_poly.argtypes = [pointer, pointer, ctypes.c_int, pointer, ctypes.c_int, pointer]
    lib.gwy_data_field_fit_poly.restype = pointer
    lib.gwy_data_field_subtract_poly.argtypes = [pointer, ctypes.c_int, pointer, pointer]
    lib.gwy_data_line_get_line_coeffs.argtypes = [pointer, pointer, pointer]
    lib.gwy_data_line_line_level.argtypes = [pointer, real, real]
    for name in ("ra", "rms", "max", "min"):
        function = getattr(lib, f"gwy_data_line_get_{name}")
        function.restype, function.argtypes = real, [pointer]
    return lib


def surface_topography(z_um: Floats) -> Values:
    """Heights, slopes and the profile; it takes masked heights, and its own plane of least squares."""
    from SurfaceTopography import Topography, UniformLineScan  # pyright: ignore[reportMissingImports]

    n = len(z_um)
    side = n * PIXEL_UM
    held = Topography(np.ma.masked_invalid(z_um.T), (side, side), unit="um")
    left = held.detrend("height")
    heights = np.ma.compressed(left.heights())
    values: Values = {"Sq": float(left.Sq()), "Sz": float(np.ptp(heights))}
    if len(heights) == z_um.size:
        values["Sdq"] = float(left.rms_gradient())
        line = UniformLineScan(z_um[n // 2] - z_um[n // 2].mean(), side, unit="um").detrend("height")
        values["Rq"] = float(line.Rq())
    return values


def surfalize(z_um: Floats) -> Values:
    """Everything, of surfaces without holes: it refuses those with some."""
    from surfalize import Surface  # pyright: ignore[reportMissingImports]
    from surfalize.abbottfirestone import AbbottFirestoneCurve  # pyright: ignore[reportMissingImports]

    if not np.isfinite(z_um).all():
        return {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        surface = Surface(z_um, PIXEL_UM, PIXEL_UM).level().center()
        values = {name: float(getattr(surface, name)()) for name in FIELDS}
        curve = AbbottFirestoneCurve(surface, nbins=MATERIAL_CLASSES)
    values |= {"Sk": curve.k(), "Spk": curve.pk(), "Svk": curve.vk(), "Smr1": curve.mr1(), "Smr2": curve.mr2()}
    return values | {name: values[name] / 100 for name in ("Sdr", "Smr1", "Smr2")}


PEER_VALUES: dict[str, Callable[[Floats], Values]] = {
    "Gwyddion": gwyddion,
    "SurfaceTopography": surface_topography,
    "surfalize": surfalize,
}


def _fading(z_um: Floats) -> Floats:
    """Heights over their mean that fade out towards the border."""
    return (z_um - np.nanmean(z_um)) * np.outer(np.hanning(len(z_um)), np.hanning(len(z_um)))


def _has_gwyddion() -> bool:
    try:
        _library()
    except OSError:
        return False
    return True


PEERS: dict[str, tuple[Callable[[], bool], str]] = {
    "Gwyddion": (_has_gwyddion, "apt install gwyddion"),
    "SurfaceTopography": (
        lambda: importlib.util.find_spec("SurfaceTopography") is not None,
        "pip install SurfaceTopography",
    ),
    "surfalize": (lambda: importlib.util.find_spec("surfalize") is not None, "pip install surfalize"),
}


def _deviations(own: dict[str, Values], told: dict[str, Values]) -> list[list[str]]:
    """A line a parameter; angles in degrees, for their zero is anywhere."""
    rows: list[list[str]] = []
    for parameter in dict.fromkeys(name for values in told.values() for name in values):
        off = [_off(parameter, own[name].get(parameter), values.get(parameter)) for name, values in told.items()]
        worst = max((value for value in off if value is not None), default=None)
        mark = "" if worst is None or worst <= AGREES else "  *"
        rows.append([parameter, *(_text(value) for value in off), _text(worst) + mark])
    return rows


def _off(parameter: str, mine: float | None, theirs: float | None) -> float | None:
    if mine is None or theirs is None or not np.isfinite(mine) or not np.isfinite(theirs):
        return None
    if parameter == "Std":
        return abs((mine - theirs + 90) % 180 - 90)
    # A skewness near to zero is compared with that of normal heights' scatter, one.
    return 100 * abs(mine - theirs) / (max(1.0, abs(theirs)) if parameter == "Ssk" else abs(theirs))


def _values(own: dict[str, Values], told: dict[str, Values]) -> list[list[str]]:
    parameters = dict.fromkeys(name for values in told.values() for name in values)
    return [
        [name, *(f"{own[of].get(name, np.nan):.6g}, {values.get(name, np.nan):.6g}" for of, values in told.items())]
        for name in parameters
    ]


def _text(value: float | None) -> str:
    return "-" if value is None else f"{value:.4f}"


def _number(value: Any) -> float:
    if value is None:
        return float("nan")
    return float(getattr(value, "value_um", getattr(value, "value", value)))


def _inner(n: int) -> tuple[slice, slice]:
    """Further from the border than filters reach."""
    margin = int(L_UM / PIXEL_UM)
    return slice(margin, n - margin), slice(margin, n - margin)


if __name__ == "__main__":
    main()
