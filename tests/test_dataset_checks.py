"""Each fault that data sets are known for is planted in a good set, and found and named; good sets pass."""

import io
import json
import re
import shutil

import numpy as np
import pytest
import yaml
from PIL import Image
from scipy import ndimage
from small_sets import NAMES

from harness.camera.sensor import rays_of, sensor_of
from harness.cli.parser import main
from harness.datasets.layouts.helvipad import DISPARITY_STEPS
from harness.geometry.pose import Pose
from harness.simulation.scene import load_scene
from harness.simulation.truth import ranges
from harness.toml import read_toml

pytestmark = pytest.mark.slow


def check(folder, capsys, only=""):
    """The exit code of the command, and what it prints."""
    code = main(["dataset", "check", str(folder), *(["--only", only] if only else [])])
    return code, capsys.readouterr().out


@pytest.mark.parametrize("name", NAMES)
def test_a_good_set_passes(small_set, name, capsys):
    code, said = check(small_set(name), capsys)
    assert code == 0, said
    count = {"rooms": 8, "panoramas": 8, "fisheyes": 6, "reconstructions": 8}[name]
    assert f"no fault was found by {count} checks" in said
    assert said.count("the set has no data for this check") == 9 - count
    assert "4 pairs" in said


@pytest.fixture
def spoilt(small_set, tmp_path):
    """Gives a copy of a good set, without its manifest, which would tell that something was changed."""

    def of(name):
        shutil.copytree(small_set(name), tmp_path / "set")
        (tmp_path / "set" / "manifest.json").unlink()
        return tmp_path / "set"

    return of


def each_npy(folder, name, change):
    """Change every array of this name by a function of it and of its folder."""
    for file in sorted(folder.rglob(name)):
        np.save(file, change(np.load(file), file.parent).astype(np.float32))


def each_png(folder, pattern, change):
    for file in sorted(folder.glob(pattern)):
        levels = change(np.array(Image.open(file)))
        Image.fromarray(levels).save(file)


def rays(pair_folder):
    scene = pair_folder.parents[2] / "scenes" / pair_folder.parent.name
    return np.load(scene / "rays_1.npy")


def half_pixel(levels):
    """An image as by a resampler that is half a pixel off along u."""
    return np.clip(np.rint(ndimage.shift(levels.astype(float), (0, 0.5), order=3, mode="nearest")), 0, 255).astype("u1")


def swap_images(folder):
    for first in sorted(folder.rglob("image_1.png")):
        second, kept = first.with_name("image_2.png"), first.read_bytes()
        first.write_bytes(second.read_bytes())
        second.write_bytes(kept)


def change_motion(folder, change):
    """Rewrite the motions of all pairs by a function of R and t; correspondences would tell before images do."""
    for file in sorted(folder.rglob("pair.toml")):
        motion = read_toml(file)["motion"]
        R, t = change(np.array(motion["R_v2_from_v1"]), np.array(motion["t_v1_m"]))
        text = re.sub(r"(?s)\[motion\].*?(?=\n\[pose_1\])", "", file.read_text())
        file.write_text(f"{text}\n[motion]\nR_v2_from_v1 = {R.tolist()}\nt_v1_m = {t.tolist()}\n")


def turned(R, t):
    return Pose(yaw_deg=1.2, pitch_deg=0.8).R_world_from_view @ R, t


def ranges_at_corners(_values, folder):
    """The truth along rays through the pixels' corners, half a pixel from where it belongs."""
    scene_folder = folder.parents[2] / "scenes" / folder.parent.name
    sensor = sensor_of(read_toml(scene_folder / "sensor_1.toml"), scene_folder)
    pose = {key: value for key, value in read_toml(folder / "pair.toml")["pose_1"].items() if key in Pose.model_fields}
    height, width = _values.shape
    v, u = (each.ravel() + 0.5 for each in np.indices((height, width), dtype=float))
    towards = rays_of(sensor, u, v)
    towards = (towards / np.linalg.norm(towards, axis=0)).T.reshape(height, width, 3)
    return ranges(load_scene(scene_folder / "scene.toml"), Pose(**pose), towards, np.isfinite(_values))


def without_correspondences(folder):
    """Sets of others do not have them; with them, they would tell first."""
    each_npy(folder, "match.npy", lambda match, _: np.full_like(match, np.nan))


