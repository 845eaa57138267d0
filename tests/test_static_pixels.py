"""What moves with the camera is found and left out, and nothing else."""

import numpy as np
import pytest
from PIL import Image
from scipy import ndimage

import harness
from harness.api.masks import find_mask
from harness.camera.sensor import Sensor, pixel_directions
from harness.cli import main
from harness.pipeline.static_pixels import static_pixels
from harness.spec import dump_toml

SENSOR = Sensor.model_validate(
    {"camera": {"width_px": 320, "height_px": 240, "focal_px": 307.0, "cx_px": 159.5, "cy_px": 119.5}}
)


def rendered(scene, *poses):
    return [harness.render(scene, sensor=SENSOR, samples=4, **pose) for pose in poses]


@pytest.fixture(scope="module")
def parallel():
    return rendered("box", {"position_m": (0, 0, 1)}, {"position_m": (0.5, 0, 1)})


def body():
    """An arm with a pattern, from the middle to the rim, aside of the way that the camera goes."""
    v, u = np.mgrid[:240, :320]
    arm = (np.abs(u - 159.5 - 0.3 * (v - 119.5)) < 12) & (v > 145) & pixel_directions(SENSOR)[1]
    pattern = ndimage.gaussian_filter(np.random.default_rng(2).uniform(0, 255, (240, 320)), 2) * 4 - 380
    return arm, np.clip(pattern, 0, 255).astype(np.float32)


def with_body(images, noise=4.0):
    arm, pattern = body()
    rng = np.random.default_rng(1)
    return [np.clip(np.where(arm, pattern, each) + noise * rng.normal(size=each.shape), 0, 255) for each in images]


def test_an_arm_is_found_and_nothing_else(parallel):
    motion = harness.relative_motion(*(each.pose for each in parallel))
    used = find_mask(*with_body([each.image for each in parallel]), SENSOR, motion)
    arm, _ = body()
    # Near the image's middle a point of the floor would hardly move: there nothing can be said.
    assert np.mean(~used[ndimage.binary_erosion(arm, iterations=3)]) > 0.7
    around = ndimage.binary_dilation(arm, iterations=16)
    assert used[~around].all()


@pytest.mark.slow
@pytest.mark.parametrize("scene", ["box", "corridor", "room"])
@pytest.mark.parametrize(
    "second",
    [
        {"position_m": (0.5, 0, 1)},
        {"position_m": (0.1, 0, 1)},
        {"position_m": (0.0, 0.3, 1.2), "yaw_deg": 30.0},
        {"position_m": (0.3, 0.3, 1), "yaw_deg": 180.0},
    ],
)
def test_a_scene_alone_costs_no_pixel(scene, second):
    views = rendered(scene, {"position_m": (0, 0, 1)}, second)
    motion = harness.relative_motion(*(each.pose for each in views))
    images = tuple(each.image for each in views)
    assert not static_pixels(images, (SENSOR, SENSOR), motion, 1.0, 10.0).any()


def test_a_view_that_hardly_moved_is_not_judged(parallel):
    image = parallel[0].image
    motion = harness.Motion(np.eye(3), np.array([1e-3, 0, 0]))
    assert not static_pixels((image, image), (SENSOR, SENSOR), motion, 1.0, 10.0).any()


def test_images_of_two_sizes_are_refused(parallel):
    with pytest.raises(ValueError, match="the same size"):
        static_pixels((parallel[0].image, np.zeros((10, 10), np.float32)), (SENSOR, SENSOR), None, 1.0, 10.0)


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_the_command_writes_the_mask_and_uses_it(parallel, tmp_path, capsys):
    (tmp_path / "sensor.toml").write_text(dump_toml(SENSOR))
    for name, image in zip(("left", "right"), with_body([each.image for each in parallel]), strict=True):
        Image.fromarray(np.rint(image).astype(np.uint8)).save(tmp_path / f"{name}.png")
    arguments = [tmp_path / "left.png", tmp_path / "right.png", "--sensor", tmp_path / "sensor.toml"]
    arguments += ["--baseline", 0.5, 0, 0, "--mask", "auto", "--matcher", "sgm", "--out", tmp_path / "out"]
    assert main(["range", *map(str, arguments)]) == 0
    told = capsys.readouterr().out
    assert "% of the image is masked" in told
    mask = np.asarray(Image.open(tmp_path / "out" / "mask.png"))
    assert set(np.unique(mask)) == {0, 255}
    assert "is masked (dimmed and outlined)" in (tmp_path / "out" / "range.html").read_text()
    arguments += ["--sensor-2", tmp_path / "sensor.toml", "--set", "d_min_m=0.9"]
    assert main(["range", *map(str, arguments)]) == 0
