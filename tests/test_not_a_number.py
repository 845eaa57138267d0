"""What is not a number: refused where an image is made, and never a match where one is given."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from scipy import ndimage

from harness.camera.fill import touches, without_gaps
from harness.camera.intrinsics import Camera
from harness.camera.sensor import Sensor, project
from harness.camera.unwrap import unwrap
from harness.errors import InputError
from harness.geometry.angles import normalise
from harness.geometry.panorama import Grid, directions
from harness.geometry.pose import Motion
from harness.matching.filter import laplacian_of_gaussian
from harness.matching.interface import Reason
from harness.matching.pair import Pair, sharing
from harness.matching.registry import BUILT_IN
from harness.pipeline.specification import Exposure, Trial
from harness.pipeline.trial import run_trial
from harness.simulation import render as rendering
from harness.simulation import shading
from harness.simulation.scene import load_scene
from harness.simulation.texture import NoiseTexture
from harness.spec import parse

TINY = Sensor(camera=Camera(width_px=240, height_px=240, focal_px=300, cx_px=119.5, cy_px=119.5))
GRID = Grid(width_px=240, height_px=66)
SETTINGS = {
    "window": ({"window_px": 7}, {"window_px": 7, "subpixel": "images"}, {"window_px": 7, "cost": "census"}),
    "column": ({"window_px": 7}, {"window_px": 7, "subpixel": "images"}, {"window_px": 7, "cost": "zncc"}),
}
CASES = [
    pytest.param(kind, settings, id="-".join([kind, *map(str, settings.values())]))
    for kind in sorted(BUILT_IN)
    if kind != "program"  # is given the images as they are, and answers for itself
    for settings in SETTINGS.get(kind, ({},))
]
GAPS = directions(GRID)[[20, 40, 12], [86, 150, 204]]
"""Directions in the middle of what is not a number: each is the mirror pixel nearest to one of the panorama's."""


@lru_cache(maxsize=2)
def pair(interpolation="bilinear"):
    """Two views of the paper's box."""
    trial = Trial(scene=load_scene("box"), sensor=TINY, panorama=GRID)
    images = [rendering.render(trial.scene, TINY, pose, 4) for pose in trial.poses]
    return Pair(
        images=(images[0], images[1]),
        sensors=(TINY, TINY),
        motion=trial.true_motion,
        grid=GRID,
        interpolation=interpolation,
        threads=1,
    )


def pixels_of_gaps():
    """Row and column of the mirror pixels in the middle."""
    result, valid = project(TINY, GAPS)
    assert valid.all()
    return tuple(np.rint(result[:, ::-1]).astype(int).T)


def damaged(view, value=np.nan):
    """The pair with three spots of a view, 5 x 5 pixels each, that are not numbers."""
    images = [image.copy() for image in pair().images]
    for row, column in zip(*pixels_of_gaps(), strict=True):
        images[view][row - 2 : row + 3, column - 2 : column + 3] = value
    return replace(pair(), images=(images[0], images[1]), share=sharing())


def angle_to_gaps(looking):
    """Least angle, radians, from directions `[..., 3]` to one of the pixels."""
    return np.arccos(np.clip(looking @ GAPS.T, -1, 1)).min(axis=-1)


def direction_in_view_2(motion: Motion, looking, alpha_2):
    """The direction in which view 2 has a match: in the plane of t and the direction, alpha_2 from t."""
    t = normalise(motion.t_v1)
    across = normalise(looking - (looking @ t)[..., None] * t)
    return np.cos(alpha_2)[..., None] * t + np.sin(alpha_2)[..., None] * across


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "settings"), CASES)
@pytest.mark.parametrize("view", [0, 1])
def test_no_match_is_made_of_what_is_not_a_number(kind, settings, view):
    if kind.startswith("opencv"):
        pytest.importorskip("cv2")
    matcher = parse(BUILT_IN[kind], {"kind": kind, **settings})
    whole = matcher.match(pair())
    matched = matcher.match(damaged(view))
    looking = directions(GRID)
    assert np.isfinite(matched.alpha_2[matched.reasons == Reason.MATCHED]).all()
    seen_at = looking if view == 0 else direction_in_view_2(pair().motion, looking, matched.alpha_2)
    at, _ = project(TINY, seen_at)
    rows, columns = pixels_of_gaps()
    near = (np.rint(at[..., 1:]) == rows) & (np.rint(at[..., :1]) == columns)
    near = near.any(axis=-1)
    assert near.any() or view == 1
    assert not (near & ~np.isnan(matched.alpha_2)).any()
    # Pixels far away have the answers they had: more than window, filter and patch reach, in both views.
    far = angle_to_gaps(looking) > 0.5
    for each in (whole, matched):
        at = direction_in_view_2(pair().motion, looking, each.alpha_2)
        far &= ~(angle_to_gaps(at) < 0.5)
    both = far & ~np.isnan(whole.alpha_2)
    assert both.sum() > 100
    lost = both & np.isnan(matched.alpha_2)
    # A spline through a gap is a little another one: 3.7 times less so at every pixel.
    alike = 1e-6 if kind in SETTINGS else 0.1 * GRID.phi_pitch
    changed = both & (np.abs(matched.alpha_2 - whole.alpha_2) > alike)
    # A window matcher gives no answer where any sample of the curve has no whole window.
    assert lost.sum() <= (0.1 if kind in SETTINGS and view == 1 else 0.01) * both.sum()
    # Paths of semi-global matching run through the whole picture, and slanted windows hand planes on.
    assert changed.sum() <= (0 if kind in SETTINGS else 0.02 * both.sum())


