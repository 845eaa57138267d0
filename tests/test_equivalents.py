"""Cameras of one model in another: the same to the last digits where they can be, else the nearest, and by how much."""

import dataclasses

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from harness.camera.equivalents import equivalent
from harness.camera.intrinsics import Camera
from harness.camera.lens import Lens
from harness.camera.model_fitting import Target, convert
from harness.camera.models import MODELS
from harness.camera.optics import Optics, edge_pixels
from harness.errors import InputError

CAMERA = Camera(focal_px=290.0, aspect=1.03, skew_px=2.5, cx_px=310.0, cy_px=244.0)
NARROW = CAMERA.model_copy(update={"focal_px": 900.0})
"""As of a camera that looks at a mirror from afar."""
PLAIN = CAMERA.model_copy(update={"skew_px": 0.0})
BARE = Camera(cx_px=310, cy_px=244)
LENS = Lens(k1=-0.03, k2=0.01, p1=1e-3, p2=-2e-3, k3=-1e-3)


def optics(kind, camera=CAMERA, lens=None, **keys):
    return Optics(MODELS[kind].model_validate({"kind": kind} | keys), camera, lens or Lens())


def seen(first, most_deg, every=8):
    """Pixels of the image up to an angle off the axis."""
    v, u = np.mgrid[0 : first.camera.height_px : every, 0 : first.camera.width_px : every]
    pixels = np.stack([u.ravel(), v.ravel()], axis=-1).astype(float)
    z = first.unproject(pixels)[:, 2]
    with np.errstate(invalid="ignore"):
        return pixels[z > np.cos(np.radians(most_deg))]


PAIRS = [
    (optics("unified", xi=0.4, lens=LENS), "hyperboloid"),
    (optics("unified", xi=0.966, lens=LENS), "hyperboloid"),
    (optics("hyperboloid", NARROW, a_m=0.03, b_m=0.02, lens=LENS), "unified"),
    (optics("hyperboloid", NARROW, a_m=0.03, b_m=0.02), "eucm"),
    (optics("unified", xi=0.0), "eucm"),
    (optics("unified", xi=0.7), "double_sphere"),
    (optics("unified", xi=1.9), "eucm"),
    (optics("unified", xi=1.0), "ocam"),
    (optics("eucm", alpha=0.5, beta=1.0), "ocam"),
    (optics("eucm", alpha=0.45, beta=1.0), "hyperboloid"),
    (optics("eucm", alpha=0.6, beta=1.0), "double_sphere"),
    (optics("double_sphere", xi=0.0, alpha=0.62), "unified"),
    (optics("double_sphere", xi=0.8, alpha=0.0), "unified"),
    (optics("double_sphere", xi=0.8, alpha=0.0), "hyperboloid"),
]


@pytest.mark.parametrize(("first", "kind"), PAIRS, ids=[f"{pair[0].model.kind} in {pair[1]}" for pair in PAIRS])
def test_the_same_camera_in_another_model_has_the_same_rays(first, kind):
    """Two unprojections of a few roundings each; the lens is undone to 1e-13 of the radius."""
    second = equivalent(first, kind)
    assert second.model.kind == kind
    pixels = seen(first, 100)
    assert len(pixels) > 1000
    assert np.abs(first.unproject(pixels) - second.unproject(pixels)).max() < 1e-11
    rays = first.unproject(pixels)
    assert np.abs(second.project(rays) - pixels).max() < 1e-8


def test_there_and_back_gives_the_same_parameters():
    first = optics("unified", xi=0.6, lens=LENS)
    back = equivalent(equivalent(first, "hyperboloid"), "unified")
    assert back.model.xi == pytest.approx(0.6, rel=1e-14)
    assert list(back.lens.model_dump().values()) == pytest.approx(list(LENS.model_dump().values()), rel=1e-13)
    assert back.camera.focal_px == pytest.approx(290, rel=1e-14)


