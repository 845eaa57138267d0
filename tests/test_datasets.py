"""Data sets: what is in them is true, the same however they are made, and what they cannot be is said."""

import json
import shutil
import signal

import numpy as np
import pytest
from small_sets import NAMES, made, small, tree
from sweeps import begin

from harness import shipped
from harness.cli.parser import main
from harness.datasets.layouts import LAYOUTS
from harness.datasets.layouts.helvipad import disparity_deg, polar_of, range_of_disparity
from harness.datasets.layouts.reading import read_array, read_grey
from harness.datasets.loading import load_spec
from harness.datasets.making import Journal, _refuse_alike, file_hash, is_complete, make
from harness.datasets.manifest import JOURNAL, MANIFEST, FileRecord, SceneRecord, splits_of
from harness.datasets.pair import OCCLUDED, OUTSIDE, VISIBLE
from harness.datasets.rooms import draw_room
from harness.datasets.surfaces import revolution
from harness.errors import InputError
from harness.geometry.angles import angle_between
from harness.runs.executors import Backend, _in_process, backend_for
from harness.spec import dump_toml
from harness.toml import read_toml


def layout_of(name):
    return LAYOUTS[small(name).layout]


@pytest.fixture(scope="module")
def pairs(small_set):
    return layout_of("rooms").read(small_set("rooms"))


class TestTruth:
    """Truth in the project's own layout; the others are made from the same arrays."""

    @pytest.mark.slow
    def test_both_views_agree_on_every_point(self, pairs):
        """View 2's own ranges, traced from there, at the places where view 1's points are said to be."""
        for pair in pairs:
            range_2 = read_array(pair.views[1].image.parent / "range_2.npy")
            range_1, state, match = pair.maps[0].read(), pair.state(), pair.match()
            point = pair.motion.apply(pair.maps[0].directions() * range_1[..., None])
            distance = np.linalg.norm(point, axis=-1)
            there = np.isfinite(match[..., 0])
            column, row = np.rint(match[there]).astype(int).T
            known = np.isfinite(range_2[row, column])  # not at the rim, where a pixel's centre may see nothing
            there[there] = known
            column, row = column[known], row[known]
            assert known.mean() > 0.98
            ratio = distance[there] / range_2[row, column]
            state = state[there]
            # The nearest pixel's ray is up to 0.7 px away: on most surfaces a percent of the range.
            assert np.median(np.abs(ratio[state == VISIBLE] - 1)) < 0.005
            assert np.mean(np.abs(ratio[state == VISIBLE] - 1) < 0.1) > 0.95
            hidden = ratio[state == OCCLUDED]
            assert hidden.size == 0 or np.mean(hidden > 0.98) > 0.9  # something nearer stands there
            assert not there[pair.state() == OUTSIDE].any()

    @pytest.mark.slow
    def test_normals_are_those_of_the_points(self, pairs):
        for pair in pairs:
            points = pair.maps[0].directions() * pair.maps[0].read()[..., None]
            normal = read_array(pair.views[0].image.parent / "normal.npy").astype(float)
            assert np.nanmax(np.sum(normal * points, axis=-1)) < 0  # towards the view
            for axis in (0, 1):
                along = np.diff(points, axis=axis)
                start = normal[:-1] if axis == 0 else normal[:, :-1]
                off = np.abs(np.sum(start * along, axis=-1)) / np.linalg.norm(along, axis=-1)
                # Neighbours on one plane; half precision has three digits. Others are creases and outlines.
                assert np.nanmedian(off) < 1e-3

    @pytest.mark.slow
    def test_scene_is_rendered_again_by_the_command(self, small_set, tmp_path):
        folder = small_set("rooms")
        pair = layout_of("rooms").read(folder)[0]
        pose = read_toml(pair.views[0].image.parent / "pair.toml")["pose_1"]
        scene = folder / "scenes" / pair.scene
        at = [str(each) for each in pose["position_m"]]
        angles = [word for name in ("yaw", "pitch", "roll") for word in (f"--{name}-deg", str(pose[f"{name}_deg"]))]
        command = ["render", str(scene / "scene.toml"), "--sensor", str(scene / "sensor_1.toml"), "--at", *at, *angles]
        assert main([*command, "--samples", "4", "--out", str(tmp_path)]) == 0
        again = np.load(tmp_path / "range.npy")
        np.testing.assert_allclose(again, pair.maps[0].read(), rtol=1e-6)  # single precision
        sigma = read_toml(pair.views[0].image.parent / "pair.toml")["noise_sigma_grey"]
        error = read_grey(pair.views[0].image) - read_grey(tmp_path / "omni.png")
        # Both are rounded, and grey levels are cut at 0 and 255.
        assert np.std(error[np.isfinite(again)]) < np.hypot(sigma, 0.5) + 0.05


