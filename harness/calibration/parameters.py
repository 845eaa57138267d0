"""The parameters of a sensor that a calibration estimates, as a vector, and the sensor of such a vector.

The vector that is adjusted does not hold the values under the keys of the file. Focal length and lens are expressed for
a normalised plane of slope 1 at the axis: there xi, focal length and lens terms have distinct effects on the image,
while with the keys' values a change of xi has to be compensated by all the others. Principal point and focal length of
a camera that is misaligned with its mirror are expressed for the image of the mirror's apex: otherwise a rotation or
shift of the camera has to be compensated by the principal point, and an approach by the focal length. This is a change
of coordinates and nothing else: covariances are given for the keys.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from pydantic import ValidationError

from harness.camera._projection_kernels import project_all
from harness.camera.models import CameraModel
from harness.camera.reflection import reflecting_camera
from harness.camera.sensor import Sensor, parameters_of
from harness.errors import InputError, nearest, with_article
from harness.geometry.angles import Array

LENS_POWERS = {"k1": 2, "k2": 4, "p1": 1, "p2": 1, "k3": 6}
"""The power of the plane's scale with which each lens coefficient changes."""
_CAMERA = ("focal_px", "aspect", "cx_px", "cy_px")
_LENS = ("k1", "k2", "p1", "p2")
_MODEL: dict[str, tuple[str, ...]] = {
    "hyperboloid": ("b_m",),  # images determine the shape of a mirror, not its size
    "unified": ("xi",),
    "eucm": ("alpha", "beta"),
    "double_sphere": ("xi", "alpha"),
    "kannala_brandt": ("k1", "k2", "k3", "k4"),
}
"""Keys of each model's own table that images determine."""
MISALIGNMENT = ("x_mm", "y_mm", "z_mm", "rotation_x_deg", "rotation_y_deg")
"""Keys of a misalignment that images determine. A rotation about the mirror's axis rotates all boards alike."""
_MIRROR = "model.b_m"
"""The shape of a mirror is adjusted as its xi, because near a paraboloid the image is a smoother function of it."""
_FREE_LENS = {"unified": _LENS}
"""Lens terms that are free by default."""


def kind_of(model: CameraModel) -> str:
    """The model's `kind`, as in the file."""
    return str(getattr(model, "kind", "hyperboloid"))


def axial_slope(model: CameraModel) -> float:
    """Derivative, at the axis, of the radius on the model's normalised plane by the angle off the axis."""
    kind = kind_of(model)
    table: Any = model
    if kind == "hyperboloid":  # m = (1 - 1/eps²)/(1 + 1/eps²) sin/(xi + cos) in units of the focal length
        eps = table.e_m / table.a_m
        return float((eps - 1) / (eps + 1))
    if kind in {"unified", "double_sphere"}:
        return 1.0 / (1.0 + float(table.xi))
    return 1.0


def choose_keys(
    sensor: Sensor, *, lens: Sequence[str] | None = None, free: Sequence[str] = (), fix: Sequence[str] = ()
) -> tuple[str, ...]:
    """The dotted keys of the parameters to estimate, in the order of the file.

    Parameters
    ----------
    lens
        Lens terms to estimate, instead of the model's default ones.
    free, fix
        Keys to estimate, or not, in addition to the default ones: `lens.k3`, or `k3` if that is unambiguous; in `free`,
        `misalignment` stands for all keys of that table that images determine.

    Raises
    ------
    InputError
        When there is no such key, or images do not determine it.
    """
    kind = kind_of(sensor.model)
    terms = _FREE_LENS.get(kind, ()) if lens is None else tuple(lens)
    for name in terms:
        if name not in LENS_POWERS:
            raise InputError(f"there is no lens term '{name}'; {nearest(name, list(LENS_POWERS))}", key="lens")
    if terms and not sensor.model.has_lens:
        raise InputError(f"{with_article(sensor.model.title)} has its own distortion and no [lens] terms", key="lens")
    chosen = {*_model_keys(sensor.model), *_camera_keys(kind), *(f"lens.{each}" for each in terms)}
    every = _every_key(sensor)
    for word in free:
        chosen.update(_misalignment(sensor) if word == "misalignment" else [key_named(sensor, word, "free")])
    for word in fix:
        chosen.discard(key_named(sensor, word, "fix"))
    return tuple(key for key in every if key in chosen)


