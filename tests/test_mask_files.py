"""A mask in files: relative to whoever names it, written out and read again, for other programs and photographs."""

import re

import numpy as np
import pytest
from PIL import Image
from sweeps import write_small

import harness
from harness.camera.mask import used_pixels
from harness.camera.sensor import project, used
from harness.cli import main
from harness.errors import InputError
from harness.geometry.panorama import Grid, directions
from harness.io.calibrations.sensors import load_sensor
from harness.matching.program import Program, write_input
from harness.runs.load import load_experiment
from harness.runs.recorded import record, recorded
from harness.runs.store import Store
from harness.spec import dump_toml, parse
from harness.testing.pairs import SENSOR, fresh, scenery

SHAPE = (120, 160)
ARM = np.s_[70:105, 60:75]


def write_mask(path, hidden=ARM, shape=SHAPE):
    levels = np.full(shape, 255, np.uint8)
    levels[hidden] = 0
    path.parent.mkdir(exist_ok=True)
    Image.fromarray(levels).save(path)
    return path


@pytest.fixture
def small(tmp_path):
    return write_small(tmp_path / "small.toml")


def expected(hidden=ARM):
    pixels = np.ones(SHAPE, bool)
    pixels[hidden] = False
    return pixels


def with_mask(small, line):
    """The experiment with a line in the sensor's table."""
    text = small.read_text(encoding="utf-8")
    small.write_text(text.replace("[trial.sensor.camera]", f"[trial.sensor]\n{line}\n\n[trial.sensor.camera]"))
    return small


