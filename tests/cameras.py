"""Random sensors of every camera model, whose field fills most of a 640x480 image."""

from collections.abc import Callable

import numpy as np

from harness.camera.intrinsics import Camera, FieldOfView
from harness.camera.lens import Lens, fold_radius
from harness.camera.models import (
    CameraModel,
    DoubleSphere,
    Equirectangular,
    ExtendedUnified,
    KannalaBrandt,
    OCam,
    Unified,
)
from harness.camera.models.axial import AxialModel
from harness.camera.sensor import Sensor, unproject

Draw = Callable[[np.random.Generator], CameraModel]


def random_ocam(rng: np.random.Generator) -> OCam:
    """A polynomial of degree 4, whose terms are up to a fifth of a_0 at 200 pixels, and one that bends."""
    a_0 = -rng.uniform(100, 200)
    a = [a_0, 0.0, *(-a_0 * rng.uniform([0.2, -0.2, -0.1], [1.0, 0.2, 0.1]) / 200.0 ** np.array([2, 3, 4]))]
    return OCam(coefficients=a, c=rng.uniform(0.9, 1.1), d=rng.uniform(-0.02, 0.02), e=rng.uniform(-0.02, 0.02))


def random_equirectangular(rng: np.random.Generator) -> Sensor:
    """Half of them of 360 degrees, the others of less; rarely up to a pole."""
    focal, aspect = 640 / (2 * np.pi) * rng.choice([1.0, rng.uniform(1, 3)]), rng.uniform(0.8, 1.25)
    above, below = rng.uniform(0.3, 1, 2) * focal * aspect * np.pi / 2
    camera = Camera(
        focal_px=focal, aspect=aspect, cx_px=rng.uniform(0, 639), cy_px=above - 0.5, height_px=int(above + below)
    )
    field = FieldOfView(elevation_min_deg=rng.uniform(-90, -40), elevation_max_deg=rng.uniform(40, 90))
    return sensor_of(Equirectangular(), camera, field=field)


AXIAL: dict[str, Draw] = {
    # xi = 1 is a case of its own: neither end of the image is there.
    "unified": lambda rng: Unified(xi=rng.choice([0.0, 1.0, rng.uniform(0, 1), rng.uniform(1, 3)])),
    # So is alpha = 1/2.
    "eucm": lambda rng: ExtendedUnified(alpha=rng.choice([0.5, rng.uniform(0, 1)]), beta=rng.uniform(0.5, 2)),
    "double_sphere": lambda rng: DoubleSphere(
        xi=rng.choice([0.0, 1.0, rng.uniform(-0.6, 1), rng.uniform(1, 2)]), alpha=rng.choice([0.5, rng.uniform(0, 1)])
    ),
    "kannala_brandt": lambda rng: KannalaBrandt(
        k1=rng.uniform(-0.1, 0.1), k2=rng.uniform(-0.03, 0.03), k3=rng.uniform(-0.01, 0.01), k4=rng.uniform(-2e-3, 2e-3)
    ),
    "ocam": random_ocam,
}
"""A random model of each kind."""

KINDS = [*AXIAL, "equirectangular"]
"""All but the hyperboloid, whose tests are in `test_camera.py`."""


def sensor_of(model: CameraModel, camera: Camera, lens: Lens | None = None, field: FieldOfView | None = None) -> Sensor:
    return Sensor(model=model, camera=camera, lens=lens or Lens(), field=field or FieldOfView())


def random_sensor(kind: str, seed: int, *, lens: bool = False, skew: bool = False) -> Sensor:
    """A sensor of a kind; its lens up to a tenth of the radius at the rim, its skew up to 2 % of the focal length."""
    rng = np.random.default_rng([seed, sum(map(ord, kind)), lens, skew])
    if kind == "equirectangular":
        return random_equirectangular(rng)
    while True:
        model = AXIAL[kind](rng)
        assert isinstance(model, AxialModel)
        camera = {
            "aspect": rng.uniform(0.8, 1.25),
            "cx_px": 319.5 + rng.uniform(-40, 40),
            "cy_px": 239.5 + rng.uniform(-40, 40),
        }
        bent = Lens()
        largest = model.largest_angle_rad(Camera(), bent)
        angle = rng.uniform(0.5, 0.97) * largest
        if model.kind == "ocam":  # its scale is its own: the field is what is seen at 180 to 300 pixels
            angle = min(angle, model.angle(rng.uniform(180, 300)))
            if model.radius(angle, bent) < 150:
                continue
        rim = model.radius(angle, bent)
        if lens:
            k = rng.uniform(-0.06, 0.06, 3) / rim ** np.array([2, 4, 6])
            p = rng.uniform(-0.005, 0.005, 2) / rim
            bent = Lens(k1=k[0], k2=k[1], k3=k[2], p1=p[0], p2=p[1])
            if fold_radius(bent) < 1.1 * rim:
                continue
        if "focal_px" not in model.unused:
            camera["focal_px"] = rng.uniform(180, 300) / rim
            if skew:
                camera["skew_px"] = rng.uniform(-0.02, 0.02) * camera["focal_px"]
        field = FieldOfView(elevation_min_deg=90 - np.degrees(angle), elevation_max_deg=90)
        return sensor_of(model, Camera(**{k: v for k, v in camera.items() if k not in model.unused}), bent, field)


def seen_pixels(sensor: Sensor, seed: int, count: int = 1000) -> tuple[np.ndarray, np.ndarray]:
    """Random places on the image `[n, 2]` that see something, and the unit directions `[n, 3]` that they see."""
    camera = sensor.camera
    rng = np.random.default_rng(seed)
    pixels = rng.uniform([-0.5, -0.5], [camera.width_px - 0.5, camera.height_px - 0.5], (count, 2))
    directions, valid = unproject(sensor, pixels)
    assert valid.sum() > 0.2 * count
    return pixels[valid], directions[valid]
