"""The chip against EMVA 1288: the photon transfer curve, dark noise, rounding, and the bound that follows from them."""

import numpy as np
import pytest

from harness.camera.sensor import Sensor, pixel_directions
from harness.errors import InputError
from harness.runs.load import load_experiment
from harness.simulation.chip import Chip, captured, expected_grey, grey_variance
from harness.simulation.noise import generator
from harness.spec import parse

SENSOR = Sensor()
KNOWN = pixel_directions(SENSOR)[1]


def levels(chip, grey, sigma_grey=0.0, seed=1):
    """Grey levels of some 150,000 pixels under even light."""
    image = np.full(KNOWN.shape, grey, dtype=np.float32)
    return captured(image, SENSOR, chip, sigma_grey, generator(seed, "shot"), generator(seed, "white"))[KNOWN]


def test_an_ideal_chip_returns_the_image_itself():
    image = np.full(KNOWN.shape, 90, dtype=np.float32)
    assert captured(image, SENSOR, Chip(), 0.0, generator(0), generator(0)) is image
    assert expected_grey(image, Chip()) is image


def test_photon_transfer():
    """Variance is linear in the mean, with the system gain K = 255/10000 as its slope and dark noise at zero."""
    chip = Chip(saturation_e=10_000.0, dark_noise_e=40.0)
    drawn = [levels(chip, grey) for grey in (10, 60, 120, 200)]
    means, variances = [each.mean() for each in drawn], [each.var() for each in drawn]
    slope, intercept = np.polyfit(means, variances, 1)
    # Each variance of 150,000 pixels is known to sqrt(2/150000) = 0.4 %.
    assert slope == pytest.approx(255 / 10_000, rel=0.02)
    assert intercept == pytest.approx((40 * 255 / 10_000) ** 2, rel=0.05)
    assert means == pytest.approx((10, 60, 120, 200), abs=0.03)


@pytest.mark.parametrize(
    "chip",
    [
        Chip(saturation_e=10_000.0),
        Chip(saturation_e=10_000.0, dark_noise_e=30.0, bits=12),
        Chip(saturation_e=100_000.0, bits=8),
        Chip(saturation_e=5_000.0, dark_noise_e=30.0, gamma=2.2, bits=10),
        Chip(bits=8),
    ],
)
@pytest.mark.parametrize("grey", [40.3, 181.7])
def test_the_variance_is_that_of_draws(chip, grey):
    sigma_grey = 0.7
    drawn = levels(chip, grey, sigma_grey)
    light = np.full((1, 1), grey, dtype=np.float32)
    # 0.4 % of sampling; rounding's q²/12 is exact to some 1e-3 once noise spans half a step; gamma is taken to first
    # order over a noise of at most a tenth of the level.
    assert drawn.var() == pytest.approx(grey_variance(light, chip, sigma_grey)[0, 0], rel=0.02)
    assert drawn.mean() == pytest.approx(float(expected_grey(light, chip)[0, 0]), abs=0.05)


def test_bits_are_levels_and_white_is_the_end():
    drawn = levels(Chip(saturation_e=1_000.0, bits=8), 250)
    assert drawn.max() == 255
    assert np.array_equal(drawn, np.rint(drawn))
    drawn = levels(Chip(bits=4), 100.0, sigma_grey=30.0)
    assert len(np.unique(drawn)) <= 16
    assert np.unique(drawn / 17) == pytest.approx(np.unique(np.rint(drawn / 17)), abs=1e-5)


def test_what_the_sensor_does_not_see_stays_black():
    image = np.where(KNOWN, np.float32(90), np.float32(0))
    chip = Chip(saturation_e=500.0, bits=8, jpeg_quality=50)
    result = captured(image, SENSOR, chip, 5.0, generator(0), generator(1))
    assert not result[~KNOWN].any()


def test_jpeg_keeps_what_its_quality_keeps():
    image = np.where(KNOWN, np.random.default_rng(3).uniform(0, 255, KNOWN.shape), 0).astype(np.float32)
    best, worst = (
        captured(image, SENSOR, Chip(bits=8, jpeg_quality=q), 0.0, generator(0), generator(0)) for q in (100, 20)
    )
    off = [np.sqrt(np.mean((each - image)[KNOWN] ** 2)) for each in (best, worst)]
    # Quality 100 rounds coefficients to whole numbers: 0.3 to 0.6 grey levels beside rounding itself.
    assert off[0] < 1
    assert off[1] > 10


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"dark_noise_e": 3.0}, "dark_noise_e needs saturation_e"),
        ({"jpeg_quality": 70}, "jpeg_quality needs bits = 8, as JPEG has no other depth; found bits = 0"),
        ({"bits": 17}, "bits"),
        ({"gamma": 0.0}, "gamma"),
    ],
)
def test_what_is_refused(table, message):
    with pytest.raises(InputError, match=message):
        parse(Chip, table, file="e.toml")


def test_keys_of_trials_stay_without_chip_and_lens_and_change_with_them():
    plain = load_experiment("smoke").trial
    assert "chip" not in plain.model_fields_set
    keys = {
        load_experiment("smoke", sets=sets).trial.key
        for sets in ([], ["chip.bits=0"], ["optics.motion_deg=0"], ["optics_2.defocus_px=0"])
    }
    assert keys == {plain.key}
    keys = {
        load_experiment("smoke", sets=[each]).trial.key
        for each in ("chip.bits=8", "optics.defocus_px=1", "optics_2.defocus_px=1", "chip.saturation_e=5000")
    }
    assert len(keys | {plain.key}) == 5


def test_the_second_lens_is_a_copy_of_the_first_where_a_key_changes_it():
    trial = load_experiment("smoke", sets=["optics.vignetting=0.2", "optics_2.defocus_px=1.5"]).trial
    first, second = trial.lenses
    assert (first.vignetting, first.defocus_px) == (0.2, 0.0)
    assert (second.vignetting, second.defocus_px) == (0.2, 1.5)
