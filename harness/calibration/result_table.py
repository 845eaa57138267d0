"""A calibration as one table of plain numbers, the contents of its JSON file."""

from typing import Any

import numpy as np

from harness.calibration.corner_files import corner_tables
from harness.calibration.sensor_calibration import SensorCalibration
from harness.geometry.angles import Array
from harness.spec import as_table
from harness.version import __version__


def record_of(calibration: SensorCalibration) -> dict[str, Any]:
    """A calibration as a table of plain values. `images` and the size are in the layout of `read_corners`.

    Numbers that are not finite are None.
    """
    uncertainty, corners, coverage = calibration.uncertainty, calibration.corners, calibration.coverage
    ends = [*corners.starts.tolist(), len(corners.image)]
    images = corner_tables(corners)
    for i, (table, rms) in enumerate(zip(images, calibration.rms_of_images_px.tolist(), strict=True)):
        table["residuals_px"] = calibration.residuals[ends[i] : ends[i + 1]].tolist()
        table["rms_px"] = rms
        table["R_sensor_from_board"] = calibration.poses.R[i].tolist()
        table["t_sensor_m"] = calibration.poses.t[i].tolist()
    table = {
        "program": f"omnirange {__version__}",
        "width_px": corners.width_px,
        "height_px": corners.height_px,
        "sensor": as_table(calibration.sensor),
        "rms_px": calibration.rms_px,
        "sigma_px": uncertainty.sigma_px,
        "corners": len(corners.image),
        "parameters": [
            {"key": key, "value": value, "sigma": sigma}
            for key, value, sigma in zip(
                calibration.keys, uncertainty.values.tolist(), uncertainty.sigma.tolist(), strict=True
            )
        ],
        "covariance": uncertainty.covariance.tolist(),
        "correlation": uncertainty.correlation.tolist(),
        "undetermined": list(uncertainty.undetermined),
        "ray_sigma_px": _summary(calibration.ray_sigma_px),
        "ray_sigma_with_turn_px": _summary(calibration.ray_sigma_fixed_px),
        "halves": _halves(calibration),
        "coverage": {
            "share": coverage.share,
            "innermost_deg": coverage.innermost_deg,
            "outermost_deg": coverage.outermost_deg,
            "widest_gap_deg": coverage.widest_gap_deg,
        },
        "central": None
        if calibration.central is None
        else {"rms_px": calibration.central.rms_px, "sensor": as_table(calibration.central.sensor)},
        "image_circle": None if calibration.circle is None else vars(calibration.circle),
        "notes": list(calibration.notes),
        "left_out": [] if calibration.left_out is None else corner_tables(calibration.left_out),
        "images": images,
    }
    return {key: _finite(value) for key, value in table.items()}


def _halves(calibration: SensorCalibration) -> dict[str, Any] | None:
    halves = calibration.halves
    if halves is None:
        return None
    return {
        "images": [list(each) for each in halves.images],
        "rms_px": list(halves.rms_px),
        "other_rms_px": list(halves.other_rms_px),
        "difference_px": _summary(halves.difference_px),
    }


def _summary(values: Array) -> dict[str, float | None]:
    """Median, 95th percentile and maximum of the finite values."""
    known = values[np.isfinite(values)]
    if not known.size:
        return {"median": None, "p95": None, "max": None}
    median, high = np.percentile(known, [50, 95]).tolist()
    return {"median": median, "p95": high, "max": float(known.max())}


def _finite(value: Any) -> Any:
    """A value with None in place of every number that JSON cannot represent."""
    if isinstance(value, dict):
        return {key: _finite(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(each) for each in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value
