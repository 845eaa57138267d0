"""Mix-ups that the checks tell apart: the truth in another unit, sign, picture or place, said to be something else."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy import ndimage

from harness.geometry.triangulation import range_from_angles
from harness.matching.answers import Answer
from harness.testing.pairs import Scenery, lopsided
from harness.testing.slips import slip_in

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def there() -> Scenery:
    return lopsided()


@pytest.fixture(scope="module")
def range_m(there: Scenery) -> np.ndarray:
    """A matcher's, with errors of a fifth of a column and mismatches on a tenth of the pixels."""
    draws = np.random.default_rng(2)
    shape, pitch = there.alpha_2.shape, there.pair.grid.phi_pitch
    wrong = there.pair.alpha_1 + draws.uniform(0, 0.4, shape)
    alpha_2 = np.where(draws.random(shape) < 0.1, wrong, there.alpha_2 + draws.normal(0, 0.2 * pitch, shape))
    return range_from_angles(there.pair.alpha_1, np.minimum(alpha_2, 3.1), there.pair.motion.baseline_m)


def disparity_deg(there: Scenery, range_m: np.ndarray) -> np.ndarray:
    """By the law of cosines, unlike the program."""
    a_1, t = there.pair.alpha_1, there.pair.motion.baseline_m
    d_2 = np.sqrt(range_m**2 + t**2 - 2 * range_m * t * np.cos(a_1))
    return np.degrees(np.arcsin(np.clip(t * np.sin(a_1) / d_2, -1, 1)))


def alpha_2_deg(there: Scenery, range_m: np.ndarray) -> np.ndarray:
    return np.degrees(there.pair.alpha_1) + disparity_deg(there, range_m)


def in_pixels(there: Scenery, range_m: np.ndarray) -> np.ndarray:
    return disparity_deg(there, range_m) / np.degrees(there.pair.grid.phi_pitch)


def on_the_ground(there: Scenery, range_m: np.ndarray) -> np.ndarray:
    return range_m * np.hypot(there.pair.directions[..., 0], there.pair.directions[..., 1])


SAID: dict[str, tuple[str, Callable[[Scenery, np.ndarray], np.ndarray], str]] = {
    "an angle for a range": ("range_m", lambda t, d: np.radians(alpha_2_deg(t, d)), "in radians: are these metres?"),
    "a disparity for a range": ("range_m", disparity_deg, "degrees: are these metres? Then answer(disparity_deg=...)"),
    "millimetres": ("range_m", lambda _, d: 1000 * d, "ranges in millimetres: are these metres?"),
    "baselines": ("range_m", lambda t, d: d / t.pair.motion.baseline_m, "in units of the baseline: are these metres?"),
    "on the ground": ("range_m", on_the_ground, "distances along the ground, not along the ray: are these metres?"),
    "inverse": ("range_m", lambda _, d: 1 / d, "inverse ranges, 1/metres: are these metres?"),
    "mirrored": ("range_m", lambda _, d: d[:, ::-1], "mirrored left to right"),
    "upside down": ("range_m", lambda _, d: d[::-1], "upside down"),
    "half a circle": ("range_m", lambda _, d: np.roll(d, d.shape[1] // 2, axis=1), "turned by half a circle"),
    "a range for an angle": ("alpha_2", lambda _, d: d, "ranges in metres: are these metres? Then answer(range_m=...)"),
    "a range for a disparity": ("disparity_deg", lambda _, d: d, "ranges in metres: are these metres?"),
    "degrees for radians": ("alpha_2", alpha_2_deg, "alpha_2 in degrees"),
    "radians for degrees": ("disparity_deg", lambda t, d: np.radians(disparity_deg(t, d)), "alpha_1 in radians"),
    "pixels for degrees": ("disparity_deg", in_pixels, "the disparity in pixels"),
    "the sign": ("disparity_deg", lambda t, d: -disparity_deg(t, d), "in degrees with its sign turned over"),
    "the disparity half a pixel off": (
        "disparity_deg",
        lambda t, d: disparity_deg(t, d) + 0.5 * np.degrees(t.pair.grid.phi_pitch),
        "px: are both images sampled at pixel centres?",
    ),
    "half a row": ("disparity_deg", lambda t, d: displaced(disparity_deg(t, d), (0.5, 0)), "displaced by +0.5"),
    "half a column": (
        "disparity_deg",
        lambda t, d: displaced(disparity_deg(t, d), (0, -0.5)),
        "columns: are its pixel",
    ),
}


def displaced(values: np.ndarray, by: tuple[float, float]) -> np.ndarray:
    return ndimage.shift(np.nan_to_num(values, nan=float(np.nanmedian(values))), by, order=1, mode="nearest")


@pytest.mark.parametrize("name", SAID)
def test_what_is_mixed_up_is_asked_about(name: str, there: Scenery, range_m: np.ndarray) -> None:
    quantity, made, text = SAID[name]
    assert text in slip_in(there.pair.answer(**{quantity: made(there, range_m)}), there)


def right_answers(there: Scenery, range_m: np.ndarray) -> dict[str, Answer]:
    return {
        "range_m": there.pair.answer(range_m=range_m),
        "disparity_deg": there.pair.answer(disparity_deg=disparity_deg(there, range_m)),
        "alpha_2": there.pair.answer(alpha_2=there.pair.alpha_1 + np.radians(disparity_deg(there, range_m))),
        "nothing": there.pair.answer(range_m=np.full(range_m.shape, np.nan)),
        "a quarter": there.pair.answer(disparity_deg=displaced(disparity_deg(there, range_m), (0.2, 0.2))),
        "random": there.pair.answer(range_m=np.random.default_rng(1).uniform(1, 10, range_m.shape)),
    }


@pytest.mark.parametrize("name", ["range_m", "disparity_deg", "alpha_2", "nothing", "a quarter", "random"])
def test_what_is_not_mixed_up_is_not_asked_about(name: str, there: Scenery, range_m: np.ndarray) -> None:
    assert slip_in(right_answers(there, range_m)[name], there) == ""


def test_on_pixels_of_its_own(there: Scenery) -> None:
    """Depth for range, swapped views, half the width, half a pixel: on the images that a network works on."""
    camera, rectified = there.pair.perspective(120, 80, elevation_deg=-30), there.pair.rectified(240)
    truth, _ = there.truth(camera.directions)
    depth = truth.range_m * (camera.directions @ camera.projection.axes[2])
    assert "depths along the optical axis, not ranges along the ray: are" in slip_in(
        camera.answer(range_m=depth), there
    )
    assert slip_in(camera.answer(range_m=truth.range_m), there) == ""
    truth, range_2_m = there.truth(rectified.directions)
    point = truth.range_m[..., None] * rectified.directions
    disparity = np.degrees(np.arccos(np.clip(np.sum(point * (point - rectified.t_v1), axis=-1)
        / np.linalg.norm(point, axis=-1) / np.linalg.norm(point - rectified.t_v1, axis=-1), -1, 1)))  # fmt: skip
    pixels = disparity / np.degrees(rectified.projection.step)
    for values, text in (
        (pixels, ""),
        (pixels / 2, "the disparity in pixels of an image of half the size"),
        (-pixels, "the disparity in pixels with its sign turned over"),
        (pixels - 0.5, "px: are both images sampled"),
        (displaced(pixels, (0, 0.5)), "columns: are its pixel centres"),
        (displaced(pixels, (-0.5, 0)), "rows: are its pixel centres"),
    ):
        found = slip_in(rectified.answer(disparity_px=values), there)
        assert text in found
        assert text or not found
    assert "are the views swapped?" in slip_in(rectified.answer(range_m=range_2_m), there)
