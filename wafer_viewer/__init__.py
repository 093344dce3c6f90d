"""Wafer Viewer: shape from focus over whole wafers, from the scan to the measured surface.

All names are loaded on first use, so that importing the package takes almost no time.
"""

from __future__ import annotations

import sys
import types
from typing import TYPE_CHECKING

from wafer_viewer._api import MODULES
from wafer_viewer._version import __version__

if TYPE_CHECKING:
    from wafer_viewer.measure.base.levelled_surface import levelled
    from wafer_viewer.measure.defects.inspection import golden_of_surface, inspect
    from wafer_viewer.measure.defects.repeaters import repeated_places
    from wafer_viewer.measure.dies.die_lattice import find_dies
    from wafer_viewer.measure.dies.die_status import statuses
    from wafer_viewer.measure.dies.given_lattice_fit import fitted_dies
    from wafer_viewer.measure.gauge.find_faces import find_faces
    from wafer_viewer.measure.gauge.gauge_check import gauge_check, gauge_repeat
    from wafer_viewer.measure.gauge.gauge_rr import gauge_rr, repeats_of, study_rr
    from wafer_viewer.measure.texture.areal_texture import texture
    from wafer_viewer.measure.texture.roughness import roughness
    from wafer_viewer.measure.tools.angle import face_angle
    from wafer_viewer.measure.tools.chipping import chipping
    from wafer_viewer.measure.tools.circle import circle_size
    from wafer_viewer.measure.tools.coplanarity import coplanarity
    from wafer_viewer.measure.tools.die_size import die_size
    from wafer_viewer.measure.tools.flatness import flatness
    from wafer_viewer.measure.tools.kerf import kerf_width
    from wafer_viewer.measure.tools.point import distance, point_height
    from wafer_viewer.measure.tools.profile import profile
    from wafer_viewer.measure.tools.radius import bump_radius
    from wafer_viewer.measure.tools.site_range import site_ranges
    from wafer_viewer.measure.tools.step_height import step_height
    from wafer_viewer.measure.tools.step_profile import step_profile
    from wafer_viewer.measure.tools.volume import area_volume
    from wafer_viewer.measure.truth_comparison import Quality, compare_with_truth
    from wafer_viewer.model.acquisition.calibration import Calibration
    from wafer_viewer.model.acquisition.characteristics import CalibrationRecord, CalibrationResult
    from wafer_viewer.model.acquisition.conformance import ConformanceReport
    from wafer_viewer.model.acquisition.focus_stack import FieldStack
    from wafer_viewer.model.acquisition.plan import Field, FieldGrid, FocusSweep, ScanPlan
    from wafer_viewer.model.acquisition.sample import Sample
    from wafer_viewer.model.errors import WaferViewerError
    from wafer_viewer.model.gauge import Certificate, GaugeCheck, GaugeRR, GaugeTerms
    from wafer_viewer.model.inspection.defect import DefectLimits, DefectRecipe
    from wafer_viewer.model.inspection.defect_verdict import verdict_of
    from wafer_viewer.model.inspection.die_grid import DieGrid
    from wafer_viewer.model.job import Job
    from wafer_viewer.model.measurement.levelling import Levelling
    from wafer_viewer.model.measurement.measurements import (
        AreaVolume,
        Chipping,
        CircleSize,
        Coplanarity,
        DieSize,
        Distance,
        FaceAngle,
        Flatness,
        KerfWidth,
        PointHeight,
        Profile,
        ProfileCurve,
        Radius,
        Roughness,
        StepHeight,
        StepProfile,
        Texture,
    )
    from wafer_viewer.model.measurement.tool_options import Conditions
    from wafer_viewer.model.quantity import Length, Quantity
    from wafer_viewer.model.region import Region
    from wafer_viewer.model.surface.field_poses import Poses
    from wafer_viewer.model.surface.focus_curve import FocusCurve
    from wafer_viewer.model.surface.height_map import HeightMap, Mosaic, Origin
    from wafer_viewer.model.surface.recipe import Recipe
    from wafer_viewer.reconstruct.comparison.compare import compare
    from wafer_viewer.reconstruct.field_pipeline import reconstruct
    from wafer_viewer.reconstruct.focus_evidence import focus_curve
    from wafer_viewer.reconstruct.stitching import stitch
    from wafer_viewer.rigs.rig_config import RigConfig
    from wafer_viewer.session.acquisition.conformance import check_conformance
    from wafer_viewer.session.acquisition.headless import go_to_focus
    from wafer_viewer.session.calibration.frames import CalibrationSite
    from wafer_viewer.session.calibration.headless import accept_calibration, run_calibration
    from wafer_viewer.session.gauge.repeat_scans import studies_of
    from wafer_viewer.session.reporting.conformance_report import verify_conformance, write_conformance
    from wafer_viewer.session.session import Session
    from wafer_viewer.session.surface.field_export import write_fields
    from wafer_viewer.store.dataset.dataset import Dataset
    from wafer_viewer.store.dataset.stack_import import import_dataset, open_stack
    from wafer_viewer.store.formats.exporters import export, write_surface
    from wafer_viewer.store.formats.npz_file import read_npz
    from wafer_viewer.store.formats.readers import read_surface
    from wafer_viewer.store.records.calibration_records import calibration_records
    from wafer_viewer.store.records.gauge_records import read_certificate
    from wafer_viewer.store.records.golden_dies import open_golden, save_golden
    from wafer_viewer.store.records.inspection_records import read_defect_recipe, save_defect_recipe
    from wafer_viewer.store.tables.klarf import read_klarf, write_klarf
    from wafer_viewer.store.tables.training_set import write_training_set

