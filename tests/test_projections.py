"""The images that a matcher may ask for, and its answers on them: half pixels, signs and units, against analytic
geometry, brute-force loops and OpenCV's own rectification."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from harness.camera.intrinsics import Camera
from harness.camera.sensor import Sensor, project
from harness.errors import InputError
from harness.geometry.panorama import Grid, directions
from harness.geometry.pose import Motion, Pose, relative_motion
from harness.matching.answers import Answer, converted
from harness.matching.interface import Reason, as_matches, faults
from harness.matching.opencv.rectify import Rectangle, frame_along
from harness.matching.pair import Pair
from harness.matching.projections import Equirectangular, Perspective, Projection, Rectified, perspective
from harness.matching.views import Views

T = (0.3, 0.1, 0.05)
LEVEL = (0.4, -0.2, 0.0)
UP = (0.0, 0.0, 0.5)


def pinhole(t: tuple[float, float, float] | None, azimuth_deg: float | None = 70.0) -> Perspective:
    return perspective(60, 40, 80.0, azimuth_deg, -15.0, None if t is None else np.array(t))


KINDS: dict[str, Callable[[tuple[float, float, float]], Projection]] = {
    "equirectangular": lambda _t: Equirectangular(30, 64, math.radians(60), math.radians(-75)),
    "rows": lambda t: Rectified(64, 32, t, "rows"),
    "columns": lambda t: Rectified(32, 64, t, "columns"),
    "perspective": pinhole,
    "free": lambda _t: pinhole(None),
}

vectors = st.tuples(*[st.floats(-1, 1).map(lambda x: round(x, 3))] * 3).filter(lambda t: np.linalg.norm(t) > 0.1)


@given(st.sampled_from(sorted(KINDS)), vectors, st.floats(0, 1), st.floats(0, 1))
def test_a_pixel_sees_the_direction_that_it_looks_in(kind: str, t: tuple, down: float, right: float) -> None:
    if kind == "perspective" and np.linalg.norm(np.cross(t, pinhole(None).forward)) < 0.1 * np.linalg.norm(t):
        t = UP
    projection = KINDS[kind](t)
    row, column = down * (projection.height_px - 1), right * (projection.width_px - 1)
    looking = projection.looking(row, column)
    assert np.linalg.norm(looking) == pytest.approx(1, abs=1e-14)
    # Angles of 1e-16, and near a pole, where a direction hardly depends on the azimuth, 1e-16 over its distance.
    assert projection.pixel_of(2.5 * looking) == pytest.approx((row, column), abs=1e-9)


@pytest.mark.parametrize("t", [T, LEVEL, UP, (-0.1, 0.2, -0.4)])
@pytest.mark.parametrize("kind", KINDS)
def test_no_image_is_a_mirror_image(kind: str, t: tuple) -> None:
    """To the right, down and into the picture are a right-handed frame."""
    projection = KINDS[kind](t)
    row, column = projection.height_px / 2 - 3, projection.width_px / 2 + 5
    here = projection.looking(row, column)
    right, down = projection.looking(row, column + 0.01) - here, projection.looking(row + 0.01, column) - here
    assert np.cross(right, down) @ here > 0


def test_where_pixels_look_by_hand() -> None:
    """Pixel centres are at whole numbers, so that the edges of an image are half a pixel beyond."""
    panorama = Equirectangular(180, 360)
    for (row, column), expected in {
        (89.5, 179.5): (1, 0, 0),  # the middle
        (89.5, 89.5): (0, 1, 0),  # the left is on the left
        (89.5, 269.5): (0, -1, 0),
        (-0.5, 33): (0, 0, 1),
        (179.5, 33): (0, 0, -1),
    }.items():
        assert panorama.looking(row, column) == pytest.approx(expected, abs=1e-15)
    row, column = panorama.pixel_of([1.0, 0.001, 0.001])
    assert (row, column) == pytest.approx((89.5 - math.degrees(0.001), 179.5 - math.degrees(0.001)), abs=1e-7)
    rows = Rectified(360, 180, (2.0, 0.0, 0.0), "rows")  # columns from -t to t, what is below in the middle
    assert rows.looking(179.5, -0.5) == pytest.approx((-1, 0, 0), abs=1e-15)
    assert rows.looking(179.5, 89.5) == pytest.approx((0, 0, -1), abs=1e-15)
    assert rows.looking(179.5 - 90, 89.5) == pytest.approx((0, 1, 0), abs=1e-15)
    columns = Rectified(180, 360, (2.0, 0.0, 0.0), "columns")  # -t above
    assert columns.looking(-0.5, 179.5) == pytest.approx((-1, 0, 0), abs=1e-15)
    assert columns.looking(89.5, 179.5) == pytest.approx((0, 0, -1), abs=1e-15)
    # A pinhole camera of 90 degrees: its left edge is 45 degrees from its axis.
    camera = perspective(100, 60, 90.0, 90.0, 0.0, np.array([0.5, 0, 0]))
    assert camera.focal_px == pytest.approx(50)
    assert camera.looking(29.5, 49.5) == pytest.approx((0, 1, 0), abs=1e-15)
    assert camera.looking(29.5, -0.5) == pytest.approx((-math.sqrt(0.5), math.sqrt(0.5), 0), abs=1e-15)
    assert camera.looking(59.5, 49.5)[2] < 0


@pytest.mark.parametrize("t", [T, LEVEL])
def test_rectified_columns_are_those_of_opencv(t: tuple) -> None:
    """OpenCV's rectangle counts its half planes the other way round and from the top: the columns are the same."""
    mine, theirs = Rectified(64, 32, t, "rows"), Rectangle(64)
    _, column = theirs.pixels_of(frame_along(np.array(t)), mine.directions)
    np.testing.assert_allclose(column, np.broadcast_to(np.arange(32), (64, 32)), atol=1e-12)


