"""The rows of a panorama that sensors see: z_min and z_max given as "auto"."""

import math
import tomllib

import numpy as np
import pytest

import harness
from harness.camera.intrinsics import Camera, FieldOfView
from harness.camera.models import KannalaBrandt
from harness.camera.mount import Mount
from harness.camera.sensor import Sensor
from harness.camera.unwrap import unwrap
from harness.camera.visible_rows import is_open, with_rows
from harness.errors import InputError
from harness.geometry.panorama import Grid
from harness.geometry.pose import Pose
from harness.pipeline.specification import Trial
from harness.runs.load import load_experiment
from harness.simulation.scene import load_scene
from harness.spec import dump_toml, parse

AUTO = Grid(z_min="auto", z_max="auto")
SMALL = Camera(width_px=160, height_px=120, focal_px=153.53, cx_px=79.5, cy_px=59.5)
MIRROR = Sensor(camera=SMALL)
AHEAD, WIDE = (
    Sensor(
        model=KannalaBrandt(k1=0, k2=0, k3=0, k4=0),
        camera={"width_px": 160, "height_px": 120, "focal_px": "fit", "cx_px": "centre", "cy_px": "centre"},
        field=FieldOfView(angle_max_deg=angle_deg),
        mount=Mount(looks="forward"),
    )
    for angle_deg in (60, 110)
)
PIXEL_DEG = 3.0
"""More than what two pixels of these images span anywhere: the cubic interpolation takes those within two."""


def elevations(grid: Grid) -> tuple[float, float]:
    return math.degrees(math.atan(grid.z_min)), math.degrees(math.atan(grid.z_max))


def test_all_around() -> None:
    """A mirror's field, -75 to 20 degrees, less what the interpolation takes at its edges."""
    low, high = elevations(with_rows(AUTO, (MIRROR,)))
    assert -75 < low < -75 + 2 * PIXEL_DEG  # the blind disc is 6 pixels wide
    assert 20 - PIXEL_DEG < high < 20


def test_a_lens_that_looks_ahead() -> None:
    """A cone of 60° spans 60° of azimuth to either side at the horizon, arccos(cos 60°/cos e) at an elevation e. Half
    of its solid angle is where it spans less than 57.2°: four fifths of that, 45.8°, it spans up to 44.2°."""
    low, high = elevations(with_rows(AUTO, (AHEAD,)))
    # Cubic taps are up to 2.8 pixels of 1° away, which leaves a cone of 57°; an azimuth more or less moves the limit by
    # 1.6°, as the azimuths are 3° apart, half of it to either side, and the elevation changes 1.06 times as fast.
    lowest, highest = (_four_fifths_of_the_median(cone) for cone in (57, 60))
    assert highest == pytest.approx(44.2, abs=0.05)
    assert lowest - 1.6 < high < highest + 1.6
    assert low == pytest.approx(-high, abs=0.2)


def _four_fifths_of_the_median(cone_deg: float) -> float:
    """The elevation, degrees, up to which a cone about the horizon spans four fifths of its median azimuth."""
    elevation = np.radians(np.linspace(0, cone_deg, 100_001)[:-1])
    half = np.arccos(np.cos(np.radians(cone_deg)) / np.cos(elevation))  # falls from the horizon on
    within = np.cumsum(half * np.cos(elevation))
    median = half[np.searchsorted(within, within[-1] / 2)]
    return math.degrees(math.acos(math.cos(math.radians(cone_deg)) / math.cos(0.8 * median)))


def test_straight_up_there_are_no_rows() -> None:
    lens = Sensor(model=AHEAD.model, camera=AHEAD.camera, field=FieldOfView(angle_max_deg=60))
    low, high = elevations(with_rows(AUTO, (lens,)))
    assert high == pytest.approx(75, abs=1e-9)
    assert 30 < low < 30 + PIXEL_DEG


def test_what_both_see() -> None:
    narrow = Sensor(camera=SMALL, field=FieldOfView(elevation_min_deg=-40, elevation_max_deg=30))
    both = elevations(with_rows(AUTO, (MIRROR, narrow), np.eye(3)))
    first, second = (elevations(with_rows(AUTO, (each,))) for each in (MIRROR, narrow))
    assert both == (second[0], first[1])
    # A second view that is tilted sees less at one azimuth and more at the other: 4/5 of them see 0.8 of the tilt less.
    tilted = elevations(with_rows(AUTO, (MIRROR, MIRROR), Pose(pitch_deg=10).R_world_from_view.T))
    assert first[1] - 10 < tilted[1] < first[1] - 5
    same = elevations(with_rows(AUTO, (MIRROR, MIRROR), Pose(yaw_deg=50).R_world_from_view.T))
    assert same == pytest.approx(first, abs=1)  # the blind disc is a few pixels wide, and they are square