__all__ = [
    "AreaVolume",
    "Calibration",
    "CalibrationRecord",
    "CalibrationResult",
    "CalibrationSite",
    "Certificate",
    "Chipping",
    "CircleSize",
    "Conditions",
    "ConformanceReport",
    "Coplanarity",
    "Dataset",
    "DefectLimits",
    "DefectRecipe",
    "DieGrid",
    "DieSize",
    "Distance",
    "FaceAngle",
    "Field",
    "FieldGrid",
    "FieldStack",
    "Flatness",
    "FocusCurve",
    "FocusSweep",
    "GaugeCheck",
    "GaugeRR",
    "GaugeTerms",
    "HeightMap",
    "Job",
    "KerfWidth",
    "Length",
    "Levelling",
    "Mosaic",
    "Origin",
    "PointHeight",
    "Poses",
    "Profile",
    "ProfileCurve",
    "Quality",
    "Quantity",
    "Radius",
    "Recipe",
    "Region",
    "RigConfig",
    "Roughness",
    "Sample",
    "ScanPlan",
    "Session",
    "StepHeight",
    "StepProfile",
    "Texture",
    "WaferViewerError",
    "__version__",
    "accept_calibration",
    "area_volume",
    "bump_radius",
    "calibration_records",
    "check_conformance",
    "chipping",
    "circle_size",
    "compare",
    "compare_with_truth",
    "coplanarity",
    "die_size",
    "distance",
    "export",
    "face_angle",
    "find_dies",
    "find_faces",
    "fitted_dies",
    "flatness",
    "focus_curve",
    "gauge_check",
    "gauge_repeat",
    "gauge_rr",
    "go_to_focus",
    "golden_of_surface",
    "import_dataset",
    "inspect",
    "kerf_width",
    "levelled",
    "open_golden",
    "open_stack",
    "point_height",
    "profile",
    "read_certificate",
    "read_defect_recipe",
    "read_klarf",
    "read_npz",
    "read_surface",
    "reconstruct",
    "repeated_places",
    "repeats_of",
    "roughness",
    "run_calibration",
    "save_defect_recipe",
    "save_golden",
    "site_ranges",
    "statuses",
    "step_height",
    "step_profile",
    "stitch",
    "studies_of",
    "study_rr",
    "texture",
    "verdict_of",
    "verify_conformance",
    "write_conformance",
    "write_fields",
    "write_klarf",
    "write_surface",
    "write_training_set",
]


def __getattr__(name: str) -> object:
    if name not in MODULES:
        raise AttributeError(f"module 'wafer_viewer' has no attribute {name!r}")
    import importlib

    found = getattr(importlib.import_module(f"wafer_viewer.{MODULES[name]}"), name)
    return globals().setdefault(name, found)


def __dir__() -> list[str]:
    return sorted(__all__)


class _Api(types.ModuleType):
    """Module type that keeps the function `reconstruct` when the subpackage of the same name is imported."""

    def __setattr__(self, name: str, value: object) -> None:
        if not (name in MODULES and isinstance(value, types.ModuleType)):
            super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Api
