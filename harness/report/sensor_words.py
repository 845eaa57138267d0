"""A sensor and its field of view in words, for the terminal and for a page."""

import math
from typing import Any

import numpy as np

from harness.camera.central import best_central
from harness.camera.coverage import HARDLY, Coverage, Ring, has_circle
from harness.camera.sensor import Sensor, used
from harness.display import listed
from harness.errors import with_article

_OFF_CENTRE = 0.03
"""Share of the image's smaller side within which the principal point usually is from the middle."""
_LITTLE_USED = 0.25
_EVEN = 0.02
"""Two diameters that differ by a smaller share are given as one."""


def title_of(coverage: Coverage) -> str:
    """Model and size in one line."""
    camera = coverage.sensor.camera
    model = coverage.sensor.model.title
    return f"{model[0].upper()}{model[1:]}, {camera.width_px} x {camera.height_px} pixels"


def facts_of(coverage: Coverage) -> dict[str, str]:
    """A description of a sensor's model, mount, field and image, in words by name."""
    low, high = coverage.elevation_deg
    rim = coverage.rim
    outer = _number(math.degrees(rim.angle_rad))
    inner = math.degrees(coverage.blind.angle_rad) if coverage.blind else 0.0
    facts = {
        "model": _model(coverage.sensor),
        "mount": _mount(coverage.sensor),
        "field": (f"{_number(inner)} to {outer} deg off the optical axis; " if has_circle(coverage.sensor) else "")
        + f"the image has elevations {_number(low)} to {_number(high)} deg, {coverage.sphere:.1%} of all directions",
        "image circle": _circle(coverage),
        "blind spot": _blind(coverage),
        "resolution": _resolution(coverage),
        "used": f"{coverage.used:.1%} of the image's pixels see something{_hidden(coverage.sensor)}",
    }
    return {name: text for name, text in facts.items() if text}


def misalignment_of(sensor: Sensor) -> list[str]:
    """Sentences on why the sensor's rays meet in no viewpoint; empty for a central sensor."""
    profile = []
    if sensor.profile is not None:
        fit = best_central(sensor)
        profile.append(
            f"The rays of {with_article(sensor.profile.title)} meet in no point: all that is said here is of the "
            f"nearest central camera, whose rays are off by {fit.rms_deg:.2g} deg ({fit.rms_px:.2g} px) RMS "
            f"at {fit.distance_m:g} m."
        )
    given = {name: value for name, value in sensor.misalignment.model_dump().items() if value}
    if not given:
        return profile
    numbers = ", ".join(f"{name} = {value:.3g}" for name, value in given.items())
    return [*profile, f"Camera and mirror are misaligned ({numbers}): all that is said here is of the aligned sensor."]


def warnings_of(coverage: Coverage) -> list[str]:
    """Warnings about parts of the calibration that do not fit together, a sentence each."""
    camera = coverage.sensor.camera
    smaller = min(camera.width_px, camera.height_px)
    middle = np.array([(camera.width_px - 1) / 2, (camera.height_px - 1) / 2])
    away = np.array(coverage.axis_px) - middle
    if not has_circle(coverage.sensor):
        return []
    warnings = []
    if np.isfinite(away).all() and np.hypot(*away) > _OFF_CENTRE * smaller:
        u, v = coverage.axis_px
        warnings.append(
            f"The optical axis meets the image at ({u:.1f}, {v:.1f}), {np.hypot(*away):.0f} px from its middle "
            f"({middle[0]:g}, {middle[1]:g}): {_whither(away)}. If the image was cut or scaled after the calibration, "
            "the centre has to be moved with it."
        )
    rim = coverage.rim
    if HARDLY < rim.on_image < 1 and rim.sides:
        warnings.append(
            f"The edge of the field leaves the image at the {listed(rim.sides)}: {1 - rim.on_image:.0%} of its "
            "directions are cut off there."
        )
    if coverage.used < _LITTLE_USED:
        longest = rim.diameter_px[1]
        if rim.on_image == 1 and longest < 0.6 * smaller:
            where = np.array(rim.centre_px) - middle
            corner = np.hypot(*where) > 0.15 * smaller
            warnings.append(
                f"The image circle is {longest:.0f} px across in an image of {camera.width_px} x {camera.height_px}"
                + (f", and lies {_whither(where)} of its middle" if corner else "")
                + f": only {coverage.used:.1%} of the pixels are used. Is the focal length that of another resolution?"
            )
        else:
            warnings.append(f"Only {coverage.used:.1%} of the image's pixels see something.")
    if coverage.blind and coverage.blind.on_image == 0:
        warnings.append("The blind spot lies outside the image.")
    return warnings


_XI = (
    (0, "a perspective camera"),
    (1, "as of a hyperboloid mirror"),
    (math.inf, "above 1, as calibrations of real mirrors and of fisheyes have it"),
)
"""Meanings of xi of the unified model, each up to a value."""