# --- The images ---------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def pair() -> Pair:
    sensor = Sensor(camera=Camera(width_px=160, height_px=120, focal_px=153.53, cx_px=79.5, cy_px=59.5))
    draws = np.random.default_rng(1)
    images = [draws.uniform(0, 255, (120, 160)).astype(np.float32) for _ in (1, 2)]
    motion = relative_motion(Pose(), Pose(position_m=T, yaw_deg=20))
    return Pair((images[0], images[1]), (sensor, sensor), motion, Grid(width_px=60, height_px=16))


def asked(pair: Pair) -> dict[str, Views]:
    return {
        "equirectangular": pair.equirectangular(48, elevation_deg=(-60, 20)),
        "rows": pair.rectified(48),
        "columns": pair.rectified(48, along="columns"),
        "perspective": pair.perspective(30, 20, elevation_deg=-30),
        "free": pair.perspective(30, 20, azimuth_deg=200, elevation_deg=-30, rectified=False),
    }


def test_images_are_sampled_where_their_pixels_look(pair: Pair) -> None:
    """Against bilinear interpolation by hand, pixel by pixel; view 2 is turned into view 1's orientation."""
    for name, views in asked(pair).items():
        assert views.valid[0].mean() > 0.2, name
        for view, R in enumerate((np.eye(3), pair.motion.R_v2_from_v1)):
            values, valid = views.images[view], views.valid[view]
            assert not values[~valid].any()
            for row, column in np.argwhere(valid)[::7]:
                (u, v), _ = project(pair.sensors[view], R @ views.projection.looking(row, column))
                left, top = math.floor(u), math.floor(v)
                image = pair.images[view].astype(float)
                across = [
                    (left + 1 - u) * image[top + i, left] + (u - left) * image[top + i, min(left + 1, 159)]
                    for i in (0, 1)
                ]
                expected = (top + 1 - v) * across[0] + (v - top) * across[1]
                assert values[row, column] == pytest.approx(expected, abs=1e-3)  # greys of single precision


def test_images_are_made_once(pair: Pair) -> None:
    made: list[str] = []
    share = pair.share
    counted = replace(pair, share=lambda stage, key, make: share(stage, key, lambda: made.append(stage) or make()))
    assert counted.rectified(52).images[0] is replace(counted, owner="another").rectified(52).images[0]
    assert made == ["project", "project"]
    counted.rectified(52, colour=True)
    counted.rectified(52, along="columns")
    assert len(made) == 6
    with pytest.raises(ValueError, match="read-only"):
        counted.rectified(52).images[0][0, 0] = 1


