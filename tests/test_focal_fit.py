"""Values of a sensor that are given in words: a focal length that fits the field, a principal point in the middle."""

import math
import tomllib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from harness.camera.intrinsics import Camera, FieldOfView
from harness.camera.models import DoubleSphere, Equirectangular, KannalaBrandt, Mirror, Unified
from harness.camera.models.hyperboloid import rim_radius
from harness.camera.mount import Mount
from harness.camera.sensor import Sensor, in_field, on_image, project
from harness.errors import InputError
from harness.runs.load import load_experiment
from harness.spec import LEFT_OUT, as_given, as_table, dump_toml, given_of, parse

EQUIDISTANT = KannalaBrandt(k1=0, k2=0, k3=0, k4=0)


def fitted(**keys: object) -> Sensor:
    keys["camera"] = {"focal_px": "fit", "cx_px": "centre", "cy_px": "centre", **keys.get("camera", {})}
    return Sensor(**keys)


# --- Against closed forms -----------------------------------------------------------------------------------------


def test_of_a_mirror() -> None:
    """The rim's radius is f r/(z + 2e): half of 480 rows, from border to border."""
    sensor = fitted()
    assert sensor.camera.focal_px == pytest.approx(240 / rim_radius(Mirror(), 20), rel=1e-12)


@pytest.mark.parametrize("angle_deg", [40, 90, 105])
def test_of_lenses(angle_deg: float) -> None:
    """Their radius at an angle by hand; the nearest border is the one below, 180 pixels from the principal point."""
    field, camera = FieldOfView(angle_max_deg=angle_deg), {"cy_px": 299.5}
    theta = math.radians(angle_deg)
    for model, radius in (
        (EQUIDISTANT, theta),
        (Unified(xi=1), math.sin(theta) / (1 + math.cos(theta))),  # stereographic: tan(theta/2)
        (DoubleSphere(xi=0, alpha=0.5), 2 * math.tan(theta / 2)),  # the same at half the scale
    ):
        sensor = fitted(model=model, field=field, camera=camera)
        assert sensor.camera.focal_px == pytest.approx(180 / radius, rel=1e-12)


def test_of_stretched_pixels() -> None:
    """With rows twice as dense, the circle's height decides: 120 pixels of focal length; with columns, its width."""
    for aspect, expected in ((2.0, 120.0), (0.5, 320.0)):
        sensor = fitted(model=EQUIDISTANT, field=FieldOfView(angle_max_deg=math.degrees(1)), camera={"aspect": aspect})
        assert sensor.camera.focal_px == pytest.approx(expected, rel=1e-12)


def test_of_a_whole_panorama() -> None:
    size = {"width_px": 720, "height_px": 360}
    sensor = fitted(model=Equirectangular(), camera=size)
    assert sensor.camera.focal_px == pytest.approx(360 / math.pi, rel=1e-12)
    assert sensor.model.goes_round(sensor.camera)


def test_what_is_limited_by_elevations() -> None:
    """A lens that looks ahead, of which 30° up and 20° down are used: the nearest of both borders and of the angle."""
    field = FieldOfView(elevation_min_deg=-20, elevation_max_deg=30, angle_max_deg=60)
    sensor = fitted(model=Unified(xi=0), mount=Mount(looks="forward"), field=field)
    # 30° up at the azimuth where the angle is 60°: a pinhole's image of it is a hyperbola, highest at its ends.
    azimuth = math.acos(math.cos(math.radians(60)) / math.cos(math.radians(30)))
    across = math.tan(azimuth)
    up = math.tan(math.radians(30)) / math.cos(azimuth)
    sides = (320 / math.tan(math.radians(60)), 240 / up)  # straight to the side, and up at the corner
    assert across < math.tan(math.radians(60))
    assert sensor.camera.focal_px == pytest.approx(min(sides), rel=1e-4)  # the corner lies between two directions


# --- Properties ---------------------------------------------------------------------------------------------------

