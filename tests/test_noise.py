"""What random draws are named by."""

from harness.camera.intrinsics import Camera, FieldOfView
from harness.camera.lens import Lens
from harness.camera.models import Mirror, Unified
from harness.camera.sensor import Sensor
from harness.simulation.noise import sensor_words


def test_draws_are_named_as_they_were_when_sensors_had_fewer_keys():
    """Figures with noise that were published stay as they are; this text is that of version 0.2.0."""
    assert sensor_words(Sensor()) == (
        '{"mirror":{"a_m":0.0281,"b_m":0.0234},'
        '"camera":{"width_px":640,"height_px":480,"focal_px":614.12,"aspect":1.0,"cx_px":319.5,"cy_px":239.5},'
        '"lens":{"k1":0.0,"k2":0.0,"p1":0.0,"p2":0.0,"k3":0.0},'
        '"field":{"elevation_min_deg":-75.0,"elevation_max_deg":20.0}}'
    )


def test_every_key_that_is_set_names_them():
    field = FieldOfView(elevation_min_deg=0, elevation_max_deg=90)
    sensors = [
        Sensor(),
        Sensor(model=Mirror(a_m=0.03)),
        Sensor(model=Unified(xi=0.5), field=field),
        Sensor(model=Unified(xi=0.6), field=field),
        Sensor(camera=Camera(skew_px=1.0)),
        Sensor(lens=Lens(k1=0.01)),
    ]
    assert len({sensor_words(each) for each in sensors}) == len(sensors)
