"""The designer: predictions against closed forms and simulated images, and a search that leaves nothing out."""

import numpy as np
import pytest
from browser import chromium, visit

import harness
from harness.camera.sensor import Sensor
from harness.cli import main
from harness.design.answers import Cost, answers, candidates, height_m, mirror_diameter_m, resized
from harness.design.answers import _variants as variants
from harness.design.budget import CAUSES, budget, directions_of
from harness.design.gradients import aliased_grey, gradient_grey
from harness.design.rig import RigDesign
from harness.design.verify import drawn, verify
from harness.errors import InputError
from harness.evaluation.propagation import range_errors
from harness.evaluation.rig_uncertainty import Odometry, Uncertainty
from harness.evaluation.statistics import central_68
from harness.geometry.angles import angle_between, normalise
from harness.simulation.texture import BundledTexture, NoiseTexture, texels_of

GRAVEL = BundledTexture(kind="bundled", name="gravel", tile_m=6.0)
ALL = Uncertainty(
    rotation_deg=0.02,
    t_direction_deg=0.1,
    t_length=0.002,
    focal=0.0005,
    centre_px=0.1,
    shape=0.001,
    alignment_mm=0.1,
    alignment_deg=0.05,
)


def test_rotation_follows_the_law_and_t_the_range():
    """Straight across the baseline a rotation error of sigma about each axis makes `d_2²/|t|` sigma of range error."""
    across = normalise(np.array([0.0, 1.0, 0.0]))
    for range_m in (1.0, 4.0):
        point = range_m * across[None]
        d_2 = np.hypot(range_m, 0.5)
        turned = budget(RigDesign(uncertainty=Uncertainty(rotation_deg=0.05)), point).sigma_m
        assert turned["rotation"] == pytest.approx([d_2**2 / 0.5 * np.radians(0.05)], rel=1e-6)
        longer = budget(RigDesign(uncertainty=Uncertainty(t_length=0.01)), point).sigma_m
        assert longer["t length"] == pytest.approx([0.01 * range_m], rel=1e-6)
        tilted = budget(RigDesign(uncertainty=Uncertainty(t_direction_deg=0.1)), point).sigma_m
        # d cot(alpha_2): here alpha_2 is 90 degrees and the angle that |t| takes of it.
        assert tilted["t direction"] == pytest.approx([range_m * 0.5 / range_m * np.radians(0.1)], rel=1e-5)


def test_odometry_grows_with_the_path_and_the_turn():
    point = np.array([[0.0, 4.0, 0.0]])
    for baseline_m, turn_deg in ((0.25, 0.0), (1.0, 40.0), (1.0, -40.0)):
        known = Uncertainty(odometry=Odometry(rotation_deg_per_m=0.3, rotation_per_turn=0.01))
        rig = RigDesign(baseline_m=baseline_m, turn_deg=turn_deg, uncertainty=known)
        turned = np.hypot(np.radians(0.3) * baseline_m, 0.01 * np.radians(turn_deg))
        expected = (16 + baseline_m**2) / baseline_m * turned
        assert budget(rig, point).sigma_m["odometry"] == pytest.approx([expected], rel=1e-6)
    # A mirror looks alike all around, so that a turned view 2 knows as much of a surface as one that is not.
    straight, turned = (budget(RigDesign(turn_deg=turn, uncertainty=ALL), point).sigma_m for turn in (0.0, 70.0))
    for cause in ("noise", "matching", "rotation", "t direction", "t length"):
        assert turned[cause] == pytest.approx(straight[cause], rel=1e-6)


def test_causes_add_as_variances_and_what_is_exact_costs_nothing():
    points = 3 * directions_of(RigDesign())
    parts = budget(RigDesign(uncertainty=ALL), points)
    assert list(parts.sigma_m) == list(CAUSES)
    total = np.sqrt(sum(each**2 for each in parts.sigma_m.values()))
    assert parts.total_m == pytest.approx(total)
    exact = budget(RigDesign(), points).sigma_m
    assert not any(exact[name].any() for name in CAUSES[2:])


def test_along_the_baseline_and_outside_the_field_nothing_is_known():
    parts = budget(RigDesign(), np.array([[3.0, 1e-9, 0.0], [0.0, 0.1, 3.0], [0.0, 3.0, 0.0]]))
    assert parts.total_m[0] > 100
    assert np.isinf(parts.total_m[1])
    assert np.isfinite(parts.total_m[2])


def test_draws_scatter_as_the_budget_says():
    rig = RigDesign(uncertainty=ALL)
    points = 4 * directions_of(rig)[::9]
    errors = [range_errors(points, true, rig.believed) for true in drawn(rig, 60, np.random.default_rng(1))]
    parts = budget(rig, points).sigma_m
    expected = np.sqrt(sum(parts[name] ** 2 for name in CAUSES[2:]))
    # The draws have exactly the covariance: what is left is of second order.
    assert np.sqrt(np.mean(np.square(errors), axis=0)) == pytest.approx(expected, rel=0.03)