def _misalignment(sensor: Sensor) -> list[str]:
    if kind_of(sensor.model) != "hyperboloid":
        raise InputError(
            f"{with_article(sensor.model.title)} has no mirror to be misaligned with; leave it out", key="free"
        )
    return [f"misalignment.{name}" for name in MISALIGNMENT]


def _model_keys(model: CameraModel) -> list[str]:
    kind = kind_of(model)
    if kind == "ocam":
        coefficients = len(getattr(model, "coefficients", ()))
        # a_1 is 0; e would turn the image about its centre, which the boards' poses do as well.
        return [f"model.coefficients[{i}]" for i in range(coefficients) if i != 1] + ["model.c", "model.d"]
    if kind in _MODEL:
        return [f"model.{name}" for name in _MODEL[kind]]
    fields = type(model).model_fields
    return [f"model.{name}" for name in fields if isinstance(getattr(model, name), float)]


def _camera_keys(kind: str) -> list[str]:
    names = _CAMERA if kind != "ocam" else ("cx_px", "cy_px")  # its polynomial and c are focal length and aspect
    return [f"camera.{name}" for name in names]


def _every_key(sensor: Sensor) -> list[str]:
    """All keys that could be estimated."""
    kind = kind_of(sensor.model)
    keys = _model_keys(sensor.model)
    # Boards determine a mirror's size only through a misalignment.
    keys += [f"model.{name}" for name, of in (("e", "ocam"), ("a_m", "hyperboloid")) if kind == of]
    camera = ["focal_px", "aspect", "skew_px", "cx_px", "cy_px"] if kind != "ocam" else ["cx_px", "cy_px"]
    keys += [f"camera.{name}" for name in camera if name in type(sensor.camera).model_fields]
    keys += [f"lens.{name}" for name in LENS_POWERS if sensor.model.has_lens]
    return keys + [f"misalignment.{name}" for name in MISALIGNMENT if kind == "hyperboloid"]


def key_named(sensor: Sensor, word: str, argument: str) -> str:
    """The dotted key that a word names, in full or by its last part: `k3`, `lens.k3`, `focal`.

    Raises
    ------
    InputError
        When no such key exists, or more than one.
    """
    every = _every_key(sensor)
    named = [key for key in every if word in (key, key.rpartition(".")[2], key.rpartition(".")[2].removesuffix("_px"))]
    if len(named) != 1:
        names = [key.rpartition(".")[2] for key in every]
        hint = f"it may be {' or '.join(named)}" if named else nearest(word, [*names, *every])
        raise InputError(f"there is no one key '{word}' to estimate; {hint}", key=argument)
    return named[0]


def value_of(sensor: Sensor, key: str) -> float:
    """The value of a dotted key."""
    table, _, name = key.partition(".")
    spec: Any = getattr(sensor, table)
    if name.endswith("]"):
        name, _, index = name[:-1].partition("[")
        return float(getattr(spec, name)[int(index)])
    return float(getattr(spec, name))


def with_values(sensor: Sensor, values: Mapping[str, float]) -> Sensor:
    """A sensor with other values of some dotted keys. Its tables are validated, but not its field of view.

    Raises
    ------
    ValueError
        When a key may not have its value.
    """
    update: dict[str, Any] = {}
    for table in ("model", "camera", "lens", "misalignment"):
        spec: Any = getattr(sensor, table)
        given = {key.partition(".")[2]: value for key, value in values.items() if key.startswith(f"{table}.")}
        if not given:
            continue
        listed: dict[str, list[float]] = {}
        for name in [each for each in given if each.endswith("]")]:
            stem, _, index = name[:-1].partition("[")
            listed.setdefault(stem, list(getattr(spec, stem)))[int(index)] = given.pop(name)
        new = {name: getattr(spec, name) for name in type(spec).model_fields}
        update[table] = type(spec).model_validate(new | given | {name: tuple(each) for name, each in listed.items()})
    return sensor.model_copy(update=update)


