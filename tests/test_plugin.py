"""What a third-party matcher is given, and what it may answer."""

from dataclasses import replace

import numpy as np
import pytest
from plugin_modules import Write

from harness.camera.intrinsics import Camera
from harness.camera.sensor import Sensor
from harness.errors import InputError
from harness.geometry.panorama import Grid
from harness.geometry.pose import Motion, Pose, relative_motion
from harness.matching.interface import Matches, Reason, as_matches, faults
from harness.matching.pair import Pair
from harness.matching.registry import Plugin


@pytest.fixture
def pair() -> Pair:
    sensor = Sensor(camera=Camera(width_px=160, height_px=120, focal_px=153.53, cx_px=79.5, cy_px=59.5))
    draws = np.random.default_rng(1)
    images = [draws.uniform(0, 255, (120, 160)).astype(np.float32) for _ in (1, 2)]
    motion = relative_motion(Pose(), Pose(position_m=(0.3, 0.1, 0.05), yaw_deg=20))
    return Pair((images[0], images[1]), (sensor, sensor), motion, Grid(width_px=60, height_px=16))


# --- What an author gets ------------------------------------------------------------------------------------------


def test_nothing_that_a_matcher_is_given_can_be_written_to(pair: Pair) -> None:
    given = [*pair.images, pair.motion.R_v2_from_v1, pair.t_v1, pair.directions]
    for panorama in (*pair.panoramas(), *pair.filtered()):
        given += [panorama.values, panorama.valid]
    for array in given:
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0


def test_the_arrays_of_whoever_made_the_pair_stay_theirs(pair: Pair) -> None:
    image, t = np.zeros((120, 160), np.float32), np.array([0.3, 0.0, 0.0])
    made = replace(pair, images=(image, image), motion=Motion(np.eye(3), t))
    image[0, 0] = t[0] = 7
    assert made.images[0][0, 0] == 0
    assert made.t_v1[0] == 0.3


def test_panoramas_are_made_when_asked_for_and_once(pair: Pair) -> None:
    asked: list[str] = []
    share = pair.share

    def counting(stage, key, make):
        return share(stage, key, lambda: asked.append(stage) or make())

    counted = replace(pair, share=counting)
    assert asked == []
    assert counted.filtered()[0] is counted.filtered()[0]
    assert counted.panoramas()[1] is counted.panoramas()[1]
    assert asked == ["unwrap", "unwrap", "filter", "filter"]
    counted.filtered(2.0)
    assert asked[4:] == ["filter", "filter"]


def test_pixel_directions_and_angles(pair: Pair) -> None:
    """phi and z by hand for one pixel: column 14 of 60 is centred at -93°, row 3 of 16 at 3.5 pitches."""
    phi, z = np.radians(-180 + 14.5 * 6), 0.34 - 3.5 * (0.34 + 1.4053) / 16
    x = np.array([np.cos(phi), np.sin(phi), z]) / np.sqrt(1 + z**2)
    np.testing.assert_allclose(pair.directions[3, 14], x, atol=1e-15)  # a few roundings of numbers below 1
    cosine = x @ pair.t_v1 / np.linalg.norm(pair.t_v1)
    np.testing.assert_allclose(pair.alpha_1[3, 14], np.arccos(cosine), atol=1e-14)  # far from 0, where arccos is good


def test_two_matchers_with_the_same_words_share_nothing(pair: Pair) -> None:
    mine, yours = replace(pair, owner="mine:f"), replace(pair, owner="yours:f")
    assert mine.shared("costs", (5,), lambda: "mine") == "mine"
    assert yours.shared("costs", (5,), lambda: "yours") == "yours"
    assert mine.shared("costs", (5,), lambda: "again") == "mine"


def test_parameters_are_the_matchers_to_change(module: Write, pair: Pair) -> None:
    name = module("def f(pair, limits, some):\n    some.append(4)\n    return pair.alpha_1 + 0.001 * len(some)\n")
    matcher = Plugin(kind=f"{name}:f", parameters={"some": [1]})
    first, second = (matcher.match(pair).alpha_2 for _ in (1, 2))
    np.testing.assert_array_equal(first, second)
    assert matcher.parameters == {"some": [1]}


@pytest.mark.parametrize(
    ("body", "said"),
    [
        ("raise ValueError('what now')", "fails: ValueError: what now ("),
        ("raise SystemExit", "fails: SystemExit"),
        ("pair.images[0][0] = 1", "a pair's arrays are shared: change a copy"),
        (
            "return 3",
            "alpha_2 as an array, a pair (alpha_2, confidence), Matches, or views.answer(...); it returned int",
        ),
    ],
)
def test_a_matcher_that_fails(body: str, said: str, module: Write, pair: Pair) -> None:
    name = module(f"def f(pair, limits):\n    {body}\n")
    with pytest.raises(InputError) as caught:
        Plugin(kind=f"{name}:f").match(pair)
    assert str(caught.value).startswith(f"{name}:f: ")
    assert said in str(caught.value)
    if "what now" in said:
        assert f"{name}.py, line 2)" in str(caught.value)