def test_the_gradient_of_a_texture_is_that_of_its_means():
    """Means over blocks of texels, differenced: below Nyquist a difference is a wave's slope times its sinc."""
    texture = NoiseTexture(kind="noise", seed=3, tile_m=4.0, shortest_m=0.25, longest_m=1.0)
    texels = np.asarray(texels_of(texture), dtype=np.float64)
    block = texels.shape[1] // 128
    size_m = texture.tile_m / 128  # an eighth of the shortest wave
    means = texels.reshape(128, block, 128, block).mean(axis=(1, 3))
    central = (np.roll(means, -1, axis=1) - np.roll(means, 1, axis=1)) / 2
    # A central difference over two pixels has sin(k)/k of a slope: 0.97 where waves are eight pixels and more.
    assert gradient_grey(texture, np.array([size_m]))[0] == pytest.approx(np.sqrt(np.mean(central**2)), rel=0.06)
    assert aliased_grey(texture, np.array([size_m]))[0] < 0.1  # the clipping of its grey levels alone
    assert aliased_grey(texture, np.array([0.5]))[0] > 1


def test_a_mixture_of_normal_distributions():
    assert central_68(np.full(10, 2.5)) == pytest.approx(2.5, rel=1e-6)
    rng, sigma = np.random.default_rng(0), np.array([1.0, 1.0, 5.0])
    drawn_errors = np.abs(rng.standard_normal((200_000, 3)) * sigma)
    assert central_68(sigma) == pytest.approx(np.quantile(drawn_errors, 0.682689), rel=0.01)
    assert central_68(np.array([1.0, np.inf, np.inf])) == np.inf


def test_resized_sensors_see_the_same():
    sensor = Sensor()
    twice = resized(sensor, 1280, 1.5)
    x = directions_of(RigDesign())
    pixels, larger = (harness.project(each, x)[0] for each in (sensor, twice))
    assert larger == pytest.approx(2 * (pixels + 0.5) - 0.5, abs=1e-9)
    assert mirror_diameter_m(twice) == pytest.approx(1.5 * mirror_diameter_m(sensor))
    assert height_m(twice) == pytest.approx(1.5 * height_m(sensor))
    # The default mirror, by the hyperboloid's own equation at 20 degrees.
    r, z = mirror_diameter_m(sensor) / 2, height_m(sensor) - 2 * sensor.model.e_m
    assert np.degrees(np.arctan2(z, r)) == pytest.approx(20)
    assert ((z + sensor.model.e_m) / sensor.model.a_m) ** 2 - (r / sensor.model.b_m) ** 2 == pytest.approx(1)


@pytest.mark.slow
def test_the_search_leaves_no_cheaper_rig_out():
    base = RigDesign(uncertainty=ALL)
    found = candidates(base, 0.04, 4.0, baseline_max_m=0.5, most=4)
    assert [each.cost for each in found] == sorted(each.cost for each in found)
    assert all(each.answer.error_m <= 0.04 and each.rig.baseline_m <= 0.5 for each in found)
    price = Cost()
    affordable = [rig for rig in variants(base, 0.5, np.inf, None) if price.of(rig) <= found[-1].cost]
    reached = [rig for rig in affordable if answers(rig, [4.0])[0].error_m <= 0.04]
    assert sorted(map(price.of, reached)) == pytest.approx([each.cost for each in found])
    assert all(each.margin == pytest.approx(0.04 / each.answer.error_m) for each in found)


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.parametrize(
    "rig",
    [
        RigDesign(noise_grey=6.0),
        RigDesign(noise_grey=2.0, uncertainty=Uncertainty(rotation_deg=0.04, centre_px=0.3, focal=0.001)),
    ],
    ids=["noise", "what is believed"],
)
def test_predictions_are_those_of_simulated_images(rig):
    result = verify(rig, 3.0, draws=6)
    assert result.density > 0.95
    # What the designer claims, `benchmarks/design.py`.
    assert result.ratio == pytest.approx(1, abs=0.25)


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"baseline_m": 0}, "rig: baseline_m"),
        ({"window_px": 8}, "window_px must be odd; found 8"),
        ({"sensor": {"misalignment": {"x_mm": 1.0}}}, r"uncertainty\.alignment_mm"),
        ({"uncertainty": {"rotation": 1}}, r"uncertainty\.rotation"),
        (
            {
                "sensor": {"model": {"kind": "equirectangular"}},
                "uncertainty": {"alignment_mm": 1.0},
            },
            "are for sensors with a hyperboloid mirror",
        ),
    ],
)
def test_what_is_wrong_is_named(table, message):
    with pytest.raises(InputError, match=message):
        harness.describe_rig(table)


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ({"width_px": 0}, "width_px: must be 8 to 16384; found 0"),
        ({"most": 0}, "most: must be at least 1; found 0"),
        ({"height_max_m": -1.0}, "height_max_m: must be above 0; found -1"),
    ],
)
def test_what_cannot_be_searched_for_is_named(asked, message):
    with pytest.raises(InputError, match=message):
        harness.find_rigs(0.03, 4.0, **asked)