models = st.sampled_from([Mirror(), EQUIDISTANT, Unified(xi=0.8), Unified(xi=1.5), DoubleSphere(xi=-0.2, alpha=0.55)])


@pytest.mark.slow
@settings(deadline=None)  # the first call loads the compiled loops
@given(
    model=models,
    angle=st.floats(20, 100),
    camera=st.fixed_dictionaries(
        {"cx_px": st.floats(100, 500), "cy_px": st.floats(100, 400), "aspect": st.floats(0.7, 1.4)},
        optional={"skew_px": st.floats(-30, 30)},
    ),
    mount=st.builds(Mount, looks=st.sampled_from(["up", "down", "forward"]), roll_deg=st.floats(-90, 90)),
)
def test_the_whole_field_is_on_the_image_and_none_larger(model, angle, camera, mount) -> None:
    """Random directions of the field, and its rim at every hundredth of a degree: all on the image, to 1e-5 of the
    radius; and some of them no farther from its border."""
    field = FieldOfView(elevation_min_deg=-90, elevation_max_deg=90, angle_max_deg=angle)
    sensor = Sensor(model=model, field=field, mount=mount, camera={"focal_px": "fit", **camera})
    turn = np.radians(np.arange(0, 360, 0.01))
    rim = math.sin(math.radians(angle)) * np.stack([np.cos(turn), np.sin(turn), np.zeros(turn.size)], axis=-1)
    rim[:, 2] = math.cos(math.radians(angle))
    axis = {"up": (0, 1, 2), "forward": (2, 0, 1)}.get(mount.looks, (0, 1, 2))
    rim = rim[:, axis] * ([1, 1, -1] if mount.looks == "down" else [1, 1, 1])
    pixels, _ = project(sensor, rim @ mount.R_sensor_from_untilted.T)
    last = np.array([639.5, 479.5])
    room = np.minimum(pixels + 0.5, last - pixels).min()
    assert abs(room) < 1e-5 * 400
    some = np.random.default_rng(0).normal(size=(2000, 3))
    some = some[in_field(sensor, some)]
    pixels, _ = project(sensor, some)
    assert np.minimum(pixels + 0.5, last - pixels).min() > -0.01
    assert on_image(sensor, pixels).mean() > 0.999


@pytest.mark.parametrize("model", [Mirror(), EQUIDISTANT, Equirectangular()])
def test_what_is_written_has_numbers(model) -> None:
    """The table reads back to the same sensor; what was given is not part of it, and is there to be read again."""
    sensor = fitted(model=model, field={"angle_max_deg": 100}, camera={"width_px": 800, "height_px": 400})
    assert type(sensor.camera.focal_px) is type(sensor.camera.cx_px) is float
    assert sensor.camera.cx_px == 399.5
    for text in (dump_toml(sensor), dump_toml(sensor, given=True)):
        again = parse(Sensor, tomllib.loads(text))
        assert again == sensor
        assert hash(again) == hash(sensor)
    assert tomllib.loads(dump_toml(sensor))["camera"] == as_table(sensor)["camera"]
    assert '"' not in dump_toml(sensor.camera)
    wider = as_given(sensor)
    wider["camera"] |= {"width_px": 1600, "height_px": 800}
    assert parse(Sensor, wider).camera.cx_px == 799.5
    assert parse(Sensor, wider).camera.focal_px > 1.5 * sensor.camera.focal_px


def test_copies_have_the_numbers_alone() -> None:
    camera = fitted().camera
    assert given_of(camera) == {"focal_px": "fit", "cx_px": "centre", "cy_px": "centre"}
    assert given_of(camera.model_copy()) == {}
    assert camera.model_copy() == camera


# --- The field of view of models ----------------------------------------------------------------------------------