OWN = {
    "range is depth along the axis": (
        "planes",
        lambda f: each_npy(f, "range_1.npy", lambda r, here: r * np.abs(rays(here)[..., 2])),
        "the maps have the depth along the camera's axis, not the range",
    ),
    "range is distance from the vertical axis": (
        "planes",
        lambda f: each_npy(f, "range_1.npy", lambda r, here: r * np.hypot(*np.moveaxis(rays(here)[..., :2], -1, 0))),
        "the maps have the distance from the camera's vertical axis",
    ),
    "images swapped": ("images", swap_images, "the images of a pair are swapped"),
    "pose inverted": (
        "images",
        lambda f: change_motion(f, lambda R, t: (R.T, -R @ t)),
        "the pose of view 2 is its inverse",
    ),
    "t of the other convention": (
        "images",
        lambda f: change_motion(f, lambda R, t: (R, -R @ t)),
        "the baseline points the other way|translation of points",
    ),
    "pose turned": (
        "images",
        lambda f: change_motion(f, turned),
        r"view 2 is turned by 1\.\d+ degrees|off their epipolar curves",
    ),
    "image 2 half a pixel off": (
        "images",
        lambda f: each_png(f, "*/*/*/image_2.png", half_pixel),
        r"image 2 is shifted against image 1 by \(\+0\.[3-6]\d, [+-]0\.[01]\d\) px",
    ),
    "ranges half a pixel off": (
        "outlines",
        lambda f: each_npy(f, "range_1.npy", ranges_at_corners),
        "the map is shifted against image 1 along [uv]",
    ),
    "range in millimetres": (
        "images",
        lambda f: each_npy(f, "range_1.npy", lambda r, _: 1000 * r),
        "ranges are in millimetres",
    ),
    "sky at 1000 m": (
        "values",
        lambda f: each_npy(f, "range_1.npy", lambda r, _: np.nan_to_num(r, nan=1000.0)),
        "has its largest value, 1000, many times",
    ),
    "nothing is 0": (
        "values",
        lambda f: each_npy(f, "range_1.npy", lambda r, _: np.nan_to_num(r)),
        "has zeros, which count as",
    ),
    "nothing is -1": (
        "values",
        lambda f: each_npy(f, "range_1.npy", lambda r, _: np.nan_to_num(r, nan=-1.0)),
        "has negative values of range",
    ),
    "nothing is infinite": (
        "values",
        lambda f: each_npy(f, "range_1.npy", lambda r, _: np.nan_to_num(r, nan=np.inf)),
        "has infinite values",
    ),
    "walls without ranges": (
        "values",
        lambda f: each_npy(f, "range_1.npy", lambda r, _: np.where(r > 2.5, np.nan, r)),
        "pixels that see a surface, by their states, have no range",
    ),
}
"""Faults of sets in the project's own layout: which check has to find it, what is done, and what has to be said."""


@pytest.mark.long
@pytest.mark.parametrize("fault", OWN)
def test_fault_is_found_and_named(spoilt, capsys, fault):
    folder = spoilt("rooms")
    without_correspondences(folder)
    only, plant, expected = OWN[fault]
    plant(folder)
    code, said = check(folder, capsys, only)
    assert code == 1, said
    assert re.search(expected, said), said


def test_correspondences_that_are_not_those_of_the_geometry(spoilt, capsys):
    folder = spoilt("rooms")
    each_npy(folder, "match.npy", lambda match, _: match + 0.5)
    code, said = check(folder, capsys, "correspondences")
    assert code == 1
    assert "a shift by (-0.5, -0.5) px, as where pixels are counted from their corners" in said


def test_calibration_that_is_another_cameras(spoilt, capsys):
    """Found by correspondences where there are any, by the images where not."""
    folder = spoilt("fisheyes")
    for file in folder.glob("*/config.yaml"):
        table = yaml.safe_load(file.read_text())
        for camera in table["cameras"]:
            poly = camera["poly"]
            camera["poly"] = [poly[0], *(each * 1.03 ** (1 - power) for power, each in enumerate(poly[1:]))]
            inverse = camera["inv_poly"]
            camera["inv_poly"] = [inverse[0], *(1.03 * each for each in inverse[1:])]
        file.write_text(yaml.safe_dump(table))
    code, said = check(folder, capsys, "images")
    assert code == 1
    assert re.search(r"the focal length is off by -[23]\.\d+ %|both images are shifted", said), said