@pytest.mark.slow
@pytest.mark.parametrize("kind", sorted({"window", "column", "sgm", "slanted", "opencv-sgbm"} & set(BUILT_IN)))
def test_an_image_of_nothing_but_nan_has_no_match(kind):
    if kind.startswith("opencv"):
        pytest.importorskip("cv2")
    blank = np.full_like(pair().images[0], np.nan)
    for images in ((blank, pair().images[1]), (pair().images[0], blank), (blank, blank)):
        given = replace(pair(), images=images, share=sharing())
        assert np.isnan(parse(BUILT_IN[kind], {"kind": kind}).match(given).alpha_2).all()


@pytest.mark.parametrize("interpolation", ["bilinear", "cubic"])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_panorama_and_filter_leave_out_what_is_not_a_number(interpolation, value):
    clean = unwrap(pair().images[0], TINY, GRID, interpolation=interpolation)
    panorama = unwrap(damaged(0, value).images[0], TINY, GRID, interpolation=interpolation)
    lost = clean.valid & ~panorama.valid
    assert 3 <= lost.sum() <= 200
    assert angle_to_gaps(directions(GRID))[lost].max() < 0.15
    assert np.isfinite(panorama.values).all()
    far = panorama.valid & (angle_to_gaps(directions(GRID)) > 0.3)
    # The spline's prefilter falls by 3.7 a pixel: nothing is left of a gap ten pixels away.
    np.testing.assert_allclose(
        panorama.values[far], clean.values[far], rtol=0, atol=0 if interpolation == "bilinear" else 1e-3
    )
    filtered = laplacian_of_gaussian(panorama, 1.5)
    assert np.isfinite(filtered.values).all()
    assert not (filtered.valid & ndimage.binary_dilation(lost, np.ones((13, 13)))).any()


def test_gaps_are_closed_by_what_is_nearest():
    image = np.arange(12, dtype=np.float32).reshape(3, 4)
    visible = np.ones((3, 4), dtype=bool)
    assert without_gaps(image, visible) == (image, visible) or without_gaps(image, visible)[0] is image
    image[1, 1], image[2, 3] = np.nan, np.inf
    closed, known = without_gaps(image, visible)
    assert closed[1, 1] in {1, 4, 6, 9}
    assert closed[2, 3] in {7, 10}
    np.testing.assert_array_equal(~known, [[0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
    at = np.array([[0.0, 0.5, 1.0, 2.0], [0.0, 0.5, 2.0, 2.5]])
    np.testing.assert_array_equal(touches(~known, at, 1), [False, True, False, True])


# --- Refused where images are made --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("key", "value"), [("gain", 1e300), ("gain", 0.0), ("offset_grey", 1e300), ("gain", float("nan"))]
)
def test_exposure_has_limits(key, value):
    with pytest.raises(InputError, match=key):
        parse(Exposure, {key: value})


def test_noise_without_a_frequency_is_refused():
    band = {"kind": "noise", "seed": 1, "tile_m": 1.0, "size_px": 64}
    with pytest.raises(InputError, match=r"no wavelength that repeats in tile_m = 1 .* widen the band"):
        parse(NoiseTexture, band | {"shortest_m": 0.9, "longest_m": 0.95})
    rng = np.random.default_rng(4)
    accepted = 0
    for _ in range(300):
        shortest, longest = np.sort(rng.uniform(1 / 20, 1, 2))
        cycles = np.hypot(*np.meshgrid(np.fft.fftfreq(64, 1 / 64), np.fft.fftfreq(64, 1 / 64)))
        holds = ((cycles >= 1 / longest) & (cycles <= 1 / shortest)).any()
        try:
            parse(NoiseTexture, band | {"shortest_m": shortest, "longest_m": longest})
            accepted += 1
            assert holds
        except InputError:
            assert not holds
    assert 0 < accepted < 300


def test_an_image_that_is_not_finite_is_refused_by_name(monkeypatch):
    scene = load_scene("box")
    trial = Trial(scene=scene, sensor=TINY, panorama=GRID)
    monkeypatch.setattr(shading, "shade", lambda *arguments: arguments[-1].fill(np.nan))
    with pytest.raises(InputError, match=r"box.*from \(0, 0, 1\) m.*not a finite number"):
        run_trial(trial)


@pytest.mark.parametrize(("stage", "key"), [("with_exposure", "trial.exposure_2"), ("with_noise", "trial.noise")])
def test_a_stage_that_is_not_finite_is_refused_by_its_key(monkeypatch, stage, key):
    trial = Trial(scene=load_scene("box"), sensor=TINY, panorama=GRID)
    monkeypatch.setattr(f"harness.pipeline.trial.{stage}", lambda image, *_: image + np.float32(np.nan))
    with pytest.raises(InputError, match=rf"{key}: scene box: \d+ pixels"):
        run_trial(trial)