@pytest.mark.parametrize(
    ("first", "kind"),
    [
        (optics("unified", xi=1.2), "hyperboloid"),
        (optics("unified", xi=0.6, lens=LENS), "eucm"),
        (optics("eucm", alpha=0.6, beta=1.1), "unified"),
        (optics("eucm", alpha=1.0, beta=1.0), "unified"),
        (optics("double_sphere", xi=0.1, alpha=0.5), "eucm"),
        (optics("unified", xi=0.999), "ocam"),
        (optics("kannala_brandt", k1=0.0, k2=0.0, k3=0.0, k4=0.0), "ocam"),
    ],
)
def test_where_no_camera_is_the_same_there_is_none(first, kind):
    assert equivalent(first, kind) is None


class TestNearest:
    def test_comes_to_the_same_camera_as_the_difference_vanishes(self):
        """EUCM is the unified model but for k1: the residual falls with k1, and xi comes to alpha/(1 - alpha)."""
        converted = {}
        for k1 in (1e-3, 1e-5):
            first = optics("unified", PLAIN, Lens(k1=k1), xi=0.9)
            converted[k1] = convert(first, seen(first, 90), Target("eucm"))
        assert not converted[1e-5].is_exact
        # In proportion, but for what is of second order in the larger one.
        assert converted[1e-3].rms_px / converted[1e-5].rms_px == pytest.approx(100, rel=0.05)
        assert converted[1e-5].optics.model.alpha == pytest.approx(0.9 / 1.9, abs=1e-3)
        assert converted[1e-5].optics.camera.focal_px == pytest.approx(290 / 1.9, rel=1e-3)

    @pytest.mark.long
    @pytest.mark.parametrize(
        ("first", "target", "most_px"),
        [
            (optics("double_sphere", PLAIN, xi=-0.18, alpha=0.59), Target("kannala_brandt"), 0.02),
            (optics("double_sphere", PLAIN, xi=-0.18, alpha=0.59), Target("eucm"), 0.2),
            (optics("kannala_brandt", PLAIN, k1=0.01, k2=-2e-3, k3=0.0, k4=0.0), Target("ocam"), 0.05),
            (optics("kannala_brandt", PLAIN, k1=0.01, k2=-2e-3, k3=0.0, k4=0.0), Target("double_sphere"), 0.5),
            pytest.param(
                optics("unified", PLAIN, Lens(k1=0.05), xi=1.2), Target("hyperboloid"), 0.05, marks=pytest.mark.slow
            ),
            (optics("ocam", BARE, coefficients=[-250, 0, 1e-3, 0, 2e-9], c=1.01, e=2e-4), Target("unified"), 0.5),
        ],
        ids=lambda each: getattr(each, "kind", None) or (each.model.kind if isinstance(each, Optics) else None),
    )  # fmt: skip
    def test_no_parameter_can_be_bettered(self, first, target, most_px):
        """Along each parameter the sum of squares, of exact angles, is least where the fit ended."""
        pixels = seen(first, 85)
        converted = convert(first, pixels, target)
        assert converted.rms_px < most_px
        rays = first.unproject(pixels)

        def worse(camera):
            return np.sum((camera.unproject(pixels) - rays) ** 2)

        best = converted.optics
        least = worse(best)
        for key in ("focal_px", "aspect", "cx_px", "cy_px"):
            if key in best.model.unused:
                continue
            value = getattr(best.camera, key)

            def moved(step, key=key, value=value):
                return worse(dataclasses.replace(best, camera=best.camera.model_copy(update={key: value * (1 + step)})))

            nearer = minimize_scalar(moved, bounds=(-1e-3, 1e-3), method="bounded", options={"xatol": 1e-9})
            # The fit has 1,500 of these pixels, and stops at 1e-10 of its sum.
            assert nearer.fun > least * (1 - 0.02), key

    def test_residuals_are_those_of_the_two_cameras(self):
        """By the angle between their rays, from the cross product, and the distance between their pixels."""
        first = optics("kannala_brandt", PLAIN, k1=0.03, k2=-4e-3, k3=0.0, k4=0.0)
        pixels = seen(first, 80)
        converted = convert(first, pixels, Target("eucm"))
        one, other = first.unproject(pixels), converted.optics.unproject(pixels)
        angles = np.arcsin(np.linalg.norm(np.cross(one, other), axis=-1))
        apart = np.linalg.norm(converted.optics.project(one) - pixels, axis=-1)
        assert converted.largest_rad == pytest.approx(angles.max(), rel=1e-9)
        assert converted.rms_rad == pytest.approx(np.sqrt(np.mean(angles**2)), rel=1e-9)
        assert (converted.largest_px, converted.rms_px) == pytest.approx(
            (apart.max(), np.sqrt(np.mean(apart**2))), rel=1e-9
        )
        off_axis = np.degrees(np.arccos(one[:, 2]))
        assert np.degrees(converted.angles_rad) == pytest.approx((off_axis.min(), off_axis.max()), rel=1e-9)
        assert converted.pixels == len(pixels)

    @pytest.mark.slow
    def test_a_file_without_skew_gets_a_camera_without(self):
        first = optics("unified", xi=0.9)
        converted = convert(first, seen(first, 90), Target("unified", skew=False))
        assert not converted.is_exact
        assert converted.optics.camera.skew_px == 0
        # A shear of 2.5/290 over half the image, less what a turned ellipse gives back.
        assert 0.1 < converted.rms_px < 2.5

    def test_what_no_camera_of_a_model_reaches_is_refused(self):
        """A fisheye's polynomial goes on to 142° in the corners, where the ellipsoid's image has folded back."""
        first = optics("ocam", BARE, coefficients=[-206, 0, 2.2e-3, -4.5e-6, 1.8e-8])
        with pytest.raises(
            InputError, match=r"no extended unified camera approximates this camera: .* would have no direction"
        ):
            convert(first, seen(first, 150), Target("eucm"))