def test_colours_are_the_grey_image_thrice_or_the_pairs_own(pair: Pair) -> None:
    views = pair.equirectangular(48, colour=True)
    grey = pair.equirectangular(48).images[0]
    assert views.images[0].shape == (24, 48, 3)
    np.testing.assert_array_equal(views.images[0], np.repeat(grey[..., None], 3, axis=-1))
    colourful = replace(
        pair, keys=(object(), object()), bands=lambda view: tuple(pair.images[view] / k for k in (1, 2, 4))
    )
    np.testing.assert_allclose(
        colourful.equirectangular(48, colour=True).images[0], grey[..., None] / [1, 2, 4], atol=1e-4
    )


@pytest.mark.parametrize(
    ("ask", "said"),
    [
        (lambda pair: pair.equirectangular(1), "width: must be a whole number of pixels from 2 to 16384; found 1"),
        (lambda pair: pair.equirectangular(64, elevation_deg=(20, -60)), "the upper above the lower"),
        (lambda pair: pair.rectified(49), "around_px: must be even; found 49"),
        (lambda pair: pair.rectified(48, along="row"), "along: must be 'rows' or 'columns'; found 'row'"),
        (lambda pair: pair.perspective(30, 20, fov_deg=180), "fov_deg: must lie within 1 .. 170 degrees; found 180"),
        (
            lambda pair: pair.perspective(30, 20, azimuth_deg=math.degrees(math.atan2(0.1, 0.3)), elevation_deg=8.99),
            "azimuth_deg: the camera would look along the baseline",
        ),
    ],
)
def test_images_that_cannot_be_had(ask: Callable[[Pair], Views], said: str, pair: Pair) -> None:
    with pytest.raises(InputError) as caught:
        ask(pair)
    assert said in str(caught.value)


# --- The answers --------------------------------------------------------------------------------------------------

GRID = Grid(width_px=90, height_px=24)
HEIGHT_M = 0.9


def floor_range(looking: np.ndarray) -> np.ndarray:
    """The range of a level floor below and a ceiling above: that of a plane is its distance over the cosine."""
    return HEIGHT_M / np.maximum(np.abs(looking[..., 2]), 0.05)


def angle(a: np.ndarray, b: np.ndarray) -> float:
    return math.acos(np.clip(a @ b / np.linalg.norm(a) / np.linalg.norm(b), -1, 1))