def test_a_mask_is_relative_to_the_file_that_names_it(tmp_path, small, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_mask(tmp_path / "here" / "arm.png")
    bare = dump_toml(load_experiment(small).trial.sensor)
    (tmp_path / "here" / "sensor.toml").write_text(f'mask = "arm.png"\n{bare}', encoding="utf-8")
    (tmp_path / "here" / "table.toml").write_text(f'mask = {{ file = "arm.png" }}\n{bare}', encoding="utf-8")
    for name in ("sensor.toml", "table.toml"):
        assert np.array_equal(used(load_sensor(tmp_path / "here" / name)), expected())
    by_file = load_experiment(small, ["sensor=here/sensor.toml"]).trial.sensor
    by_key = load_experiment(small, ["sensor.mask=here/arm.png"]).trial.sensor
    by_axis = load_experiment(small, axes={"sensor.mask": ["here/arm.png"]}).planned[0].trial.sensor
    by_table = load_experiment(small, axes={"sensor": [{"mask": "here/arm.png", "camera": by_key.camera}]}).planned
    inline = load_experiment(with_mask(small, 'mask = "here/arm.png"')).trial.sensor
    for sensor in (by_file, by_key, by_axis, by_table[0].trial.sensor, inline):
        assert np.array_equal(used(sensor), expected())
        assert sensor.mask.file == str(tmp_path / "here" / "arm.png")
        assert sensor == by_file


def test_the_second_view_has_a_mask_alone(small, tmp_path):
    write_mask(tmp_path / "arm.png")
    trial = load_experiment(small, [f"sensor_2.mask={tmp_path / 'arm.png'}"]).trial
    assert trial.sensor.mask is None
    assert trial.sensors[1].camera == trial.sensor.camera
    assert np.array_equal(used(trial.sensors[1]), expected())


def test_masks_are_an_axis(small, tmp_path):
    masks = [str(write_mask(tmp_path / f"{i}.png", np.s_[:i])) for i in (10, 20)]
    planned = load_experiment(small, axes={"sensor.mask": masks}).planned
    assert [used(each.trial.sensor).sum() // SHAPE[1] for each in planned] == [110, 100]
    write_mask(tmp_path / "20.png", np.s_[:10])
    with pytest.raises(InputError, match="two trials are the same"):
        load_experiment(small, axes={"sensor.mask": masks})


def test_what_is_written_reads_back_and_needs_no_file_until_it_is_used(small, tmp_path):
    write_mask(tmp_path / "arm.png")
    experiment = load_experiment(with_mask(small, 'mask = "arm.png"'))
    written = tmp_path / "elsewhere" / "experiment.toml"
    written.parent.mkdir()
    written.write_text(dump_toml(experiment), encoding="utf-8")
    again = load_experiment(written)
    assert again.trial == experiment.trial
    assert [each.key for each in again.planned] == [each.key for each in experiment.planned]
    with Store() as store:
        record(experiment, store)
        (tmp_path / "arm.png").unlink()
        stored = recorded(store, tmp_path / "run.sqlite")  # as for somebody else's run
    assert stored.planned[0].trial == experiment.trial
    assert stored.planned[0].key == experiment.planned[0].key
    used_pixels.cache_clear()
    with pytest.raises(InputError, match=r"experiment\.toml: trial\.sensor\.mask: '.*arm\.png': no such file"):
        load_experiment(written)
    write_mask(tmp_path / "arm.png", np.s_[:7])
    with pytest.raises(InputError, match=r"'.*arm\.png': has changed since the sensor was read"):
        load_experiment(written)


@pytest.mark.parametrize(
    ("sets", "said"),
    [
        (["sensor.mask=absent.png"], r"--set: sensor\.mask: '.*absent\.png': no such file"),
        (
            ["sensor.mask=other.png"],
            r"--set: sensor\.mask: '.*other\.png': the image is 80x60 pixels, the masked sensor 160x120",
        ),
        (
            ["sensor.mask.file=other.png"],
            r"--set: sensor\.mask\.file: '.*other\.png': the image is 80x60 pixels, the masked sensor 160x120",
        ),
        (["sensor_2.mask=other.png"], r"--set: sensor_2\.mask: '.*other\.png': the image is 80x60 pixels"),
    ],
)
def test_a_mistake_is_said_in_a_line_with_its_key(small, tmp_path, monkeypatch, sets, said):
    monkeypatch.chdir(tmp_path)
    write_mask(tmp_path / "other.png", shape=(60, 80))
    with pytest.raises(InputError, match=said):
        load_experiment(small, sets)


def test_a_sweep_over_masks_of_wrong_sizes_names_the_axis(small, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_mask(tmp_path / "arm.png")
    with pytest.raises(InputError, match=r"axes\.sensor\.camera\.width_px|sensor\.mask"):
        load_experiment(small, ["sensor.mask=arm.png"], {"sensor.camera.width_px": [160, 162]})


@pytest.mark.slow
def test_a_folder_for_other_programs_holds_the_mask(tmp_path):
    mask = write_mask(tmp_path / "arm.png", np.s_[96:130, 70:92], (160, 160))
    sensor = SENSOR.with_mask(mask)
    view = harness.render("box", sensor=sensor, samples=1, grid=Grid(width_px=90, height_px=25))
    view.write(tmp_path / "view")
    assert np.array_equal(used(load_sensor(tmp_path / "view" / "sensor.toml")), used(sensor))
    assert "mask.png" in (tmp_path / "view" / "README.txt").read_text(encoding="utf-8")
    pair = scenery().pair
    one, two = pair.images
    masked = type(pair)((one, two), (SENSOR, sensor), pair.motion, pair.grid)
    program = parse(Program, {"command": ["true", "{input}", "{output}"]})
    (tmp_path / "input").mkdir()
    write_input(fresh(masked), program, tmp_path / "input")
    assert not (tmp_path / "input" / "view_1" / "mask.png").exists()
    assert load_sensor(tmp_path / "input" / "view_1" / "sensor.toml") == SENSOR
    read = load_sensor(tmp_path / "input" / "view_2" / "sensor.toml")
    assert np.array_equal(used(read), used(sensor))
    assert read.model_copy(update={"mask": None}) == SENSOR


# --- Photographs --------------------------------------------------------------------------------------------------

GRID = Grid(width_px=180, height_px=50)
SIZES = ["--set", "panorama.width_px=180", "--set", "panorama.height_px=50", "--matcher", "sgm"]


@pytest.fixture(scope="module")
def photographs(tmp_path_factory):
    """Two views of the box by one camera, an arm before both, in grey that is like the walls; and masks of it."""
    folder = tmp_path_factory.mktemp("photographs")
    for name, x_m in (("left", 0.0), ("right", 0.5)):
        view = harness.render("box", position_m=(x_m, 0, 1), samples=4, sensor=SENSOR, grid=GRID)
        view.write(folder / name)
        grey = np.clip(np.rint(view.image), 0, 255).astype(np.uint8)
        grey[96:130, 70:92] = np.random.default_rng(0).integers(60, 200, (34, 22))
        Image.fromarray(grey).save(folder / f"{name}.png")
        np.save(folder / f"{name}.npy", view.panorama_range_m)
    write_mask(folder / "arm.png", np.s_[96:130, 70:92], (160, 160))
    write_mask(folder / "arm_2.png", np.s_[90:136, 66:96], (160, 160))
    return folder


def ranged(folder, out, *more):
    given = ["--sensor", folder / "left" / "sensor.toml", "--baseline", 0.5, 0, 0, *SIZES, "--out", folder / out]
    return main([str(each) for each in ("range", folder / "left.png", folder / "right.png", *given, *more)])


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_masked_photographs(photographs, capsys):
    folder = photographs
    assert ranged(folder, "plain") == 0
    assert ranged(folder, "masked", "--mask", folder / "arm.png") == 0
    assert ranged(folder, "two", "--mask", folder / "arm.png", "--mask-2", folder / "arm_2.png") == 0
    plain, masked, two = (np.load(folder / name / "range.npy") for name in ("plain", "masked", "two"))
    sensor = load_sensor(folder / "left" / "sensor.toml").with_mask(folder / "arm.png")
    truth = np.load(folder / "left.npy")
    x = directions(GRID)
    arm = project(SENSOR, x)[1] & ~project(sensor, x)[1]
    assert arm.sum() > 150
    # The arm looks the same in both views, at infinity for all that the matcher knows; nearly all of that is dropped.
    assert np.isfinite(plain[arm]).mean() < 0.1
    assert np.mean(np.abs(plain - truth)[arm] < 0.2) < 0.1
    assert np.isnan(masked[arm]).all()
    assert np.isnan(two[arm]).all()
    beyond = ~arm & np.isfinite(masked)
    assert beyond.mean() > 0.7
    assert np.median(np.abs(masked - truth)[beyond]) < 0.08  # a tenth of a column of 2 degrees is 6 cm at 3 m
    assert np.isfinite(two).sum() < np.isfinite(masked).sum()
    page = (folder / "masked" / "range.html").read_text(encoding="utf-8")
    assert "each with" not in page
    assert re.search(r"In each view, \d\.\d % of what the camera sees is masked \(dimmed and outlined\)\.", page)
    page = (folder / "two" / "range.html").read_text(encoding="utf-8")
    assert "160 × 160 pixels, each with a mask of its own" in page
    assert re.search(r"In view 1, \d\.\d % of .* In view 2, \d\.\d % of what the camera sees is masked", page)
    capsys.readouterr()
    write_mask(folder / "black.png", np.s_[:, :], (160, 160))
    assert ranged(folder, "black", "--mask", folder / "black.png") == 2
    assert "sensor.mask hides it all: pixels in use must be white in it" in capsys.readouterr().err
    pictures = [str(folder / f"{name}.png") for name in ("left", "right")]
    black = ["--sensor", str(folder / "left" / "sensor.toml"), "--mask", str(folder / "black.png")]
    assert main(["range", *pictures, *black, "--baseline", "1", "0", "0", "--out", str(folder / "black")]) == 2
    assert "sensor.mask hides it all" in capsys.readouterr().err  # where the panorama would follow from the sensor
    assert ranged(folder, "none", "--mask", folder / "absent.png") == 2
    assert f"--mask: '{folder / 'absent.png'}': no such file" in capsys.readouterr().err


@pytest.mark.long
@pytest.mark.slow
def test_the_report_shows_the_mask(small, tmp_path):
    mask = write_mask(tmp_path / "arm.png")
    harness.run(load_experiment(small, [f"sensor.mask={mask}"]), out=tmp_path / "one").report()
    page = (tmp_path / "one" / "report.html").read_text(encoding="utf-8")
    assert re.search(r"where the camera sees itself; \d\.\d % of what the camera sees is masked \(dimmed", page)
    assert "figure-second-view" not in page
    harness.run(load_experiment(small, [f"sensor_2.mask={mask}"]), out=tmp_path / "two").report()
    page = (tmp_path / "two" / "report.html").read_text(encoding="utf-8")
    assert "160 × 120 pixels, each with a mask of its own" in page
    assert "The image of <i>v</i><sub>2</sub>, with a mask of its own" in page
