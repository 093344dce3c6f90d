"""Complete run of a scan, in the process that owns the rig: frames go to a dataset, reports to `tell`."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Any

from wafer_viewer.acquire.motion import device_errors
from wafer_viewer.acquire.scan_runner import run_scan
from wafer_viewer.model.acquisition.devices import Rig
from wafer_viewer.model.errors import DatasetError, WaferViewerError
from wafer_viewer.session.acquisition.rig_messages import Scan, ScanEnded
from wafer_viewer.session.acquisition.scan_monitor import ScanWatch, Steering
from wafer_viewer.store.dataset.writer import DatasetWriter
from wafer_viewer.store.io.atomic_files import os_errors_as_dataset_errors
from wafer_viewer.store.records.calibrations import calibration_in_force


def writer_of(scan: Scan, rig: Rig) -> DatasetWriter:
    """Return the writer of a new dataset, or of the continued one. Raises DatasetError when it cannot be written."""
    if scan.goes_on:
        return DatasetWriter.resume(scan.path)
    return DatasetWriter.create(
        scan.path,
        scan.plan,
        scan.job,
        calibration=calibration_in_force(scan.path.absolute().parent, rig.name, rig.calibration),
        setup=rig.setup,
        rig=rig.name,
        simulated=rig.simulated,
        bits=rig.limits.camera.bits,
    )


def run_scan_job(
    scan: Scan, rig: Rig, writer: DatasetWriter, tell: Callable[[Any], None], steering: Steering
) -> ScanEnded:
    """Run a scan; a fault that ends it early becomes the `error` text, because its dataset can be continued."""
    watch = ScanWatch(writer, scan.plan, tell, steering)
    try:
        with device_errors("rig"):
            outcome = run_scan(scan.plan, rig, watch, watch, skip=writer.kept)
        if not outcome.stopped:
            with os_errors_as_dataset_errors(scan.path):
                writer.finish()
    except WaferViewerError as fault:
        return _scan_end_after_fault(scan, writer, fault)
    finally:
        watch.finish()
    return ScanEnded(scan.path, outcome.stopped, len(outcome.missing), error=None)


def _scan_end_after_fault(scan: Scan, writer: DatasetWriter, fault: WaferViewerError) -> ScanEnded:
    """Return the end of a scan after a fault; the dataset records the fault if it can still be written."""
    with suppress(DatasetError), os_errors_as_dataset_errors(scan.path):
        writer.fault(str(fault))
    return ScanEnded(scan.path, stopped=True, n_missing=0, error=str(fault))