class Apex(NamedTuple):
    """The image of a mirror's apex at focal length 1, undistorted: its position, and its scale over the aligned one."""

    x: float = 0.0
    y: float = 0.0
    size: float = 1.0

    def moved(self, sensor: Sensor, key: str) -> float:
        """A number of a sensor as it is adjusted: the principal point at the apex, the focal length by its size."""
        return value_of(sensor, key) * (self.size if key == "camera.focal_px" else 1.0) + self._shift(sensor, key)

    def moved_back(self, sensor: Sensor, keys: Sequence[str]) -> Sensor:
        """The sensor whose numbers under these keys are given as they are adjusted."""
        if "camera.focal_px" in keys:
            sensor = with_values(sensor, {"camera.focal_px": sensor.camera.focal_px / self.size})
        centre = [key for key in keys if key in {"camera.cx_px", "camera.cy_px"}]
        return with_values(sensor, {key: value_of(sensor, key) - self._shift(sensor, key) for key in centre})

    def _shift(self, sensor: Sensor, key: str) -> float:
        camera = sensor.camera
        if key == "camera.cx_px":
            return camera.focal_px * self.x
        return camera.focal_px * camera.aspect * self.y if key == "camera.cy_px" else 0.0


def apex_in(sensor: Sensor) -> Apex:
    """The apex of a sensor's mirror as its camera sees it.

    Raises
    ------
    ValueError
        When it is behind the camera.
    """
    if sensor.is_central:
        return Apex()
    mirror: Any = sensor.model
    height = mirror.a_m + mirror.e_m
    x, y, z = (
        (np.array([0.0, 0.0, height]) - sensor.misalignment.offset_m) @ sensor.misalignment.R_mirror_from_camera
    ).tolist()
    if z <= 0:
        raise ValueError("the mirror is behind the camera")
    return Apex(x / z, y / z, height / z)


@dataclass(frozen=True)
class Parameters:
    """The free parameters of a sensor."""

    sensor: Sensor
    """Has all the others."""
    keys: tuple[str, ...]
    """Dotted keys, in the order of vectors."""

    def vector(self, sensor: Sensor) -> Array:
        """The vector `[n]` of a sensor, in the coordinates that are adjusted."""
        slope = axial_slope(sensor.model)
        model: Any = sensor.model
        apex = apex_in(sensor)
        return np.array(
            [
                _unified_xi(model) if key == _MIRROR else _coordinate(key, apex.moved(sensor, key), slope)
                for key in self.keys
            ]
        )

    def sensor_at(self, vector: Array) -> Sensor:
        """The sensor of a vector of coordinates.

        Raises
        ------
        ValueError
            When there is none.
        """
        own = {
            key: semi_axis(self.sensor.model, float(each)) if key == _MIRROR else float(each)
            for key, each in zip(self.keys, vector, strict=True)
        }
        of_mirror = ("model.", "misalignment.")
        sensor = with_values(self.sensor, {key: value for key, value in own.items() if key.startswith(of_mirror)})
        slope = axial_slope(sensor.model)
        sensor = with_values(
            sensor, {key: _value(key, own[key], slope) for key in self.keys if not key.startswith(of_mirror)}
        )
        return sensor if sensor.is_central else apex_in(sensor).moved_back(sensor, self.keys)

    def compiled(self, vector: Array) -> Any | None:
        """The argument of the compiled projections for a vector; None if there is no such sensor."""
        try:
            sensor = self.sensor_at(vector)
            return (parameters_of if sensor.is_central else reflecting_camera).__wrapped__(sensor)
        except (ValidationError, ValueError, OverflowError, ZeroDivisionError):
            return None

    def values(self, vector: Array) -> Array:
        """The values of the keys, `[n]`, for a vector."""
        sensor = self.sensor_at(vector)
        return np.array([value_of(sensor, key) for key in self.keys])

    @cached_property
    def steps(self) -> Array:
        """Initial steps `[n]` for finite differences."""
        return np.array(
            [1e-6 * _size(key, each) for key, each in zip(self.keys, self.vector(self.sensor), strict=True)]
        )

    def derivatives_of_values(self, vector: Array) -> Array:
        """Derivatives `[n, n]` of `values` by the vector, by central differences, or one-sided ones at a limit."""
        at = self.values(vector)
        columns = []
        sizes = [1.0 if key.startswith("misalignment.") else 1e-6 for key in self.keys]
        for i, step in enumerate(1e-5 * np.maximum(np.abs(vector), sizes)):
            sides = []
            for moved in (vector + np.eye(len(vector))[i] * step, vector - np.eye(len(vector))[i] * step):
                try:
                    sides.append((moved[i], self.values(moved)))
                except ValueError:
                    sides.append((vector[i], at))
            (above, high), (below, low) = sides
            columns.append((high - low) / max(above - below, 1e-300))
        return np.stack(columns, axis=1)