def test_cameras_that_look_to_different_sides() -> None:
    """Two lenses of 220° at right angles see 130° of the horizon both, and all around only beyond 70° of elevation:
    where the rows that are seen best were counted, nothing else was left."""
    low, high = elevations(with_rows(AUTO, (WIDE, WIDE), Pose(yaw_deg=90).R_world_from_view.T))
    assert (low, high) == (pytest.approx(-75, abs=1e-9), pytest.approx(75, abs=1e-9))


def test_the_rows_are_seen() -> None:
    image = np.full((120, 160), 128, dtype=np.float32)
    for sensor, share in ((MIRROR, 0.99), (AHEAD, 0.29)):  # 105 of 360 degrees
        grid = with_rows(AUTO, (sensor,))
        visible = unwrap(image, sensor, grid, interpolation="cubic").valid.mean(axis=1)
        assert visible.min() > 0.7 * visible.max()  # 0.8, counted at other azimuths around a blind disc of 12 pixels
        assert visible.mean() > share


def test_one_of_them_alone() -> None:
    grid = with_rows(Grid(z_max="auto", z_min=-0.5), (MIRROR,))
    assert grid.z_min == -0.5
    assert grid.z_max == with_rows(AUTO, (MIRROR,)).z_max
    assert with_rows(Grid(), (MIRROR,)) == Grid()
    assert is_open(AUTO)
    assert is_open(grid)  # for another sensor it is another
    assert not is_open(Grid())


# --- Trials and experiments ---------------------------------------------------------------------------------------

TABLE = {"scene": "box", "sensor": {"camera": SMALL.model_dump()}, "panorama": {"z_min": "auto", "z_max": "auto"}}


def test_a_trial_has_numbers() -> None:
    scene = load_scene("box")
    trial = parse(Trial, TABLE | {"scene": scene.model_dump()})
    assert trial.panorama == with_rows(AUTO, (MIRROR,))
    z = {"z_min": trial.panorama.z_min, "z_max": trial.panorama.z_max}
    assert trial.key == parse(Trial, TABLE | {"scene": scene.model_dump(), "panorama": z}).key
    assert parse(Trial, tomllib.loads(dump_toml(trial))) == trial


def test_an_axis_works_them_out_anew() -> None:
    table = {"name": "x", "trial": TABLE}
    experiment = load_experiment(
        table, axes={"sensor.field.elevation_max_deg": [10.0, 20.0], "view_2.pitch_deg": [0, 8]}
    )
    tops = [elevations(each.trial.panorama)[1] for each in experiment.planned]
    assert tops[0] < 10 < tops[2] < 20
    assert tops[1] < tops[0]
    assert tops[3] < tops[2]
    again = parse(type(experiment), tomllib.loads(dump_toml(experiment, given=True)))
    assert [each.key for each in again.planned] == [each.key for each in experiment.planned]
    varied = load_experiment({"name": "x", "trial": TABLE}, axes={"panorama.z_max": ["auto", 0.1]}).planned
    assert [each.coordinates["panorama.z_max"] for each in varied] == [varied[0].trial.panorama.z_max, 0.1]


@pytest.mark.parametrize(
    ("panorama", "message"),
    [
        ({"z_max": "automatic"}, "panorama.z_max: must be a number or 'auto'; found 'automatic'"),
        ({"z_max": "auto", "z_min": 3}, "z_min must be below z_max"),
    ],
)
def test_mistakes(panorama: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        parse(Trial, TABLE | {"scene": load_scene("box").model_dump(), "panorama": panorama})


def test_nothing_that_both_see() -> None:
    field = {"elevation_min_deg": -90, "elevation_max_deg": -80}
    table = TABLE | {"scene": load_scene("box").model_dump(), "sensor": {"field": field}}
    with pytest.raises(InputError, match=r"panorama: .auto.: no direction within 75 deg of the horizon is seen"):
        parse(Trial, table)


def test_from_python() -> None:
    view = harness.render("box", sensor=MIRROR, samples=1, grid=Grid(height_px=40, z_min="auto", z_max="auto"))
    assert view.grid.z_max == with_rows(AUTO, (MIRROR,)).z_max
    assert np.isfinite(view.panorama).mean() > 0.98
    estimate = harness.estimate_range(
        view.image, view.image, MIRROR, (0.5, 0, 0), "column", grid=Grid(height_px=40, z_max="auto")
    )
    assert estimate.pair.grid.z_max == view.grid.z_max
