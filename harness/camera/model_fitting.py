"""The camera of one model that best approximates a camera of another: least squares on the rays of pixels.

The cost is the angle between the two cameras' rays, over pixels spread evenly over the image, to first order: a pixel's
offset times the inverse of the first camera's Jacobian. The residuals that are reported are exact.
"""

import math
from collections.abc import Iterable, Iterator
from copy import copy
from dataclasses import dataclass

import numpy as np
from pydantic import ValidationError

from harness.camera.equivalents import equivalent
from harness.camera.intrinsics import Camera
from harness.camera.lens import Lens
from harness.camera.models import MODELS
from harness.camera.optics import Optics, edge_pixels
from harness.camera.sensor import Sensor, pixel_directions, unproject
from harness.display import OneLine
from harness.errors import InputError
from harness.geometry.angles import Array

_FEW, _MANY = 300, 1500
"""Pixels used for the descent from each start, and for the final steps from the best result."""
_COMPARED = 20_000
"""Approximate number of pixels at which a sensor and its conversion are compared."""
_FAR_PX = 1000.0
"""Offset assigned to a pixel whose direction is outside a candidate's domain."""
OCAM_DEGREES = (4, 6, 8, 10)
"""Tried in turn, until the polynomial is as good as `_OCAM_ENOUGH_PX`."""
_OCAM_ENOUGH_PX = 0.01


@dataclass(frozen=True)
class Target:
    """The camera model to write, and the other parameters that the file format can hold."""

    kind: str
    skew: bool = True
    k3: bool = True


@dataclass(frozen=True, repr=False)
class Conversion(OneLine):
    """A camera in another model, and the residuals of its rays against the original's."""

    optics: Optics
    is_exact: bool
    """Whether it is the same camera in other parameters rather than the nearest one."""
    rms_rad: float
    largest_rad: float
    rms_px: float
    largest_px: float
    angles_rad: tuple[float, float]
    """The least and the largest angle off the optical axis at which they were compared."""
    pixels: int
    """Number of pixels that were compared."""


def convert(optics: Optics, pixels: Array, target: Target) -> Conversion:
    """The same camera in the target's model, or else the one whose rays are closest.

    Parameters
    ----------
    pixels
        `[n, 2]`, (u, v): the pixels at which rays are compared.

    Raises
    ------
    InputError
        When no camera of that model approximates the original.
    """
    same = equivalent(optics, target.kind)
    if same is not None and _has_room(target, same):
        return _compared(optics, same, pixels, is_exact=True)
    return _compared(optics, _nearest(optics, pixels, target), pixels, is_exact=False)