@pytest.mark.parametrize(
    ("first", "width"),
    [
        (optics("hyperboloid", NARROW), 640),
        (optics("eucm", alpha=0.6, beta=1.1), 640),
        (optics("equirectangular", Camera(width_px=640, height_px=320, focal_px=320 / np.pi, cy_px=159.5)), 640),
    ],
    ids=["a mirror", "a lens", "a panorama"],
)
def test_optics_are_in_the_lens_frame(first, width):
    """X along u, Y along v, Z into the scene; derivatives against central differences with a step of 1e-5."""
    rays = np.array([[0.1, -0.2, 0.9], [-0.4, 0.3, 0.7]])
    pixels = first.project(rays)
    assert np.abs(first.unproject(pixels) - rays / np.linalg.norm(rays, axis=-1, keepdims=True)).max() < 1e-12
    slopes = first.jacobian(rays)
    for axis in range(3):
        step = 1e-5 * np.eye(3)[axis]
        numeric = (first.project(rays + step) - first.project(rays - step)) / 2e-5
        assert slopes[..., axis] == pytest.approx(numeric, abs=1e-5)
    assert (slopes[:, 0, 0] > 0).all()
    assert (slopes[:, 1, 1] > 0).all()
    assert first.camera.width_px == width


def test_the_border_is_half_a_pixel_outside_the_outermost_centres():
    edge = edge_pixels(CAMERA)
    assert edge.min(axis=0).tolist() == [-0.5, -0.5]
    assert edge.max(axis=0).tolist() == [639.5, 479.5]


def test_the_largest_angle_on_an_image_is_that_of_a_corner():
    """By hand, of an equidistant lens: the farthest corner's distance over the focal length."""
    first = optics("kannala_brandt", PLAIN, k1=0.0, k2=0.0, k3=0.0, k4=0.0)
    corner = np.hypot((639.5 - 310) / 290, (-0.5 - 244) / (290 * 1.03))
    assert first.largest_angle_on_image() == pytest.approx(corner, rel=1e-12)
    mirror = optics("hyperboloid", PLAIN)
    assert mirror.unproject([[310.0, 244.0]])[0] == pytest.approx([0, 0, 1], abs=1e-15)
    assert mirror.project([[0.0, 0.0, 2.0]])[0] == pytest.approx([310, 244])