class TestLayouts:
    @pytest.mark.slow
    @pytest.mark.parametrize("name", NAMES)
    def test_a_folder_is_known_for_what_it_is(self, small_set, name):
        folder = small_set(name)
        assert [each.name for each in LAYOUTS.values() if each.recognises(folder)] == [small(name).layout]
        pairs = layout_of(name).read(folder)
        assert len({each.name for each in pairs}) == 4
        assert {each.split for each in pairs} == {"train", "test"}
        scenes = {split: {each.scene for each in pairs if each.split == split} for split in ("train", "test")}
        assert not scenes["train"] & scenes["test"]
        assert (folder / "README.txt").read_text().count("Range") + (folder / "README.txt").read_text().count("depth")

    @pytest.mark.slow
    def test_disparity_in_degrees_is_the_angle_between_the_views(self, small_set):
        pair = layout_of("panoramas").read(small_set("panoramas"))[0]
        depth, disparity = pair.maps
        x, range_m, stated = depth.directions(), depth.read(), disparity.read()
        B = np.array([0.0, 0.0, pair.motion.baseline_m])
        points = x * range_m[..., None]
        seen = np.isfinite(range_m) & np.isfinite(stated)
        angle = np.degrees(angle_between(points - B, x))
        # A level of range is 4 mm, half of which moves the angle by B sin(psi)/r^2 times that: 0.02 degrees at 0.4 m.
        assert np.abs(angle - stated)[seen].max() < 0.03
        back = range_of_disparity(stated, polar_of(x), B[2])
        far = seen & (range_m > 1)
        assert np.median(np.abs(back - range_m)[far]) < 4e-3

    def test_disparity_formula_at_points_worked_out_by_hand(self):
        # At the height of the bottom camera, as far as the baseline is long: 45 degrees from the top one.
        assert disparity_deg(np.array(0.2), np.array(np.pi / 2), 0.2) == pytest.approx(45)
        # A point level with the top camera, at its distance from the bottom one: an isosceles right triangle.
        polar, range_m = np.array(np.pi / 4), np.array(0.2 * np.sqrt(2))
        assert disparity_deg(range_m, polar, 0.2) == pytest.approx(45)
        assert range_of_disparity(np.array(45.0), polar, 0.2) == pytest.approx(range_m)
        assert np.isnan(range_of_disparity(np.array([0.0, -1.0]), polar, 0.2)).all()

    @pytest.mark.slow
    def test_colmap_itself_reads_it_and_its_points_project_to_their_pixels(self, small_set):
        pycolmap = pytest.importorskip("pycolmap")
        models = sorted(small_set("reconstructions").glob("*/*/sparse"))
        assert len(models) == 2
        for model in models:
            reconstruction = pycolmap.Reconstruction(str(model))
            assert reconstruction.num_images() == 4
            errors = []
            for image in reconstruction.images.values():
                for observed in image.points2D:
                    point = reconstruction.points3D[observed.point3D_id].xyz
                    errors.append(np.linalg.norm(image.project_point(point) - observed.xy))
            assert len(errors) > 100
            assert np.max(errors) < 1e-6  # other code, all in double precision

    @pytest.mark.slow
    def test_panorama_of_inverse_ranges_agrees_with_the_scene(self, small_set):
        folder = small_set("fisheyes")
        pair = layout_of("fisheyes").read(folder)[0]
        inverse = pair.maps[0].read()
        assert inverse.shape == (40, 160)
        # The row of the horizon: level rays in a room at most 12 m by 9 m, and no less than the clearance away.
        level = 1 / inverse[19:21]
        assert np.nanmin(level) > 0.2
        assert np.nanmax(level) < 15
        assert read_array(pair.maps[0].file).dtype == np.float32


