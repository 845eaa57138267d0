"""`omnirange score`: figures of maps whose errors are known beforehand, in every form in which a map may come."""

import json
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from PIL import Image

from harness.api.datasets import OF_A_SCORE, DataSet
from harness.cli.parser import main
from harness.datasets.checks.check import open_set
from harness.datasets.estimates import Meaning, estimate_of, read_estimate, suspicion
from harness.datasets.pair import VISIBLE
from harness.datasets.scoring import true_ranges
from harness.geometry.angles import angle_between
from harness.geometry.triangulation import exact_alpha_2
from harness.report import score_page

pytestmark = pytest.mark.slow


def write_npy(file, values):
    np.save(file.with_suffix(".npy"), values.astype(np.float32))


def write_npz(file, values):
    np.savez_compressed(file.with_suffix(".npz"), confidence=np.zeros(3), range_m=values.astype(np.float32))


def write_tiff(file, values):
    Image.fromarray(values.astype(np.float32)).save(file.with_suffix(".tiff"))


def write_png(steps):
    def write(file, values):
        levels = np.rint(np.nan_to_num(values) * steps)
        Image.fromarray(np.clip(levels, 0, 65535).astype(np.uint16)).save(file.with_suffix(".png"))

    return write


def estimates(folder, pairs, change, write=write_npy):
    """Write changed true ranges of pairs, by their names."""
    for pair in pairs:
        file = folder / pair.name
        file.parent.mkdir(parents=True, exist_ok=True)
        write(file, change(pair, true_ranges(pair)))
    return folder


def score(*arguments):
    """The figures of the command, and its files."""
    *given, out = (str(each) for each in arguments)
    assert main(["score", *given, "--out", out]) == 0
    return json.loads((Path(out) / "score.json").read_text())["figures"]


def figures_of(data, estimate, quantity="range"):
    """The figures alone, without a page."""
    return DataSet(data).score(estimate, quantity).figures


@pytest.fixture(scope="module")
def rooms(small_set):
    return open_set(small_set("rooms"))


@pytest.fixture(scope="module")
def panoramas(small_set):
    return open_set(small_set("panoramas"))