def test_inverse_ranges_that_are_ranges(spoilt, capsys):
    folder = spoilt("fisheyes")
    for file in folder.rglob("*.tiff"):
        inverse = np.array(Image.open(file))
        Image.fromarray(np.where(inverse > 0, 1 / np.maximum(inverse, 1e-9), 0).astype(np.float32)).save(file)
    code, said = check(folder, capsys, "planes")
    assert code == 1
    assert "the inverse of what it should be" in said


def test_centres_that_are_not_shifted_for_colmap(spoilt, capsys):
    folder = spoilt("reconstructions")
    for file in folder.rglob("cameras.txt"):
        lines = file.read_text().splitlines()
        for i, line in enumerate(lines[1:], 1):
            words = line.split()
            words[6:8] = [repr(float(word) - 0.5) for word in words[6:8]]
            lines[i] = " ".join(words)
        file.write_text("\n".join([*lines, ""]))
    code, said = check(folder, capsys, "correspondences")
    assert code == 1
    assert "a shift by (-0.5, -0.5) px" in said


def disparities(change):
    """Change the disparities of Helvipad's layout, in degrees."""

    def plant(folder):
        for file in folder.glob("*/disparity_maps/*/*.png"):
            levels = np.array(Image.open(file)).astype(float)
            changed = np.rint(DISPARITY_STEPS * change(levels / DISPARITY_STEPS)) % 65536
            Image.fromarray(np.where(levels > 0, changed, 0).astype(np.uint16)).save(file)

    return plant


def legacy(folder):
    """Disparities by the formula with the other sign before the cosine."""
    for file in folder.glob("*/disparity_maps/*/*.png"):
        range_m = np.array(Image.open(str(file).replace("disparity_maps", "depth_maps"))) / 256.0
        polar = np.pi * (np.arange(range_m.shape[0])[:, None] + 0.5) / range_m.shape[0]
        wrong = np.degrees(np.arctan2(0.191 * np.sin(polar), range_m + 0.191 * np.cos(polar)))
        Image.fromarray(np.where(range_m > 0, np.rint(wrong * DISPARITY_STEPS), 0).astype(np.uint16)).save(file)


HELVIPAD = {
    "disparity in pixels": (
        "disparity",
        disparities(lambda d: d * 100 / 180),
        "they agree to .* if they are in pixels",
    ),
    "disparity in radians": ("disparity", disparities(np.radians), "if they are in radians"),
    "disparity of the other sign": ("disparity", disparities(lambda d: -d), "if their sign is the other one"),
    "disparity of half the baseline": (
        "disparity",
        disparities(lambda d: d / 2),
        "if they are those of half the baseline",
    ),
    "the other sign before the cosine": ("disparity", legacy, "if the sign before the cosine is the other one"),
    "top and bottom exchanged": (
        "images",
        lambda f: [
            (base / "images_top").rename(base / "kept")
            and (base / "images_bottom").rename(base / "images_top")
            and (base / "kept").rename(base / "images_bottom")
            for base in (f / "train", f / "test")
        ],
        "the images of a pair are swapped",
    ),
}


@pytest.mark.parametrize("fault", HELVIPAD)
def test_fault_of_disparities_is_found_and_named(spoilt, capsys, fault):
    folder = spoilt("panoramas")
    only, plant, expected = HELVIPAD[fault]
    plant(folder)
    code, said = check(folder, capsys, only)
    assert code == 1, said
    assert re.search(expected, said), said


def test_helvipads_own_crop_needs_no_file_of_ours(spoilt, capsys):
    """Its images are the rows 192 to 703 of 960; its baseline is 0.191 m."""
    folder = spoilt("panoramas")
    (folder / "calibration.toml").unlink()
    each_png(folder, "*/*/*/*.png", lambda levels: levels[20:73])
    code, said = check(folder, capsys, "readable,planes,disparity,images")
    assert code == 0, said


def test_a_lasers_few_points_are_enough(spoilt, capsys):
    """One pixel in ten has a range, as in Helvipad's own maps."""
    folder = spoilt("panoramas")
    draws = np.random.default_rng(1)

    def thin_out(levels):
        return np.where(draws.random(levels.shape) < 0.1, levels, 0).astype(np.uint16)

    for kind in ("depth_maps", "disparity_maps"):
        each_png(folder, f"*/{kind}/*/*.png", thin_out)
    for states in folder.glob("*/states"):
        shutil.rmtree(states)
    code, said = check(folder, capsys, "values,planes,disparity,outlines,images")
    assert code == 0, said
    HELVIPAD["top and bottom exchanged"][1](folder)
    code, said = check(folder, capsys, "images")
    assert code == 1
    assert "the images of a pair are swapped" in said