def _model(sensor: Sensor) -> str:
    """The model's parameters, with the meaning of xi."""
    keys = {name: value for name, value in sensor.model.model_dump().items() if name != "kind"}
    parameters = [f"{name} = {_listed_numbers(value)}" for name, value in keys.items()]
    parameters += [f"lens {name} = {value:.4g}" for name, value in sensor.lens.model_dump().items() if value]
    camera = sensor.camera
    if "focal_px" not in sensor.model.unused:
        parameters.append(f"focal length {camera.focal_px:.5g} px")
        parameters += [f"aspect {camera.aspect:.5g}"] if camera.aspect != 1 else []
        parameters += [f"skew {camera.skew_px:.4g} px"] if camera.skew_px else []
    text = ", ".join(parameters)
    if getattr(sensor.model, "kind", "") == "unified":
        xi = keys["xi"]
        why = "as of a paraboloid mirror" if xi == 1 else next(words for most, words in _XI if xi <= most)
        text = f"{text}; xi is {why}" if xi else f"{text}; xi = 0 is {why}"
    return text


def _listed_numbers(value: Any) -> str:
    return f"({', '.join(f'{each:.4g}' for each in value)})" if isinstance(value, list | tuple) else f"{value:.5g}"


def _mount(sensor: Sensor) -> str:
    mount = sensor.mount
    turns = [
        f"{name} {value:g} deg"
        for name, value in (("yaw", mount.yaw_deg), ("pitch", mount.pitch_deg), ("roll", mount.roll_deg))
        if value
    ]
    text = f"looks {sensor.looks}, {'mirrored' if sensor.mirrored else 'not mirrored'}"
    return f"{text}; turned by {', '.join(turns)}" if turns else text


def _hidden(sensor: Sensor) -> str:
    """The share of the pixels that a mask hides, as the end of a sentence."""
    pixels = used(sensor)
    return "" if pixels is None else f"; the mask hides {1 - pixels.mean():.1%} of them all"


def _circle(coverage: Coverage) -> str:
    rim = coverage.rim
    if not has_circle(coverage.sensor):
        return "none: a panorama in longitude and latitude"
    if rim.on_image <= HARDLY or not np.isfinite(rim.diameter_px).all():
        return "none: the image ends before the field does, on all sides"
    u, v = rim.centre_px
    return f"{_across(rim)} across, around ({u:.1f}, {v:.1f})" + (
        ", all of it on the image" if rim.on_image == 1 else f", {rim.on_image:.0%} of its edge on the image"
    )


def _blind(coverage: Coverage) -> str:
    if coverage.blind is None:
        return "none"
    blind = coverage.blind
    u, v = blind.centre_px
    angle = _number(math.degrees(blind.angle_rad))
    return f"{_across(blind)} across, around ({u:.1f}, {v:.1f}): up to {angle} deg off the axis"


def _across(ring: Ring) -> str:
    short, long = ring.diameter_px
    return f"{long:.0f} px" if long - short < _EVEN * long else f"{short:.0f} to {long:.0f} px"


def _resolution(coverage: Coverage) -> str:
    resolution = coverage.resolution
    vertical = bool(np.isfinite(resolution.elevation_rad).all())
    x = np.degrees(resolution.elevation_rad if vertical else resolution.angle_rad)
    both = resolution.radial + resolution.tangential
    if not np.isfinite(both).any():
        return ""
    best, worst = int(np.nanargmax(resolution.radial)), int(np.nanargmin(resolution.radial))
    unit = "deg of elevation" if vertical else "deg off the axis"
    least = f"{resolution.radial[worst]:.2f} (at {_number(x[worst])} {unit})"
    parts = [
        f"radially {least} to {resolution.radial[best]:.2f} px/deg (at {_number(x[best])})",
        f"tangentially {np.nanmin(resolution.tangential):.2f} to {np.nanmax(resolution.tangential):.2f} px/deg",
    ]
    if vertical and x.min() < 0 < x.max():
        level = int(np.argmin(np.abs(x)))
        if np.isfinite(both[level]):
            parts.append(f"at the horizon {resolution.radial[level]:.2f} and {resolution.tangential[level]:.2f}")
    return "; ".join(parts)


def _whither(offset: np.ndarray) -> str:
    """An offset in words: `12 px right, 3 px up`."""
    across = f"{abs(offset[0]):.0f} px {'right' if offset[0] > 0 else 'left'}"
    down = f"{abs(offset[1]):.0f} px {'down' if offset[1] > 0 else 'up'}"
    return ", ".join(text for text, size in ((across, offset[0]), (down, offset[1])) if abs(size) >= 0.5)


def _number(value: float) -> str:
    text = f"{value:.1f}".removesuffix(".0")
    return "0" if text == "-0" else text