@pytest.mark.slow
class TestMaking:
    @pytest.mark.long
    def test_same_bits_in_two_processes_and_after_ctrl_c(self, tmp_path):
        spec = small("rooms", scenes=3, pairs_per_scene=1)
        whole = made(spec, tmp_path / "whole")
        given = tmp_path / "spec.toml"
        given.write_text(dump_toml(spec), encoding="utf-8")
        out = tmp_path / "resumed"
        out.mkdir()
        journal = Journal(spec, out)

        def strike(_):
            signal.raise_signal(signal.SIGINT)

        with pytest.raises(KeyboardInterrupt):
            make(spec, out, backend_for(0.0, 1, workers=1), journal, strike)
        assert 0 < len(Journal(spec, out).done) < 3
        assert not is_complete(spec, out)
        first = next(iter(Journal(spec, out).done.values()))
        cut = out / next(path for path in first.files if path.endswith("range_1.npy"))
        cut.write_bytes(cut.read_bytes()[:100])  # as after a power cut: made again
        process = begin(tmp_path, "dataset", given, "--out", out, "--workers", "2")
        said, complained = process.communicate(timeout=600)
        assert process.returncode == 0, complained
        assert "pairs made" in said
        assert tree(out) == tree(whole)

    def test_same_bits_from_workers_that_send_their_files(self, small_set, tmp_path):
        elsewhere = Backend(_in_process, workers=1, slots=1, remote=True)
        assert tree(made(small("panoramas"), tmp_path, elsewhere)) == tree(small_set("panoramas"))

    def test_manifest_has_every_file(self, small_set):
        folder = small_set("rooms")
        manifest = json.loads((folder / MANIFEST).read_text())
        files = set(tree(folder)) - {MANIFEST}
        assert set(manifest["files"]) == files
        assert all(file_hash(folder / path) == manifest["files"][path]["sha256"] for path in files)
        assert manifest["licence"] == "CC0-1.0"
        assert manifest["pairs"] == 4

    def test_nothing_is_made_twice(self, small_set, tmp_path, capsys):
        shutil.copytree(small_set("rooms"), tmp_path / "set")
        before = {path: path.stat().st_mtime_ns for path in (tmp_path / "set").rglob("*")}
        (tmp_path / "set" / JOURNAL).touch()  # as if stopped between the manifest and the journal's end
        given = tmp_path / "spec.toml"
        given.write_text(dump_toml(small("rooms")), encoding="utf-8")
        assert main(["dataset", str(given), "--out", str(tmp_path / "set")]) == 0
        assert "nothing to do" in capsys.readouterr().out
        assert {path: path.stat().st_mtime_ns for path in (tmp_path / "set").rglob("*")} == before

    def test_a_finished_set_with_a_file_cut_off_is_not_called_finished(self, small_set, tmp_path, capsys):
        shutil.copytree(small_set("rooms"), tmp_path / "set")
        cut, gone, *_ = sorted((tmp_path / "set").rglob("range_1.npy"))
        cut.write_bytes(cut.read_bytes()[:100])
        gone.unlink()
        given = tmp_path / "spec.toml"
        given.write_text(dump_toml(small("rooms")), encoding="utf-8")
        assert main(["dataset", str(given), "--out", str(tmp_path / "set")]) == 2
        said = capsys.readouterr().err
        assert f"{cut}: is missing or cut off, as 2 of the" in said
        manifest = tmp_path / "set" / MANIFEST
        manifest.write_text(json.dumps(json.loads(manifest.read_text()) | {"files": 3}))
        assert main(["dataset", str(given), "--out", str(tmp_path / "set")]) == 2
        assert f"{manifest}: has no table of the set's files" in capsys.readouterr().err

    def test_plan_says_time_and_space(self, capsys):
        tiny = ["rig.width_px=64", "rig.height_px=48", "samples=1", "furniture.curved=[0,0]"]
        assert main(["dataset", "rooms", "--dry-run", *(word for each in tiny for word in ("--set", each))]) == 0
        said = capsys.readouterr().out
        assert "1000 pairs in 100 scenes" in said
        assert "GB" in said