def intrinsic_jacobian(parameters: Parameters, vector: Array, p: Array, steps: Array) -> Array:
    """Derivatives `[m, 2, n]` of the pixels of directions p `[m, 3]` by the vector, by central differences.

    Their error is of the order of steps², against roundings of 1e-13 of the image over the step. Where a step leads out
    of the model's domain the difference is one-sided; NaN where both do.

    Parameters
    ----------
    steps
        `[n]`; updated so that the next call moves pixels by 1e-3, where both errors are small.
    """
    p = np.ascontiguousarray(p)
    out = np.empty((len(p), 2, len(vector)))
    middle = None
    for i in range(len(vector)):
        sides = []
        for sign in (1.0, -1.0):
            moved = vector.copy()
            moved[i] += sign * steps[i]
            camera = parameters.compiled(moved)
            pixels = np.full((len(p), 2), np.nan)
            if camera is not None:
                project_all(p, camera, pixels)
            sides.append(pixels)
        ahead, behind, width = sides[0], sides[1], 2 * steps[i]
        if not (np.isfinite(ahead).all() and np.isfinite(behind).all()):
            if middle is None:
                middle = np.empty((len(p), 2))
                project_all(p, parameters.compiled(vector), middle)
            whole = np.isfinite(ahead) & np.isfinite(behind)
            one_sided = np.where(np.isfinite(ahead), ahead - middle, middle - behind) / steps[i]
            out[:, :, i] = np.where(whole, (ahead - behind) / width, one_sided)
        else:
            out[:, :, i] = (ahead - behind) / width
        size = float(np.sqrt(np.nanmean(out[:, :, i] ** 2)))
        if size > 0:
            steps[i] = 1e-3 / size
    return out


def _unified_xi(mirror: Any) -> float:
    """Xi of a hyperboloid in the unified model, `2 eps/(1 + eps²)` with eps = e/a."""
    eps = mirror.e_m / mirror.a_m
    return float(2 * eps / (1 + eps * eps))


def semi_axis(mirror: Any, xi: float) -> float:
    """The semi-axis b of the hyperboloid with this xi, `a sqrt(eps² - 1)`.

    Raises
    ------
    ValueError
        Unless 0 < xi < 1.
    """
    if not 0 < xi < 1:
        raise ValueError(f"xi = {xi:g} is no hyperboloid")
    root = math.sqrt(1 - xi * xi)
    # eps² - 1 = ((1 + root)² - xi²)/xi² = 2 root (1 + root)/xi²
    return float(mirror.a_m * math.sqrt(2 * root * (1 + root)) / xi)


def _size(key: str, coordinate: float) -> float:
    """A typical size of a coordinate: its own, at least 1, or the power of 100 pixels of a polynomial's term."""
    power = int(key[:-1].partition("[")[2]) if key.endswith("]") else 1
    return max(abs(coordinate), 100.0 ** (1 - power))


def _coordinate(key: str, value: float, slope: float) -> float:
    if key == "camera.focal_px":
        return value * slope
    name = key.removeprefix("lens.")
    return value * slope ** LENS_POWERS[name] if name in LENS_POWERS and key != name else value


def _value(key: str, own: float, slope: float) -> float:
    if key == "camera.focal_px":
        return own / slope
    name = key.removeprefix("lens.")
    return own / slope ** LENS_POWERS[name] if name in LENS_POWERS and key != name else own