class TestFigures:
    def test_page_of_maps_without_any_error(self, rooms, tmp_path):
        """Ranges in double precision, as the set has them: no logarithm has anything to show."""
        estimate = estimates(
            tmp_path / "estimate", rooms.pairs, lambda _, r: r, lambda file, r: np.save(file.with_suffix(".npy"), r)
        )
        scored = DataSet(rooms).score(estimate, "range")
        assert scored.figures["range_rmse_m"] == 0
        assert score_page._over_range(scored.pairs).svg

    def test_truth_itself_is_without_error(self, rooms, tmp_path):
        estimate = estimates(tmp_path / "estimate", rooms.pairs, lambda _, r: r)
        figures = figures_of(rooms, estimate)
        assert figures["density"] == 1
        assert figures["range_rmse_m"] < 1e-6  # single precision
        assert figures["bad_1px"] == 0
        assert figures["range_delta_1.05"] == 1
        assert figures["normal_mean_deg"] < 0.1  # single precision, over a pixel's width
        assert figures["boundary_recall_0.5m"] == 1
        assert figures["seam_range_m"] is None  # a mirror image has no seam

    def test_a_seam_of_a_panorama(self, panoramas, tmp_path):
        """Ranges that are a tenth too long on the left half jump by a tenth across the seam."""

        def change(_, r):
            r = r.copy()
            r[:, : r.shape[1] // 2] *= 1.1
            return r

        estimate = estimates(tmp_path / "estimate", panoramas.pairs, change)
        figures = figures_of(panoramas, estimate)
        expected = []
        for pair in panoramas.pairs:
            truth = true_ranges(pair)
            seen = (pair.state() == VISIBLE) & (
                np.sin(angle_between(pair.maps[0].directions(), pair.motion.t_v1)) >= 0.5
            )
            both = seen[:, 0] & seen[:, -1]
            expected.append(np.mean(0.1 * truth[both, 0]))
        assert figures["seam_range_m"] == pytest.approx(np.mean(expected), rel=1e-5)

    def test_errors_that_are_known(self, rooms, tmp_path, capsys):
        """Two percent too long, and none on the left half: every figure follows by hand."""

        def change(_, r):
            r = 1.02 * r
            r[:, : r.shape[1] // 2] = np.nan
            return r

        estimate = estimates(tmp_path / "estimate", rooms.pairs, change)
        figures = score(estimate, "--truth", rooms.folder, tmp_path / "out")
        assert figures["range_abs_rel"] == pytest.approx(0.02, rel=1e-5)
        assert figures["range_silog"] == pytest.approx(0, abs=1e-6)
        expected = {"density": [], "range_bias_m": [], "range_rmse_m": []}
        for pair in rooms.pairs:
            truth, x, t = true_ranges(pair), pair.maps[0].directions(), pair.motion.t_v1
            domain = (pair.state() == VISIBLE) & (np.sin(angle_between(x, t)) >= 0.5)
            matched = domain.copy()
            matched[:, : truth.shape[1] // 2] = False
            expected["density"].append(matched.sum() / domain.sum())
            expected["range_bias_m"].append(np.mean(0.02 * truth[matched]))
            expected["range_rmse_m"].append(np.sqrt(np.mean((0.02 * truth[matched]) ** 2)))
        for name, each in expected.items():
            assert figures[name] == pytest.approx(np.mean(each), rel=1e-5)
        assert "2.00  " in capsys.readouterr().out  # AbsRel in percent
        table = pd.read_csv(tmp_path / "out" / "scores.csv")
        assert table["range_rmse_m"].to_numpy() == pytest.approx(expected["range_rmse_m"], rel=1e-5)
        parts = pd.read_csv(tmp_path / "out" / "parts.csv")
        assert {"visibility", "kind", "alpha_1", "range"} == set(parts["split"])
        page = (tmp_path / "out" / "score.html").read_text(encoding="utf-8")
        assert "Estimates against the truth" in page
        assert "could not be drawn" not in page.lower()
        for name, mark in OF_A_SCORE.marks.items():
            assert (tmp_path / "out" / name).read_bytes().startswith(mark or b"")

    def test_pixels_of_disparity_are_angles_at_view_2(self, panoramas, tmp_path):
        """A pixel too much everywhere: 2 pi/200 of alpha_2."""

        def change(pair, r):
            x, t = pair.maps[0].directions(), pair.motion.t_v1
            alpha_2 = exact_alpha_2(r[..., None] * x, t) + 2 * np.pi / 200
            return np.where(np.isfinite(r), alpha_2, np.nan)

        estimate = estimates(tmp_path / "estimate", panoramas.pairs, change)
        figures = figures_of(panoramas, estimate, "alpha-2")
        assert figures["disparity_median_abs_px"] == pytest.approx(1, rel=1e-4)  # alpha_2 in single precision
        assert figures["disparity_bias_px"] == pytest.approx(1, rel=1e-4)


def disparity(pair, range_m):
    """Degrees, by the points themselves."""
    x, up = pair.maps[0].directions(), np.array([0.0, 0.0, 1.0])
    return np.degrees(angle_between(range_m[..., None] * x - pair.motion.t_v1, up) - angle_between(x, up))


FORMS = {
    "range, NPZ": (write_npz, lambda _, r: r, Meaning(), 1e-6),
    "range, TIFF": (write_tiff, lambda _, r: r, Meaning(), 1e-6),
    # Half a level of 1/256 m.
    "range, PNG": (write_png(256), lambda _, r: r, Meaning(), 2e-3),
    "millimetres, PNG": (write_png(1000), lambda _, r: r, Meaning(scale=0.001), 5e-4),
    "inverse range": (write_npy, lambda _, r: 1 / r, Meaning("inverse-range"), 1e-5),
    # Half a level of 1/2048 degree is 4 mm at 10 m, 0.191 m being the baseline.
    "disparity, PNG": (write_png(2048), disparity, Meaning("disparity-deg"), 2e-3),
    "disparity in radians": (write_npy, lambda p, r: np.radians(disparity(p, r)), Meaning("disparity-rad"), 1e-4),
    "disparity in pixels": (write_npy, lambda p, r: disparity(p, r) * 200 / 360, Meaning("disparity-px"), 1e-4),
    "-1 for nothing": (write_npy, lambda _, r: np.nan_to_num(r, nan=-1.0), Meaning(invalid=-1.0), 1e-6),
}


@pytest.mark.parametrize("form", FORMS)
def test_every_form_gives_the_same_ranges(panoramas, tmp_path, form):
    """A set whose own depths are levels of 1/256 m."""
    write, change, meaning, tolerance_m = FORMS[form]
    pair = panoramas.pairs[0]
    file = estimate_of(pair, estimates(tmp_path, [pair], change, write))
    found, truth = read_estimate(file, meaning, pair), true_ranges(pair)
    assert np.mean(np.isfinite(found) == np.isfinite(truth)) > 0.999  # a disparity of over 32 degrees has no level
    assert np.nanmedian(np.abs(found - truth)) <= tolerance_m


def test_an_estimate_may_lie_as_the_truth_does(panoramas, tmp_path):
    shutil.copytree(panoramas.folder / "test", tmp_path / "test")
    assert DataSet(panoramas).part("test").score(tmp_path).figures["range_rmse_m"] == 0


class TestMessages:
    def test_missing_pairs_count(self, rooms, tmp_path, capsys):
        estimate = estimates(tmp_path / "estimate", rooms.pairs[:1], lambda _, r: r)
        assert main(["score", str(estimate), "--truth", str(rooms.folder)]) == 0
        said = capsys.readouterr()
        assert "25.0" in next(line for line in said.out.splitlines() if "Density" in line)
        assert "3 of 4 pairs have no estimate" in said.err

    def test_a_function_is_an_estimate(self, rooms):
        scored = DataSet(rooms).score(lambda pair: 1.05 * pair.range_m if pair.name.endswith("1") else None)
        assert len(scored.missing) == 2
        assert scored.figures["range_abs_rel"] == pytest.approx(0.05)

    @pytest.mark.parametrize(
        ("change", "said"),
        [(lambda r: 1000 * r, "they may be in millimetres"), (lambda r: 20 / r, "they may be disparities")],
    )
    def test_what_are_no_metres(self, rooms, change, said):
        truth = true_ranges(rooms.pairs[0])
        assert said in suspicion(change(truth), truth)
        assert not suspicion(1.3 * truth, truth)

    def test_another_shape(self, rooms, tmp_path, capsys):
        estimate = estimates(tmp_path / "estimate", rooms.pairs, lambda _, r: r[::2, ::2])
        assert main(["score", str(estimate), "--truth", str(rooms.folder)]) == 2
        assert "has 75 x 100 numbers, and the truth 150 x 200" in capsys.readouterr().err

    def test_disparity_of_a_rig_that_is_not_upright(self, rooms, tmp_path, capsys):
        estimate = estimates(tmp_path / "estimate", rooms.pairs, lambda _, r: r)
        assert main(["score", str(estimate), "--truth", str(rooms.folder), "--as", "disparity-deg"]) == 2
        assert "view 2 straight above view 1" in capsys.readouterr().err

    @pytest.mark.parametrize(
        ("options", "said"),
        [
            (["--split", "dev"], "no pair is in 'dev'; there are test, train"),
            (["--pair", "tset/00000/000"], "did you mean 'test/00000/000'?"),
            ([], "has no estimate of any pair; that of the first may be"),
        ],
    )
    def test_what_is_not_there(self, rooms, tmp_path, capsys, options, said):
        assert main(["score", str(tmp_path), "--truth", str(rooms.folder), *options]) == 2
        complaint = capsys.readouterr().err
        assert said in complaint
        assert complaint.count("\n") == 1