@pytest.mark.parametrize(
    ("option", "message"),
    [
        (["--at", "0"], "--at: must be a number above 0; found '0'"),
        (["--verify", "-1"], "--verify: must be a whole number of at least 1; found '-1'"),
        (["--accuracy", "0.03@4", "--most", "0"], "--most: must be a whole number of at least 1"),
        (["--accuracy", "0.03@4", "--width", "0"], "--width: must be a whole number of at least 1"),
        (["--accuracy", "0.03@4", "--cost", "nan", "0", "0"], "--cost: must be a number from 0; found 'nan'"),
    ],
)
def test_options_that_make_no_sense_are_named(option, message, capsys):
    with pytest.raises(SystemExit, match="2"):
        main(["design", *option])
    assert message in capsys.readouterr().err


def test_the_page_is_refused_before_anything_is_worked_out(capsys):
    assert main(["design", "--out", "folder"]) == 2
    captured = capsys.readouterr()
    assert "folder: must end in .html" in captured.err
    assert not captured.out


@pytest.mark.slow
def test_a_lens_has_no_mirror_in_the_table(tmp_path, capsys):
    rig = tmp_path / "rig.toml"
    rig.write_text('sensor = "fisheye"\n')
    assert main(["design", str(rig), "--accuracy", "0.03@4", "--most", "1", "--width", "640"]) == 0
    assert "mirror" not in capsys.readouterr().out


@pytest.mark.slow
def test_from_python():
    described = harness.describe_rig({"uncertainty": {"rotation_deg": 0.05}}, [2.0, 8.0])
    assert described.table.index.tolist() == [2.0, 8.0]
    assert described.table.leading.tolist() == ["rotation", "rotation"]
    assert described.facts["size"] == "mirror 66 mm across; from the camera's centre to its rim 85 mm"
    for sensor in ("fisheye", "equirectangular"):
        rig = RigDesign(
            sensor=harness.load_sensor(harness.shipped.find("sensors", sensor)), uncertainty={"focal": 0.01}
        )
        assert np.isfinite(harness.describe_rig(rig, [3.0]).answers[0].error_m)


@pytest.mark.slow
@pytest.mark.browser
def test_the_causes_are_not_broken_within_words_on_a_small_screen(tmp_path):
    page = tmp_path / "design.html"
    harness.describe_rig({"uncertainty": {"rotation_deg": 0.1, "t_direction_deg": 0.1, "alignment_mm": 1.0}}).write(
        page
    )
    with chromium(tmp_path / "profile") as browser:
        visited = visit(browser, page, width=400)
        assert (visited.requests, visited.complaints) == ([], [])
        assert visited.page.evaluate("document.documentElement.scrollWidth") <= 400
        assert visited.page.locator("tbody tr").first.bounding_box()["height"] < 40  # a line of text and its padding


def test_directions_keep_off_the_baseline():
    rig = RigDesign(azimuth_deg=30.0)
    angles = np.degrees(angle_between(directions_of(rig), rig.believed.motion.t_v1))
    assert angles.min() >= 30 - 1e-9
    assert angles.max() <= 150 + 1e-9


@pytest.mark.slow
def test_command(tmp_path, capsys):
    rig = tmp_path / "rig.toml"
    rig.write_text('baseline_m = 0.4\n[uncertainty]\nrotation_deg = 0.02\n[sensor]\nfile = "mirror"\n')
    page = tmp_path / "page.html"
    assert main(["design", str(rig), "--out", str(page), "--at", "2", "5"]) == 0
    printed = capsys.readouterr().out
    assert "68 % of range errors are within (mm)" in printed
    errors = printed[: printed.index("one standard deviation of the position")].splitlines()
    assert "rotation" in errors[-2]
    assert "What to expect of a rig" in page.read_text()
    assert main(["design", str(rig), "--accuracy", "0.02@3", "--most", "2"]) == 0
    assert "68 % within 20 mm at 3 m: the cheapest rigs" in capsys.readouterr().out
    assert main(["design", str(rig), "--accuracy", "0.0001@8", "--width", "640"]) == 1
    assert "no rig reaches 0.1 mm at 8 m" in capsys.readouterr().out
    with pytest.raises(SystemExit, match="2"):
        main(["design", str(rig), "--accuracy", "0.02"])
    assert "must be like 0.03@4" in capsys.readouterr().err
    rig.write_text("baseline = 0.4\n")
    assert main(["design", str(rig)]) == 2
    assert "rig.toml: baseline: unknown key" in capsys.readouterr().err
