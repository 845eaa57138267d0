"""Descriptors, the probability over places, and what made views are worth, against cases worked out by hand."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from harness.errors import InputError
from harness.localisation.appearance import (
    Pca,
    Vlad,
    local_descriptors,
    magnitudes,
    train_pca,
    train_vlad,
)
from harness.localisation.places import Places, learn
from harness.localisation.settings import Localisation
from harness.pipeline.localise import _places
from harness.pipeline.specification import Trial
from harness.runs.localisations import images_with, localisations_conclusions, localisations_of
from harness.simulation.noise import generator
from harness.spec import parse

WALLS = {"kind": "box", "name": "walls", "size_m": [4, 3, 3], "inward": True, "texture": {"kind": "grey", "value": 100}}
BLOCK = {"kind": "box", "name": "block", "size_m": [1.0, 1.0, 2.0], "position_m": [0.5, 0.0, 0.0],
         "texture": {"kind": "grey", "value": 20}}  # fmt: skip


def panoramas(count, seed=0, shape=(30, 64)):
    """Smooth ones: each a few waves around, so that local descriptors differ."""
    rng = np.random.default_rng(seed)
    phi, z = np.arange(shape[1]) * 2 * np.pi / shape[1], np.arange(shape[0])[:, None]
    made = []
    for _ in range(count):
        waves = [
            rng.uniform(5, 20) * np.cos(k * phi + rng.uniform(0, 6) + z * rng.uniform(-0.3, 0.3)) for k in range(1, 7)
        ]
        made.append(120 + sum(waves))
    return made


# --- Descriptors --------------------------------------------------------------------------------------------------


@settings(deadline=None, max_examples=10)
@given(turn=st.integers(0, 63), gain=st.floats(0.5, 2), offset=st.floats(-50, 50))
def test_a_turn_and_an_exposure_change_no_magnitude(turn, gain, offset):
    (image,) = panoramas(1)
    other = gain * np.roll(image, turn, axis=1) + offset
    assert magnitudes([other]) == pytest.approx(magnitudes([image]), abs=1e-9)


@settings(deadline=None, max_examples=3)
@given(steps=st.integers(0, 15), gain=st.floats(0.5, 2))
def test_a_turn_by_the_lattice_changes_no_vlad(steps, gain):
    """Descriptors are 4 columns apart: a turn by that much only numbers them anew."""
    images = panoramas(3)
    vlad = train_vlad([local_descriptors(each) for each in images], 5, np.random.default_rng(1))
    first = vlad.describe([local_descriptors(images[0])])
    other = vlad.describe([local_descriptors(gain * np.roll(images[0], 4 * steps, axis=1))])
    assert other == pytest.approx(first, abs=1e-6)  # rounding may move a descriptor between two words as near
    assert np.linalg.norm(first) == pytest.approx(1)


def test_a_turn_between_the_lattice_changes_less_than_another_image():
    images = panoramas(3)
    locals_of = [local_descriptors(each) for each in (*images, np.roll(images[0], 18, axis=1))]
    first, second, third, turned = train_vlad(locals_of[:3], 5, np.random.default_rng(1)).describe(locals_of)
    apart = [np.linalg.norm(first - each) for each in (turned, second, third)]
    assert apart[0] < 0.7 * min(apart[1:])


def test_vlad_is_a_sum_by_hand():
    """Two rows of three descriptors, three bands of which one is empty, two words."""
    words = np.array([[0.0, 0.0], [1.0, 1.0]])
    local = np.array([[[0.1, 0.0], [0.0, 0.2], [0.9, 1.0]], [[1.0, 1.0], [1.0, 0.5], [0.3, 0.0]]])
    expected = np.zeros((6, 2))
    expected[0] = np.array([0.1, 0.2])  # band 0, word 0
    expected[1] = np.array([-0.1, 0.0])
    expected[2] = np.array([0.3, 0.0])  # band 1: rows are spread over the bands from the top
    expected[3] = np.array([0.0, -0.5])
    norms = np.linalg.norm(expected, axis=1, keepdims=True)
    expected = np.divide(expected, norms, out=np.zeros_like(expected), where=norms > 0).ravel()
    assert Vlad(words).describe([local])[0] == pytest.approx(expected / 2)  # four sums of unit length


def test_local_descriptors_have_unit_length():
    (image,) = panoramas(1)
    assert np.linalg.norm(local_descriptors(image), axis=-1) == pytest.approx(1)
    plain = local_descriptors(np.full((30, 64), 7.0))
    assert plain == pytest.approx(np.full(plain.shape, plain[0, 0, 0]))  # of nothing, all alike


def test_all_components_keep_all_distances():
    images = panoramas(6)
    features = magnitudes(images)
    described = train_pca(images, 20).describe(images)
    assert described.shape == (6, 5)  # six points span five dimensions
    for i in range(6):
        for j in range(i):
            assert np.linalg.norm(described[i] - described[j]) == pytest.approx(
                np.linalg.norm(features[i] - features[j])
            )


def test_images_that_are_all_one_are_described():
    (image,) = panoramas(1)
    assert train_pca([image, image], 4).describe([image]) == pytest.approx(0, abs=1e-9)
    assert isinstance(train_pca([image], 4), Pca)
    assert np.isfinite(train_vlad([local_descriptors(image)], 200, np.random.default_rng(0)).words).all()


# --- Places -------------------------------------------------------------------------------------------------------


def lattice(side=6):
    x, y = np.meshgrid(np.linspace(0, 5, side), np.linspace(0, 5, side))
    return np.stack([x.ravel(), y.ravel()], axis=-1)


def test_where_descriptors_are_places_the_place_is_found():
    """The descriptor is the place, turned and stretched: new images are placed within half the spacing of 1 m."""
    at = lattice()
    stretch = np.array([[2.0, 1.0, 0.0], [-1.0, 2.0, 0.5]])
    places = learn(at, at @ stretch, np.arange(36), np.ones(36, bool), 25.0)
    new = np.array([[1.4, 2.2], [3.5, 0.6], [2.0, 2.0]])
    error = np.linalg.norm(places.estimate(new @ stretch) - new, axis=1)
    assert error.max() < 0.5
    assert places.weights(new @ stretch).sum(axis=1) == pytest.approx(1)
    there, elsewhere = places.density(new @ stretch, new), places.density(new @ stretch, np.roll(new, 1, axis=0))
    assert (there > 1.3 * elsewhere).all()


def test_a_density_is_one_over_the_plane_and_the_area():
    places = Places(np.array([[1.0, 2.0], [2.5, 2.0]]), np.array([[0.0], [1.0]]), 0.5, 0.3, 16.0)
    x, y = np.meshgrid(np.arange(0.025, 4, 0.05), np.arange(0.025, 4, 0.05))
    at = np.stack([x.ravel(), y.ravel()], axis=-1)
    density = places.density(np.full((len(at), 1), 0.4), at)
    assert density.sum() * 0.05**2 == pytest.approx(1, abs=2e-3)  # what the kernels have beyond 3 sigma


def test_images_of_one_pair_do_not_tell_how_far_a_descriptor_reaches():
    """Partners 0.1 m apart with nearly one descriptor: left to themselves, they would make the narrowest kernels."""
    rng = np.random.default_rng(3)
    firsts = rng.uniform(0, 5, (12, 2))
    at = np.repeat(firsts, 2, axis=0) + np.tile([[0.0, 0.0], [0.1, 0.0]], (12, 1))
    described, group = at + 0.01 * rng.standard_normal(at.shape), np.repeat(np.arange(12), 2)
    by_pair = learn(at, described, group, np.ones(24, bool), 25.0)
    by_image = learn(at, described, np.arange(24), np.ones(24, bool), 25.0)
    assert by_image.s_m <= 0.1
    assert by_pair.s_m > 3 * by_image.s_m


def test_a_single_group_has_kernels_all_the_same():
    places = learn(np.zeros((2, 2)), np.zeros((2, 3)), np.zeros(2, int), np.ones(2, bool), 1.0)
    assert places.estimate(np.zeros((1, 3))) == pytest.approx(0)
    assert np.isfinite(places.density(np.zeros((1, 3)), np.zeros((1, 2)))).all()


def test_views_stand_where_there_is_room():
    trial = Trial(
        scene={"name": "s", "objects": [WALLS, BLOCK]},
        view_2={"baseline_m": 0.4},
        localisation={"images": [2], "area_m": [[-2, -1.5], [2, 1.5]]},
    )
    places = np.array(_places(trial, 12, generator(1, "test"), with_pair=True))
    for at in (places, places + np.array([0.4, 0.0])):
        assert (np.abs(at) <= [1.8, 1.3]).all()
        assert (np.maximum(*(np.abs(at - [0.5, 0.0]).T)) > 0.5).all()  # outside of the block
    closed = trial.model_copy(update={"localisation": Localisation(images=(2,), area_m=((0.3, -0.1), (0.6, 0.1)))})
    with pytest.raises(InputError, match=r"localisation.area_m: has hardly any free position"):
        _places(closed, 2, generator(1, "test"), with_pair=False)


# --- What it is worth ---------------------------------------------------------------------------------------------


def test_the_number_of_images_with_an_error_is_read_off_the_curve():
    """With errors 8/n, n is 8/error, however it is interpolated; beyond the ends the last number."""
    counts = np.array([4.0, 8.0, 16.0, 32.0])
    curve = np.tile(8 / counts, (4, 1))
    assert images_with(np.array([1.0, 8 / 11, 5.0, 0.1]), counts, curve) == pytest.approx([8, 11, 4, 32])
    risen = np.array([[2.0, 1.0, 1.5, 0.25]])  # by chance: 1.0 has been reached with 8
    assert 8 <= images_with(np.array([1.0]), counts, risen)[0] <= 16


class Planned:
    method, condition = ("sgm", "v"), "the base trial"


def payload(made, alone=1.0):
    errors = {"pairs": {8: alone}, "synthesised": {8: made}, "singles": {4: 2.0, 8: 1.0, 16: 0.5}}
    return {
        "localisation": [
            {"images": n, "way": way, "appearance": "vlad", "mean_m": value, "median_m": value, "nll": 1.0}
            for way, some in errors.items()
            for n, value in some.items()
        ]
    }


@pytest.mark.parametrize(
    ("made", "said"),
    [
        ((0.7, 0.72, 0.71), "error that pairs have, views made of them leave 0.71 [0.70, 0.72] with 8 real images. "),
        ((0.7, 0.72, 0.71), "The 8 are as good as 11 [11, 11] single images with the views, and as 8 [8, 8] without."),
        ((0.4, 0.42, 0.41), "as good as at least 16 [16, 16] single images"),
        ((0.7, 1.4, 1.0), "replace no real images that these seeds show."),
        ((1.2, 1.3, 1.25), "replace no real images that these seeds show; they make the error larger with 8."),
    ],
)  # fmt: skip
def test_no_more_is_concluded_than_intervals_allow(made, said):
    entries = localisations_of([(Planned, payload(each)) for each in made])
    (sentence,) = localisations_conclusions(entries, {})
    assert said in sentence


def test_what_is_summed_up_is_the_mean_over_seeds():
    (entry,) = localisations_of([(Planned, payload(each)) for each in (0.6, 0.8)])
    (gain,) = entry["gains"]
    assert gain["error_ratio"] == pytest.approx(0.7)
    assert gain["worth"] == pytest.approx(8 * 2 ** (np.log(0.7) / np.log(0.5)))
    assert gain["replaced"] == pytest.approx(gain["worth"] / 8)
    assert [(each["way"], each["images"]) for each in entry["errors"]] == [
        ("pairs", 8), ("synthesised", 8), ("singles", 4), ("singles", 8), ("singles", 16),
    ]  # fmt: skip


def test_beyond_what_was_tried_nothing_is_replaced():
    for made, alone, bounds in ((0.4, 1.0, ("at least", "")), (1.5, 2.5, ("", "at most"))):
        (entry,) = localisations_of([(Planned, payload(made, alone)) for _ in range(2)])
        (gain,) = entry["gains"]
        assert (gain["worth_bound"], gain["pairs_worth_bound"]) == bounds
        assert gain["replaced"] is gain["replaced_ci95"] is None


def test_of_one_seed_nothing_is_concluded():
    (entry,) = localisations_of([(Planned, payload(0.5))])
    assert entry["gains"][0]["error_ratio_ci95"] is None
    assert localisations_conclusions([entry], {}) == []


def test_without_it_a_trial_keeps_its_key():
    plain = Trial(scene={"name": "s", "objects": [WALLS]})
    assert plain.key == plain.model_copy(update={"localisation": Localisation(queries=40)}).key
    assert plain.key != plain.model_copy(update={"localisation": Localisation(images=(4,))}).key


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"images": [3]}, "images[0]"),
        ({"images": [4, 4]}, "each number may occur only once"),
        ({"area_m": [[0, 0], [0, 1]]}, "these are on one line"),
    ],
)
def test_what_cannot_be_is_refused(change, said):
    with pytest.raises(InputError) as refused:
        parse(Localisation, change)
    assert said in str(refused.value)