def test_wrong_formula_is_found_by_images_where_there_are_no_ranges(spoilt, capsys):
    folder = spoilt("panoramas")
    legacy(folder)
    for depths in folder.glob("*/depth_maps"):
        shutil.rmtree(depths)
    code, said = check(folder, capsys, "images")
    assert code == 1
    assert "disparities have the sign before the cosine the other way" in said


class TestFiles:
    def test_what_was_changed_is_missing_or_cut(self, small_set, tmp_path, capsys):
        shutil.copytree(small_set("rooms"), tmp_path / "set")
        changed, gone, cut, image = (
            min((tmp_path / "set").rglob(name)) for name in ("normal.npy", "range_2.npy", "range_1.npy", "image_1.png")
        )
        data = bytearray(changed.read_bytes())
        data[-1] ^= 1
        changed.write_bytes(data)
        gone.unlink()
        cut.write_bytes(cut.read_bytes()[:-1000])
        image.write_bytes(image.read_bytes()[:-1000])
        (tmp_path / "set" / "notes.txt").touch()
        code, said = check(tmp_path / "set", capsys, "checksums,readable")
        assert code == 1
        name = changed.parent.relative_to(tmp_path / "set").as_posix()
        assert f"{name}/normal.npy: has another SHA-256" in said
        assert f"{name}/range_2.npy: is in the manifest, and not there" in said
        assert "is shorter than the manifest says: it was cut off" in said
        assert "notes.txt: is there, and not in the manifest" in said
        assert f"{name}: range_1.npy: cannot be read as an array" in said
        assert f"{name}: image_1.png: cannot be read as an image" in said

    def test_an_image_of_another_size_than_its_calibration(self, spoilt, capsys):
        folder = spoilt("rooms")
        each_png(folder, "*/*/*/image_1.png", lambda levels: levels[:, :-2])
        code, said = check(folder, capsys, "readable")
        assert code == 1
        assert "is 198 x 150 pixels, its calibration 200 x 150" in said


class TestDuplicates:
    def test_a_pair_of_one_part_in_the_other_after_jpeg(self, spoilt, capsys):
        folder = spoilt("panoramas")
        first, second = (min((folder / part / "images_bottom").rglob("*.png")) for part in ("train", "test"))
        stream = io.BytesIO()
        Image.open(first).save(stream, format="JPEG", quality=85)
        Image.open(stream).save(second)
        code, said = check(folder, capsys, "duplicates")
        assert code == 1
        assert "two parts of the split have the same image, in files that differ" in said
        assert said.count("two images are the same file") == 0

    def test_a_scene_in_two_parts(self, spoilt, capsys):
        folder = spoilt("rooms")
        pair = min((folder / "train").glob("*/*"))
        moved = folder / "test" / pair.parent.name / pair.name
        moved.parent.mkdir(exist_ok=True)
        shutil.move(pair, moved)
        code, said = check(folder, capsys, "duplicates")
        assert code == 1
        assert f"{pair.parent.name}: the scene is in several parts of the split: test, train" in said

    def test_the_same_file_twice(self, spoilt, capsys):
        folder = spoilt("rooms")
        first, second = sorted((folder / "train").rglob("image_1.png"))
        shutil.copy(first, second)
        code, said = check(folder, capsys, "duplicates")
        assert code == 1
        assert "two images are the same file" in said


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["check"], "DIR: is missing"),
        (["check", "nowhere"], "nowhere: is no folder of a data set"),
        (["check", "."], "laid out in no known way; known are omnirange's own, Helvipad's"),
        (["rooms", "there"], "a set is made with --out there"),
    ],
)
def test_what_is_no_set(arguments, said, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["dataset", *arguments]) == 2
    complaint = capsys.readouterr().err
    assert said in complaint
    assert complaint.count("\n") == 1


def test_a_table_of_geometry_that_is_none(spoilt, capsys):
    folder = spoilt("rooms")
    file = min(folder.rglob("pair.toml"))
    file.write_text(file.read_text().replace("t_v1_m", "t_v1"))
    assert main(["dataset", "check", str(folder)]) == 2
    assert "t_v1_m: must be numbers, 3 of them" in capsys.readouterr().err


def test_a_manifest_that_is_no_table(spoilt, capsys):
    folder = spoilt("rooms")
    (folder / "manifest.json").write_text(json.dumps([1, 2]))
    assert main(["dataset", "check", str(folder)]) == 2
    assert "must be a table in JSON" in capsys.readouterr().err
