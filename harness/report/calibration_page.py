"""A page on a calibration: parameters, residuals of the corners, and uncertainty of the rays."""

import numpy as np

from harness.calibration.sensor_calibration import SensorCalibration
from harness.geometry.angles import Array
from harness.report import calibration_figures as figures
from harness.report import theme
from harness.report.markup import template
from harness.spec import dump_toml

_UNITS = {"_px": "px", "_m": "m", "_mm": "mm", "_deg": "°"}


def build_page(calibration: SensorCalibration) -> str:
    """The page, one self-contained HTML file."""
    with theme.style():
        pictures = {
            "residuals": [figures.residual_vectors(calibration), figures.residual_scatter(calibration)],
            "by_angle": [figures.residuals_by_angle(calibration)],
            "images": [figures.rms_of_images(calibration)],
            "rays": [figures.coverage_map(calibration), figures.ray_map(calibration)],
            "halves": [figures.halves_map(calibration), figures.halves_ratio(calibration)]
            if calibration.halves
            else [],
            "correlations": [figures.correlations(calibration)],
        }
    halves = calibration.halves
    return template("calibration.html.j2").render(
        calibration=calibration,
        pictures=pictures,
        title=calibration.sensor.model.title,
        numbers=_numbers(calibration),
        rays=_summary(calibration.ray_sigma_px),
        with_turn=_summary(calibration.ray_sigma_fixed_px),
        difference=None if halves is None else _summary(halves.difference_px),
        rms_of_images=calibration.rms_of_images_px.tolist(),
        left_out=0 if calibration.left_out is None else len(calibration.left_out.image),
        field=calibration.sensor.field,
        sensor=dump_toml(calibration.sensor),
    )


def _numbers(calibration: SensorCalibration) -> list[dict[str, object]]:
    uncertainty = calibration.uncertainty
    return [
        {"key": key, "value": value, "sigma": sigma if np.isfinite(sigma) else None, "unit": _unit(key)}
        for key, value, sigma in zip(
            calibration.keys, uncertainty.values.tolist(), uncertainty.sigma.tolist(), strict=True
        )
    ]


def _unit(key: str) -> str:
    return next((unit for end, unit in _UNITS.items() if key.endswith(end)), "")


def _summary(values: Array) -> dict[str, float]:
    """Median, 95th percentile and maximum of the finite values."""
    known = values[np.isfinite(values)]
    median, high = np.percentile(known, [50, 95]).tolist()
    return {"median": median, "high": high, "most": float(known.max())}
