"""What the options of the mount say of two sensors: of calibrations alone, which do not say it themselves."""

import calibration_files as files
import pytest

import harness
from harness import Sensor
from harness.cli.parser import _parser
from harness.cli.sensor_options import first_sensor, second_sensor
from harness.errors import InputError
from harness.spec import dump_toml

BELOW_A_MIRROR = ["--looks", "down", "--mirrored", "--elevation", "-75", "20"]


@pytest.fixture
def mirror(tmp_path):
    """The default mirror as OpenCV would have calibrated it: without its mount and field."""
    return files.write(tmp_path, harness.convert_sensor(Sensor(), "opencv").text, "mirror.yaml")


@pytest.fixture
def fisheye(tmp_path):
    return files.write(tmp_path, dump_toml(harness.load_sensor("fisheye")), "fisheye.toml")


def sensors(*options: object) -> tuple[Sensor | None, Sensor | None]:
    words = _parser().parse_args(["motion", "a.png", "b.png", *map(str, options)])
    return first_sensor(words), second_sensor(words)


def test_a_sensor_file_keeps_its_own_mount(mirror, fisheye):
    own = harness.load_sensor(fisheye)
    for first, second in ((mirror, fisheye), (fisheye, mirror)):
        result = sensors("--sensor", first, "--sensor-2", second, *BELOW_A_MIRROR)
        calibrated, ours = result if first == mirror else result[::-1]
        assert ours == own
        assert (calibrated.looks, calibrated.mirrored, calibrated.field.elevation_max_deg) == ("down", True, 20.0)


def test_two_calibrations_are_mounted_alike(mirror):
    first, second = sensors("--sensor", mirror, "--sensor-2", mirror, *BELOW_A_MIRROR)
    assert first == second
    assert (first.looks, first.mirrored) == ("down", True)


def test_one_sensor_file_may_be_told_otherwise(fisheye):
    assert sensors("--sensor", fisheye, "--no-mirrored", "--looks", "up", "--elevation", "0", "90")[0].looks == "up"


def test_two_sensor_files_are_not(fisheye):
    with pytest.raises(InputError, match="both are sensor files, which say their mount, field and size"):
        sensors("--sensor", fisheye, "--sensor-2", fisheye, "--mirrored")


def test_the_option_of_the_second_camera_is_named(mirror, fisheye):
    with pytest.raises(InputError, match="--camera-2: has one camera, number 0"):
        sensors("--sensor", mirror, "--sensor-2", fisheye, "--camera-2", 1)