# --- What may be answered -----------------------------------------------------------------------------------------

GRID = Grid(width_px=16, height_px=4)
GOOD = np.full(GRID.shape, 1.5)
HALF = np.where(np.arange(16) < 8, GOOD, np.nan)
CODES = np.where(np.isnan(HALF), 6, 0)


def with_one(value: float, base: np.ndarray = GOOD) -> np.ndarray:
    changed = base.copy()
    changed[1, 3] = value
    return changed


@pytest.mark.parametrize(
    "answer",
    [
        GOOD,
        GOOD.astype(np.float32),
        HALF,
        (HALF, HALF),
        Matches(HALF, confidence=-HALF, sigma_alpha_2=HALF / 100),
        Matches(HALF, reason=CODES, refined=CODES == 0, k=HALF),
        Matches(HALF, (HALF * 10) // 1, reason=CODES.astype(np.uint8)),
    ],
)
def test_good_answers_are_copied(answer: object) -> None:
    assert not list(faults(answer, GRID))
    matches = as_matches(answer, GRID, "mine")
    given = answer[0] if isinstance(answer, tuple) else getattr(answer, "alpha_2", answer)
    np.testing.assert_array_equal(matches.alpha_2, given)
    assert matches.alpha_2.dtype == np.float64
    assert not np.shares_memory(matches.alpha_2, given)
    assert not matches.alpha_2.flags.writeable
    np.testing.assert_array_equal(matches.reasons == Reason.MATCHED, ~np.isnan(given))


@pytest.mark.parametrize(
    ("answer", "rule", "said"),
    [
        (
            None,
            "form",
            "alpha_2 as an array, a pair (alpha_2, confidence), Matches, or views.answer(...); it returned NoneType",
        ),
        ([GOOD, GOOD], "form", "it returned list"),
        ((GOOD, GOOD, GOOD), "form", "it returned tuple"),
        (Matches(None), "form", "alpha_2 is missing"),
        (Matches(GOOD.tolist()), "form", "alpha_2 must be a NumPy array; it is list"),
        (np.ma.masked_array(GOOD), "form", "alpha_2 must be a plain array with NaN where there is no match"),
        (GOOD[:3], "shape", "alpha_2 must have the panorama's shape (4, 16); it has (3, 16)"),
        ((GOOD, GOOD.T), "shape", "confidence must have the panorama's shape (4, 16); it has (16, 4)"),
        (GOOD > 0, "dtype", "alpha_2 must be an array of real numbers; its dtype is bool"),
        (GOOD + 0j, "dtype", "its dtype is complex128"),
        (GOOD.astype(object), "dtype", "its dtype is object"),
        (
            with_one(np.inf),
            "angles",
            "alpha_2 must lie within 0 .. pi radians, or be NaN for no match; it is inf at [1, 3]",
        ),
        (with_one(-0.1), "angles", "it is -0.1 at [1, 3]"),
        (np.degrees(GOOD), "angles", "it is 85.9437 at [0, 0], and wrong at 64 pixels in all"),
        ((GOOD, with_one(np.nan)), "missing", "confidence must be finite where there is a match; it is nan at [1, 3]"),
        ((GOOD, with_one(np.inf)), "missing", "confidence must be finite where there is a match; it is inf at [1, 3]"),
        (
            (HALF, GOOD),
            "missing",
            "confidence must be NaN where there is no match; it is 1.5 at [0, 8], and wrong at 32",
        ),
        (Matches(HALF, sigma_alpha_2=GOOD), "missing", "sigma_alpha_2 must be NaN where there is no match"),
        (Matches(GOOD, sigma_alpha_2=with_one(0)), "angles", "sigma_alpha_2 must be above zero; it is 0 at [1, 3]"),
        (Matches(HALF, k=GOOD), "missing", "k must be NaN where there is no match"),
        (Matches(HALF, reason=CODES + max(Reason)), "missing", "reason must be one of 0 .. "),
        (
            Matches(GOOD, reason=CODES),
            "missing",
            "reason must be 0 (matched) exactly where alpha_2 is not NaN; it is 6 at",
        ),
        (Matches(HALF, reason=HALF), "dtype", "reason must be an array of whole numbers; its dtype is float64"),
        (
            Matches(HALF, refined=GOOD > 0),
            "missing",
            "refined must be false where there is no match; it is True at [0, 8]",
        ),
        (Matches(HALF, refined=CODES), "dtype", "refined must be an array of booleans"),
    ],
)
def test_bad_answers_are_refused_in_words(answer: object, rule: str, said: str) -> None:
    result = list(faults(answer, GRID))
    assert said in result[0].text
    assert result[0].rule == rule
    with pytest.raises(InputError) as caught:
        as_matches(answer, GRID, "mine:f")
    assert str(caught.value) == f"mine:f: {result[0].text}"