def compared_pixels(sensor: Sensor) -> Array:
    """Pixels `[n, 2]` that see something, evenly over the image, and those at the border and at the field's edge."""
    valid = pixel_directions(sensor)[1]
    every = max(1, math.isqrt(math.ceil(int(valid.sum()) / _COMPARED)))
    rows, columns = np.nonzero(valid[::every, ::every])
    grid = np.stack([columns, rows], axis=-1).astype(np.float64) * every
    outline = valid.copy()
    outline[1:-1, 1:-1] &= ~(valid[:-2, 1:-1] & valid[2:, 1:-1] & valid[1:-1, :-2] & valid[1:-1, 2:])
    border = np.argwhere(outline)[:, ::-1].astype(np.float64)
    corners = edge_pixels(sensor.camera)
    corners = corners[unproject(sensor, corners)[1]]
    return np.concatenate([grid, border[:: max(1, len(border) // 2000)], corners])


def _has_room(target: Target, optics: Optics) -> bool:
    return (target.skew or optics.camera.skew_px == 0) and (target.k3 or optics.lens.k3 == 0)


def _compared(first: Optics, second: Optics, pixels: Array, *, is_exact: bool) -> Conversion:
    rays = first.unproject(pixels)
    if second is first:  # nor do roundings take a pixel across the seam of a panorama
        apart_rad = apart_px = np.zeros(len(pixels))
    else:
        # |a - b| = 2 sin(angle / 2) keeps its digits where the angle is small.
        apart_rad = 2 * np.arcsin(np.minimum(0.5 * np.linalg.norm(rays - second.unproject(pixels), axis=-1), 1.0))
        apart_px = np.linalg.norm(second.project(rays) - pixels, axis=-1)
    off_axis = np.arctan2(np.hypot(rays[:, 0], rays[:, 1]), rays[:, 2])
    known = np.isfinite(apart_rad) & np.isfinite(apart_px)
    if not known.all():
        share = 1 - known.mean()
        title = second.model.title
        raise InputError(f"no {title} approximates this camera: {share:.1%} of the pixels would have no direction")
    return Conversion(
        optics=second,
        is_exact=is_exact,
        rms_rad=_rms(apart_rad),
        largest_rad=float(apart_rad.max()),
        rms_px=_rms(apart_px),
        largest_px=float(apart_px.max()),
        angles_rad=(float(off_axis.min()), float(off_axis.max())),
        pixels=len(pixels),
    )


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values * values)))


def _nearest(optics: Optics, pixels: Array, target: Target) -> Optics:
    problem = _Problem(optics, pixels, target)
    if target.kind == "ocam":
        return _nearest_polynomial(problem)
    solution = problem.solved(problem.starts())
    if solution is None:
        raise InputError(f"no {MODELS[target.kind].title} approximates this camera")
    return solution


def _nearest_polynomial(problem: "_Problem") -> Optics:
    best: Optics | None = None
    least = math.inf
    for degree in OCAM_DEGREES:
        problem.degree = degree
        solution = problem.solved([problem.polynomial_start()])
        if solution is None:
            continue
        rms = _rms(np.linalg.norm(solution.project(problem.rays) - problem.pixels, axis=-1))
        if rms < 0.9 * least:
            best, least = solution, rms
        if least < _OCAM_ENOUGH_PX:
            break
    if best is None:
        raise InputError(f"no {MODELS['ocam'].title} approximates this camera")
    return best


class _Problem:
    """One fit: the rays to approximate, and the layout of a model's parameters in a vector."""

    def __init__(self, optics: Optics, pixels: Array, target: Target) -> None:
        self.optics, self.pixels, self.target = optics, pixels, target
        self.rays = optics.unproject(pixels)
        self.to_angle = self._angles_of_offsets()
        self.degree = OCAM_DEGREES[0]
        axis = np.array([[0.0, 0.0, 1.0]])
        centre, slopes = optics.project(axis)[0], optics.jacobian(axis)[0]
        camera = optics.camera
        self.size = np.array([camera.width_px, camera.height_px])
        if not np.isfinite([*centre, *slopes.ravel()]).all():
            centre, slopes = (self.size - 1) / 2, np.eye(2, 3) * self.size.min() / 4
        self.centre = np.clip(centre, 0, self.size - 1)
        self.focal = slopes[0, 0]
        self.aspect, self.skew = slopes[1, 1] / slopes[0, 0], slopes[0, 1]
        self.reach = float(np.linalg.norm(pixels - self.centre, axis=-1).max())

    def _angles_of_offsets(self) -> Array:
        """`[n, 2, 2]`: maps an offset in pixels to an angle across the ray, radians."""
        rays = self.rays
        other = np.where(np.abs(rays[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
        first = np.cross(rays, other)
        first /= np.linalg.norm(first, axis=-1, keepdims=True)
        tangents = np.stack([first, np.cross(rays, first)], axis=-1)
        return np.linalg.inv(self.optics.jacobian(rays) @ tangents)

    # --- Layout ----------------------------------------------------------------------------------------------------

    def _bounds(self) -> dict[str, tuple[float, float]]:
        """The names of the vector's entries, and their lower and upper bounds."""
        across, down = self.size
        common = {"cx": (-0.5, across - 0.5), "cy": (-0.5, down - 0.5)}
        if self.target.kind == "ocam":
            terms = {f"a{i}": (-math.inf, math.inf) for i in range(2, self.degree + 1)}
            affine = {"c": (0.1, 10.0), "d": (-1.0, 1.0), "e": (-1.0, 1.0)}
            return common | affine | {"a0": (-math.inf, 0.0)} | terms
        common |= {"log_f": (-5.0, 15.0), "log_aspect": (-2.0, 2.0)}
        if self.target.skew:
            common["skew"] = (-1.0, 1.0)
        return common | {name: _RANGES[self.target.kind, name] for name in self._own_names()}

    def _own_names(self) -> list[str]:
        """The names of the parameters that only this model has."""
        kind = self.target.kind
        lens = ["k1", "k2", "p1", "p2", *(["k3"] if self.target.k3 else [])]
        own = {
            "unified": ["xi", *lens],
            "hyperboloid": ["xi", *lens],
            "eucm": ["alpha", "beta"],
            "double_sphere": ["xi", "alpha"],
            "kannala_brandt": ["k1", "k2", "k3", "k4"],
        }
        return own[kind]

    def _optics_at(self, vector: Array) -> Optics | None:
        """The camera with the parameters of a vector; None if they are invalid."""
        values = dict(zip(self._bounds(), vector.tolist(), strict=True))
        pixels = {
            "width_px": int(self.size[0]),
            "height_px": int(self.size[1]),
            "cx_px": values["cx"],
            "cy_px": values["cy"],
        }
        kind = self.target.kind
        try:
            if kind == "ocam":
                powers = range(2, self.degree + 1)
                terms = [values["a0"] * self.reach, 0.0, *(values[f"a{i}"] * self.reach ** (1 - i) for i in powers)]
                keys = {"coefficients": terms} | {each: values[each] for each in "cde"}
                return Optics(MODELS[kind].model_validate({"kind": kind} | keys), Camera.model_validate(pixels), Lens())
            focal = math.exp(values["log_f"])
            pixels |= {
                "focal_px": focal,
                "aspect": math.exp(values["log_aspect"]),
                "skew_px": values.get("skew", 0) * focal,
            }
            camera = Camera.model_validate(pixels)
            own = {name: values[name] for name in self._own_names()}
            if kind in ("unified", "hyperboloid"):
                model = MODELS["unified"].model_validate({"kind": "unified", "xi": own.pop("xi")})
                return equivalent(Optics(model, camera, Lens(**own)), kind)
            return Optics(MODELS[kind].model_validate({"kind": kind} | own), camera, Lens())
        except ValidationError:
            return None

    # --- Starts ----------------------------------------------------------------------------------------------------

    def starts(self) -> Iterator[dict[str, float]]:
        """Initial vectors: the source's centre and its scale on the axis, with each of several shapes."""
        for shape, focal in _SHAPES[self.target.kind]:
            yield {
                "cx": self.centre[0],
                "cy": self.centre[1],
                "log_f": math.log(self.focal * focal),
                "log_aspect": math.log(self.aspect),
                "skew": self.skew / self.focal,
            } | shape

    def polynomial_start(self) -> dict[str, float]:
        """An initial polynomial: a linear problem in its coefficients for a given centre and affine part."""
        e = self.skew / self.focal
        offsets = self.pixels - self.centre
        x = offsets[:, 1] / self.aspect
        rho = np.hypot(x, offsets[:, 0] - e * x)
        cosine = self.rays[:, 2]
        sine = np.hypot(self.rays[:, 0], self.rays[:, 1])
        powers = [0, *range(2, self.degree + 1)]
        # -f(rho) sin = rho cos on every ray; over rho it is an angle.
        weight = 1 / np.maximum(rho, 1.0)
        columns = np.stack([(rho / self.reach) ** i * self.reach * sine * weight for i in powers], axis=-1)
        coefficients = np.linalg.lstsq(columns, -rho * cosine * weight, rcond=None)[0]
        start = {f"a{i}": value for i, value in zip(powers, coefficients.tolist(), strict=True)}
        return start | {"cx": self.centre[0], "cy": self.centre[1], "c": self.aspect, "d": 0.0, "e": e}

    # --- Solution --------------------------------------------------------------------------------------------------

    def residuals(self, vector: Array) -> Array:
        """Angles between the rays of both cameras, radians, two for each pixel."""
        candidate = self._optics_at(vector)
        if candidate is None:
            offsets = np.full_like(self.pixels, _FAR_PX)
        else:
            offsets = candidate.project(self.rays) - self.pixels
            offsets = np.clip(np.where(np.isfinite(offsets), offsets, _FAR_PX), -_FAR_PX, _FAR_PX)
        return np.einsum("nij,nj->ni", self.to_angle, offsets).ravel()

    def solved(self, starts: Iterable[dict[str, float]]) -> Optics | None:
        """The best of the solutions reached from the starts; None if no start leads to one."""
        coarse = self._thinned(_FEW)
        tried = [coarse.descended(np.array([start.get(name, 0.0) for name in self._bounds()]), 40) for start in starts]
        best = min(tried, key=lambda each: each[1])[0]
        return self._optics_at(self._thinned(_MANY).descended(best, 150)[0])

    def descended(self, begin: Array, steps: int) -> tuple[Array, float]:
        """The vector reached from a start in at most `steps` steps, and its sum of squares."""
        from scipy.optimize import least_squares  # loading it takes long

        low, high = np.array(list(self._bounds().values())).T
        begin = np.clip(begin, low + 1e-9, high - 1e-9)
        minimum = least_squares(
            self.residuals, begin, bounds=(low, high), x_scale="jac", ftol=1e-10, xtol=1e-12, gtol=1e-14, max_nfev=steps
        )
        return minimum.x, float(minimum.cost)

    def _thinned(self, count: int) -> "_Problem":
        """The same fit to about `count` of the pixels."""
        every = max(1, len(self.pixels) // count)
        thinned = copy(self)
        thinned.pixels, thinned.rays, thinned.to_angle = (
            self.pixels[::every],
            self.rays[::every],
            self.to_angle[::every],
        )
        return thinned


_LENS_RANGES = dict.fromkeys(("k1", "k2", "k3", "p1", "p2"), (-100.0, 100.0))
_RANGES: dict[tuple[str, str], tuple[float, float]] = (
    {("unified", name): each for name, each in (_LENS_RANGES | {"xi": (0.0, 20.0)}).items()}
    | {("hyperboloid", name): each for name, each in (_LENS_RANGES | {"xi": (0.01, 0.9999)}).items()}
    | {("kannala_brandt", name): (-10.0, 10.0) for name in ("k1", "k2", "k3", "k4")}
    | {("eucm", "alpha"): (0.0, 1.0), ("eucm", "beta"): (1e-3, 1e3)}
    | {("double_sphere", "alpha"): (0.0, 1.0), ("double_sphere", "xi"): (-0.99, 2.0)}
)
_SHAPES: dict[str, list[tuple[dict[str, float], float]]] = {
    "unified": [({"xi": xi}, 1 + xi) for xi in (0.5, 0.9, 1.3, 2.0)],
    "hyperboloid": [({"xi": xi}, 1 + xi) for xi in (0.5, 0.8, 0.95)],
    "eucm": [({"alpha": alpha, "beta": beta}, 1.0) for alpha in (0.4, 0.55, 0.7) for beta in (1.0, 1.5)],
    "double_sphere": [({"xi": xi, "alpha": alpha}, 1 + xi) for xi in (-0.25, 0.0, 0.3) for alpha in (0.45, 0.6)],
    "kannala_brandt": [({}, 1.0)],
}
"""For each model the shapes to begin with, and the focal length that gives them a slope of 1 on the axis."""