class TestJournal:
    def test_another_set_is_refused(self, tmp_path):
        Journal(small("rooms"), tmp_path)
        with pytest.raises(InputError, match="another specification"):
            Journal(small("rooms", seed=2), tmp_path)

    @pytest.mark.parametrize("content", [b"notes\n", b"\xff\xfe", b""])
    def test_a_file_of_ones_own_is_no_journal(self, content, tmp_path):
        own = tmp_path / JOURNAL
        own.write_bytes(content)
        with pytest.raises(InputError, match=r"finished\.jsonl: is no journal of a set; give another folder"):
            Journal(small("rooms"), tmp_path)
        assert own.read_bytes() == content

    def test_what_was_left_half_written_is_none_of_ones_own(self, tmp_path):
        (tmp_path / f".{'0' * 32}.partial").touch()
        Journal(small("rooms"), tmp_path)
        own = tmp_path / "another" / "film.partial"
        own.parent.mkdir()
        own.touch()
        with pytest.raises(InputError, match="is not empty"):
            Journal(small("rooms"), own.parent)

    def test_other_code_is_refused(self, tmp_path, monkeypatch):
        Journal(small("rooms"), tmp_path)
        monkeypatch.setattr("harness.datasets.making.maker_hash", lambda: "other")
        with pytest.raises(InputError, match="another version"):
            Journal(small("rooms"), tmp_path)

    def test_somebody_elses_folder_is_left_alone(self, tmp_path):
        (tmp_path / "thesis.tex").touch()
        with pytest.raises(InputError, match="not empty"):
            Journal(small("rooms"), tmp_path)

    def test_a_line_that_was_cut_off_is_no_scene(self, tmp_path):
        journal = Journal(small("rooms"), tmp_path)
        journal.add(SceneRecord(0, "train", {}))
        journal.add(SceneRecord(1, "test", {"gone.png": FileRecord("00", 7)}))
        with (tmp_path / "finished.jsonl").open("a") as stream:
            stream.write('{"scene": 2, "spl')
        assert list(Journal(small("rooms"), tmp_path).done) == [0]

    def test_two_images_alike_are_refused(self):
        files = [{f"train/{i}/000/image_1.png": FileRecord("same", 7)} for i in range(2)]
        with pytest.raises(InputError, match="train/0/000/image_1"):
            _refuse_alike([SceneRecord(i, "train", each) for i, each in enumerate(files)])


class TestDraws:
    def test_a_scene_depends_on_its_number_alone(self):
        few, many = small("rooms"), small("rooms", scenes=50, pairs_per_scene=7)
        assert draw_room(few, 1) == draw_room(many, 1)
        assert draw_room(few, 0).table != draw_room(few, 1).table
        assert draw_room(few, 0).table != draw_room(small("rooms", seed=2), 0).table

    def test_split_has_its_shares(self):
        parts = splits_of(load_spec("rooms"))
        assert [parts.count(part) for part in ("train", "val", "test")] == [80, 10, 10]
        assert parts != sorted(parts, reverse=True)  # drawn, not in order

    def test_a_body_is_closed(self):
        trimesh = pytest.importorskip("trimesh")
        import io

        height = np.linspace(0, 1, 17)
        content = revolution(0.2 + 0.1 * np.sin(5 * height), height)
        mesh = trimesh.load(io.BytesIO(content), file_type="ply")
        assert mesh.is_watertight
        # A 24-gon has sin(15 degrees)/(15 degrees) of the circle's area.
        area = np.pi * (0.2 + 0.1 * np.sin(5 * height)) ** 2 * np.sinc(15 / 180)
        assert mesh.volume == pytest.approx(np.trapezoid(area, height), rel=0.01)


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"rig.baseline_m": "[0.1, 3.0]"}, "rig.baseline_m = 3"),
        ({"rig.baseline_m": "[0.5, 0.1]"}, "rig: baseline_m: the lowest value must come first"),
        ({"split.train": "0.5"}, "must add up to 1; found 0.7"),
        ({"layout": "helvipad"}, "the layout helvipad cannot describe 'mirror'; valid: equirectangular"),
        ({"rig.cameras": '["mirorr"]'}, "did you mean 'mirror'?"),
        ({"room.windows": "[0, 5]"}, "a room has 4 walls"),
        ({"rig.cameras": '["equirectangular"]'}, "twice as wide as high"),
        ({"surfaces.nois": "1"}, "did you mean 'noise'?"),
        ({"samples": "5"}, "samples"),
        ({"rig.viewpoint_height_m": "[2.3, 2.4]"}, "do not fit under a ceiling"),
    ],
)
def test_what_cannot_be_is_said(changed, said, capsys, tmp_path):
    words = [word for key, value in changed.items() for word in ("--set", f"{key}={value}")]
    assert main(["dataset", "rooms", "--out", str(tmp_path / "out"), *words]) == 2
    complaint = capsys.readouterr().err
    assert said in complaint
    assert complaint.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_every_shipped_specification_is_of_a_layout_of_its_own():
    specs = [load_spec(name) for name in shipped.names("datasets")]
    assert sorted(each.layout for each in specs) == sorted(LAYOUTS)
    assert all(each.pairs == 1000 and each.description for each in specs)


def test_out_is_asked_for(capsys):
    assert main(["dataset"]) == 2
    assert "--out: is missing" in capsys.readouterr().err


def test_every_key_has_a_meaning(capsys):
    assert main(["dataset", "--describe"]) == 0
    said = capsys.readouterr().out
    assert said.count("\n    meaning") == said.count("\n    type")
    assert "rig.baseline_m" in said