def angles(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """By the arccos, unlike the program: good to 1e-8 near 0."""
    lengths = np.linalg.norm(a, axis=-1) * np.linalg.norm(b, axis=-1)
    return np.arccos(np.clip(np.sum(a * b, axis=-1) / lengths, -1, 1))


def answer_by_hand(views: Views, quantity: str, half_px: float = 0.0) -> Answer:
    """The floor as a matcher would answer it, by the definition of the quantity."""
    projection, t = views.projection, views.t_v1
    rows, columns = np.indices(views.shape) + half_px
    looking = projection.looking(rows, columns)
    point = floor_range(looking)[..., None] * looking
    parallax = angles(point, point - t)  # the angle at the point
    values = {
        "range_m": lambda: np.linalg.norm(point, axis=-1),
        "alpha_2": lambda: angles(point - t, t),
        "disparity_deg": lambda: np.degrees(parallax),
        "disparity_px": lambda: (
            projection.focal_px * np.linalg.norm(t) / (point @ projection.axes[2])  # the textbook's law
            if isinstance(projection, Perspective)
            else parallax * max(projection.shape) / (2 * math.pi)
        ),
    }
    return views.answer(**{quantity: values[quantity]()})


def seen_whole(t: tuple) -> dict[str, Views]:
    """Views of which every pixel has an image."""
    made = {}
    for name in KINDS:
        projection = {
            "equirectangular": Equirectangular(90, 180),
            "rows": Rectified(180, 90, t, "rows"),
            "columns": Rectified(90, 180, t, "columns"),
            "perspective": perspective(80, 80, 100.0, None, -40.0, np.array(t)),
            "free": perspective(80, 80, 100.0, 10.0, -40.0, None),
        }[name]
        image, valid = np.zeros(projection.shape, np.float32), np.ones(projection.shape, bool)
        made[name] = Views(projection, (image, image), (valid, valid), np.array(t))
    return made


CASES = [
    *((kind, quantity) for kind in KINDS for quantity in ("range_m", "alpha_2", "disparity_deg")),
    ("rows", "disparity_px"),
    ("columns", "disparity_px"),
    ("perspective", "disparity_px"),
]


@pytest.mark.slow
@pytest.mark.parametrize("t", [T, UP])
@pytest.mark.parametrize(("kind", "quantity"), CASES)
def test_a_plane_answered_in_any_quantity_comes_back(kind: str, quantity: str, t: tuple) -> None:
    """Its inverse range is linear in the direction, so that only the curvature of a pixel's path is left: an eighth of
    the step squared, here 1.5e-4 of the inverse range; half a pixel of shift would be seen."""
    views = seen_whole(t)[kind]
    looking = directions(GRID)
    floor = (np.abs(looking[..., 2]) > 0.12) & (np.sin(angles_to(looking, t)) > 0.3)
    if isinstance(views.projection, Perspective):  # the outermost half pixel has a neighbour on one side only
        row, column = views.projection.pixel_of(looking)
        floor &= (np.abs(row - 39.5) <= 39.5) & (np.abs(column - 39.5) <= 39.5)
    truth = np.arctan2(
        np.linalg.norm(np.cross(floor_range(looking)[..., None] * looking - t, t), axis=-1),
        (floor_range(looking)[..., None] * looking - t) @ np.array(t),
    )

    def error(half_px: float) -> np.ndarray:
        got = converted(answer_by_hand(views, quantity, half_px), GRID).alpha_2
        return (got - truth)[floor & ~np.isnan(got)]

    right, shifted = error(0.0), error(0.5)
    covered = right.size / floor.sum()
    assert covered > 0.999
    disparity = np.abs(truth - angles_to(looking, t))[floor].max()
    assert np.abs(right).max() < 3 * views.projection.step**2 / 8 * disparity + 1e-9
    assert np.median(np.abs(shifted)) > 10 * np.median(np.abs(right))


def angles_to(looking: np.ndarray, t: tuple) -> np.ndarray:
    return np.arctan2(np.linalg.norm(np.cross(looking, t), axis=-1), looking @ np.array(t))


@pytest.mark.parametrize("kind", ["equirectangular", "rows", "columns", "perspective"])
def test_between_pixels_as_a_plain_loop_would(kind: str) -> None:
    """Edges, holes, seams and borders: an independent loop over the panorama's pixels."""
    grid = Grid(width_px=32, height_px=12)
    projection = KINDS[kind](T)
    draws = np.random.default_rng(5)
    range_m = draws.choice([1.5, 1.55, 4.0], size=projection.shape, p=[0.45, 0.5, 0.05])
    range_m[draws.random(projection.shape) < 0.05] = np.nan
    confidence = np.where(np.isnan(range_m), np.nan, draws.random(projection.shape))
    image, seen = np.zeros(projection.shape, np.float32), draws.random(projection.shape) > 0.05
    views = Views(projection, (image, image), (seen, seen), np.array(T))
    got = converted(views.answer(range_m=range_m, confidence=confidence), grid)
    baseline, used = np.linalg.norm(T), []
    for (row, column), a_2 in np.ndenumerate(got.alpha_2):
        looking = directions(grid)[row, column]
        i, j = (float(each) for each in projection.pixel_of(looking))
        (rows, columns), (around_i, around_j) = projection.shape, projection.wraps
        on_it = (around_i or -0.5 <= i <= rows - 0.5) and (around_j or -0.5 <= j <= columns - 0.5)
        if not on_it or math.isnan(i):
            assert math.isnan(a_2)
            continue

        def at(y: int, x: int) -> tuple[int, int]:
            y = y % rows if around_i else min(max(y, 0), rows - 1)  # noqa: B023
            return y, x % columns if around_j else min(max(x, 0), columns - 1)  # noqa: B023

        corners = [at(math.floor(i) + y, math.floor(j) + x) for y in (0, 1) for x in (0, 1)]
        weights = [abs(1 - y - i + math.floor(i)) * abs(1 - x - j + math.floor(j)) for y in (0, 1) for x in (0, 1)]
        nearest = at(math.floor(i + 0.5), math.floor(j + 0.5))
        inverse = [1 / range_m[each] if seen[each] else math.nan for each in corners]
        disparity = [
            angle(range_m[each] * projection.looking(*each), range_m[each] * projection.looking(*each) - T)
            for each in corners
        ]
        if not any(map(math.isnan, inverse)) and max(disparity) - min(disparity) <= projection.step:
            d_1 = 1 / sum(w * each for w, each in zip(weights, inverse, strict=True))
            used.append("linear")
        else:
            d_1 = range_m[nearest] if seen[nearest] else math.nan
            used.append("nearest")
        if math.isnan(d_1):
            assert math.isnan(a_2)
            assert math.isnan(got.confidence[row, column])
        else:
            assert a_2 == pytest.approx(angle(d_1 * looking - T, np.array(T)), abs=1e-7)  # arccos near 0
            assert got.confidence[row, column] == confidence[nearest]
    assert baseline > 0
    assert min(used.count("linear"), used.count("nearest")) > 5


@given(st.floats(0.5, 20), st.floats(0.02, 0.98), st.floats(0.3, 2.8))
def test_standard_deviations_are_turned_into_alpha_2_by_the_slope(d_1: float, around: float, a_1: float) -> None:
    """Against a finite difference of alpha_2 itself, on a pixel of a rectified image."""
    projection = Rectified(90, 45, T, "rows")
    row, column = int(around * 90), int((math.pi - a_1) / projection.step)
    looking, t = projection.looking(row, column), np.array(T)
    image, seen = np.zeros(projection.shape, np.float32), np.ones(projection.shape, bool)
    views = Views(projection, (image, image), (seen, seen), t)

    def alpha_2(range_m: float) -> float:
        return math.atan2(np.linalg.norm(np.cross(range_m * looking - t, t)), (range_m * looking - t) @ t)

    step = 1e-5 * d_1
    slope = abs(alpha_2(d_1 + step) - alpha_2(d_1 - step)) / (2 * step)
    full = np.full(projection.shape, 1.0)
    grid = Grid(width_px=16, height_px=3)
    at_pixel = _nearest_pixel(projection, grid, row, column)
    answers = {
        "range_m": (d_1 * full, 0.02, 0.02 * slope),
        "disparity_deg": (math.degrees(alpha_2(d_1) - angle(looking, t)) * full, 0.3, math.radians(0.3)),
        "disparity_px": ((alpha_2(d_1) - angle(looking, t)) / projection.step * full, 0.3, 0.3 * projection.step),
        "alpha_2": (alpha_2(d_1) * full, 0.01, 0.01),
    }
    for quantity, (values, sigma, expected) in answers.items():
        got = converted(views.answer(**{quantity: values}, sigma=sigma * full), grid)
        if at_pixel is not None:
            assert got.sigma_alpha_2[at_pixel] == pytest.approx(expected, rel=1e-4)


def _nearest_pixel(projection: Projection, grid: Grid, row: int, column: int) -> tuple[int, int] | None:
    """A pixel of the panorama whose nearest pixel of the projection is this one, if there is any."""
    i, j = (np.rint(each).astype(int) for each in projection.pixel_of(directions(grid)))
    found = np.argwhere((i == row) & (j == column))
    return tuple(found[0]) if len(found) else None


def test_answers_on_the_panorama_are_exact(pair: Pair) -> None:
    a_2 = pair.alpha_1 + 0.05 * np.sin(pair.alpha_1)
    d_1 = np.linalg.norm(pair.t_v1) * np.sin(a_2) / np.sin(a_2 - pair.alpha_1)
    for answer in (
        pair.answer(alpha_2=a_2),
        pair.answer(disparity_deg=np.degrees(a_2 - pair.alpha_1)),
        pair.answer(range_m=d_1),
    ):
        # Of an angle of 0.05 a few roundings of numbers near 1 are left, times the range's sensitivity.
        np.testing.assert_allclose(as_matches(answer, pair.grid, "f").alpha_2, a_2, atol=1e-13)
    infinite = as_matches(pair.answer(range_m=np.full(pair.grid.shape, np.inf)), pair.grid, "f")
    np.testing.assert_allclose(infinite.alpha_2, pair.alpha_1, atol=1e-15)
    none = as_matches(pair.answer(disparity_deg=np.full(pair.grid.shape, np.nan)), pair.grid, "f")
    assert (none.reason == Reason.NO_MATCH).all()
    # The ray of a disparity beyond the direction of t meets view 1's nowhere.
    beyond = as_matches(pair.answer(disparity_deg=np.full(pair.grid.shape, 179.0)), pair.grid, "f")
    assert np.isnan(beyond.alpha_2[pair.alpha_1 > 0.1]).all()


@pytest.mark.parametrize(
    ("answer", "rule", "said"),
    [
        (
            {"range_m": np.zeros((24, 48))},
            "angles",
            "range_m must be above zero, or NaN for no match; it is 0 at [0, 0]",
        ),
        ({"range_m": np.ones((48, 24))}, "shape", "range_m must have its views' shape (24, 48); it has (48, 24)"),
        ({"disparity_deg": np.full((24, 48), 200.0)}, "angles", "must lie within 0 .. 180 degrees"),
        ({"alpha_2": np.full((24, 48), 4.0)}, "angles", "alpha_2 must lie within 0 .. pi radians"),
        ({"alpha_2": [1.0]}, "form", "alpha_2 must be a NumPy array; it is list"),
        ({"range_m": np.ones((24, 48)), "sigma": np.zeros((24, 48))}, "angles", "sigma must be above zero"),
        (
            {"range_m": np.ones((24, 48)), "confidence": np.full((24, 48), np.nan)},
            "missing",
            "confidence must be finite where there is a match",
        ),
    ],
)
def test_answers_that_are_refused(answer: dict, rule: str, said: str, pair: Pair) -> None:
    found = list(faults(pair.equirectangular(48).answer(**answer), pair.grid))
    assert found[0].rule == rule
    assert said in found[0].text
    with pytest.raises(InputError, match="mine: "):
        as_matches(pair.equirectangular(48).answer(**answer), pair.grid, "mine")


def test_an_answer_has_exactly_one_quantity(pair: Pair) -> None:
    views = pair.rectified(48)
    ones = np.ones(views.shape)
    with pytest.raises(InputError, match="it has range_m and alpha_2"):
        views.answer(range_m=ones, alpha_2=ones)
    with pytest.raises(InputError, match="it has none of them"):
        pair.answer()
    with pytest.raises(InputError, match="no epipolar curves along its rows or columns"):
        pair.equirectangular(48).answer(disparity_px=np.ones((24, 48)))
    with pytest.raises(InputError, match="no epipolar curves"):
        asked(pair)["free"].answer(disparity_px=np.ones((20, 30)))


def test_what_is_answered_where_there_is_no_image_is_left_out(pair: Pair) -> None:
    views = pair.equirectangular(120)
    got = as_matches(views.answer(range_m=np.full(views.shape, 2.0)), pair.grid, "f")
    i, j = (
        np.rint(each).astype(int) % size
        for each, size in zip(views.projection.pixel_of(pair.directions), views.shape, strict=True)
    )
    assert not views.valid[0].all()
    np.testing.assert_array_equal(~np.isnan(got.alpha_2), views.valid[0][i, j])


def test_disparities_of_a_range(pair: Pair) -> None:
    views = pair.rectified(48)
    row, column = 20, 11
    point = 2.0 * views.projection.looking(row, column)
    expected = math.degrees(angle(point, point - pair.t_v1))
    assert views.disparity_deg(2.0)[row, column] == pytest.approx(expected, abs=1e-6)  # arccos near 0
    # A rounding of angles up to pi, in degrees.
    np.testing.assert_allclose(views.disparity_deg(math.inf), 0, atol=1e-13)


def test_a_motion_of_another_pair_is_not_mixed_up(pair: Pair) -> None:
    """Views are shared by all that they depend on: the baseline turns the rectified image."""
    turned = replace(pair, motion=Motion(pair.motion.R_v2_from_v1, np.array(UP)))
    assert not np.array_equal(turned.rectified(48).images[0], pair.rectified(48).images[0])
