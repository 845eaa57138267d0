"""A page on a calibration: what was found, what is left of the corners, and how sure the rays are."""

import numpy as np

from harness.calibration.sensor_calibration import SensorCalibration
from harness.geometry.angles import Array
from harness.report import calibration_figures as figures
from harness.report import theme
from harness.report.markup import template
from harness.spec import dump_toml

_UNITS = {"_px": "px", "_m": "m", "_deg": "°"}


def build_page(found: SensorCalibration) -> str:
    """The page, one self-contained HTML file."""
    with theme.style():
        pictures = {
            "residuals": [figures.residual_vectors(found), figures.residual_scatter(found)],
            "by_angle": [figures.residuals_by_angle(found)],
            "images": [figures.rms_of_images(found)],
            "rays": [figures.coverage_map(found), figures.ray_map(found)],
            "halves": [figures.halves_map(found), figures.halves_ratio(found)] if found.halves else [],
            "correlations": [figures.correlations(found)],
        }
    halves = found.halves
    return template("calibration.html.j2").render(
        found=found,
        pictures=pictures,
        title=found.sensor.model.title,
        numbers=_numbers(found),
        rays=_summary(found.ray_sigma_px),
        with_turn=_summary(found.ray_sigma_fixed_px),
        difference=None if halves is None else _summary(halves.difference_px),
        rms_of_images=found.rms_of_images_px.tolist(),
        left_out=0 if found.left_out is None else len(found.left_out.image),
        field=found.sensor.field,
        sensor=dump_toml(found.sensor),
    )


def _numbers(found: SensorCalibration) -> list[dict[str, object]]:
    uncertainty = found.uncertainty
    return [
        {"key": key, "value": value, "sigma": sigma if np.isfinite(sigma) else None, "unit": _unit(key)}
        for key, value, sigma in zip(found.keys, uncertainty.values.tolist(), uncertainty.sigma.tolist(), strict=True)
    ]


def _unit(key: str) -> str:
    return next((unit for end, unit in _UNITS.items() if key.endswith(end)), "")


def _summary(values: Array) -> dict[str, float]:
    """Median, the 95th percentile and the largest of what is known."""
    known = values[np.isfinite(values)]
    median, high = np.percentile(known, [50, 95]).tolist()
    return {"median": median, "high": high, "most": float(known.max())}