def test_a_field_that_is_not_given_is_the_models() -> None:
    assert Sensor().field == FieldOfView()
    lens = Sensor(model=Unified(xi=2.0))
    assert (lens.field.elevation_min_deg, lens.field.elevation_max_deg) == (-90, 90)
    ends_at_deg = math.degrees(lens.model.largest_angle_rad(lens.camera, lens.lens))
    assert ends_at_deg - 0.01 <= lens.field.angle_max_deg <= ends_at_deg
    high = Sensor(model=EQUIDISTANT, field=FieldOfView(elevation_min_deg=30))
    assert high.field == FieldOfView(elevation_min_deg=30, elevation_max_deg=90, angle_max_deg=180)
    assert given_of(high.field) == {"elevation_max_deg": LEFT_OUT, "angle_max_deg": LEFT_OUT}
    # What is given is not cut off in silence.
    with pytest.raises(ValueError, match=r"field\.elevation_min_deg = -60 is 150 deg off the optical axis"):
        Sensor(model=Unified(xi=2.0), field=FieldOfView(elevation_min_deg=-60))


# --- Experiments --------------------------------------------------------------------------------------------------

TABLE = {
    "name": "x",
    "trial": {"scene": "box", "sensor": {"camera": {"focal_px": "fit", "cx_px": "centre", "cy_px": "centre"}}},
}


def test_axes_fit_anew() -> None:
    experiment = load_experiment(TABLE, axes={"sensor.camera.height_px": [480, 960], "sensor.camera.width_px": [960]})
    first, second = (each.trial.sensor.camera for each in experiment.planned)
    assert second.focal_px == pytest.approx(2 * first.focal_px)
    assert second.cy_px == 479.5
    again = parse(type(experiment), tomllib.loads(dump_toml(experiment, given=True)))
    assert [each.key for each in again.planned] == [each.key for each in experiment.planned]
    set_to = load_experiment(TABLE, sets=["sensor.camera.width_px=300", "noise.sigma_grey=1"]).trial.sensor
    assert set_to.camera.focal_px == pytest.approx(150 / 240 * first.focal_px)


def test_coordinates_are_numbers() -> None:
    plain = {"name": "x", "trial": {"scene": "box"}}
    planned = load_experiment(plain, axes={"sensor.camera.focal_px": [500.0, "fit"]}).planned
    assert [each.coordinates["sensor.camera.focal_px"] for each in planned] == [500.0, fitted().camera.focal_px]


def test_another_kind_of_camera_has_its_own_field() -> None:
    axes = {"sensor.model": [{"kind": "hyperboloid"}, {"kind": "unified", "xi": 0.9}]}
    first, second = load_experiment({"name": "x", "trial": {"scene": "box"}}, axes=axes).planned
    assert first.trial.sensor == Sensor()
    assert second.trial.sensor.field == Sensor(model=Unified(xi=0.9)).field


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"camera": {"focal_px": "fill"}}, "camera.focal_px: must be a number or 'fit'; found 'fill'"),
        ({"camera": {"cx_px": "center"}}, "camera.cx_px: must be a number or 'centre'; found 'center'"),
        ({"camera": {"focal_px": "600"}}, "camera.focal_px: must be a number; found '600'"),
        (
            {"model": {"kind": "ocam", "coefficients": [-200, 0, 1e-3]}, "camera": {"focal_px": "fit"}},
            'camera.focal_px = "fit" has no meaning for the OCamCalib camera; leave it out',
        ),
        (
            {"model": {"kind": "unified", "xi": 1.5}, "camera": {"focal_px": "fit"}},
            'camera.focal_px = "fit" fits the field of view: give field.angle_max_deg',
        ),
        (
            {"model": {"kind": "unified", "xi": 0}, "camera": {"focal_px": "fit"}, "field": {"angle_max_deg": 95}},
            'camera.focal_px = "fit": the camera has no image of part of the field; use a smaller field',
        ),
        (
            {"field": {"elevation_min_deg": 30}},
            "field: elevation_min_deg must be below elevation_max_deg; found 30 and 20",
        ),
    ],
)  # fmt: skip
def test_mistakes(table: dict, message: str) -> None:
    with pytest.raises(InputError) as caught:
        parse(Sensor, table)
    assert str(caught.value) == message


def test_a_camera_alone() -> None:
    assert Camera(cx_px="centre", width_px=101).cx_px == 50
