"""Localisation errors of a run's new images over seeds, and the number of real images that synthesised ones replace."""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from harness.display import listed
from harness.evaluation.statistics import between, mean_with_interval, resampled
from harness.geometry.angles import Array
from harness.pipeline.localise import PAIRS, SINGLES, SYNTHESISED, WAYS
from harness.runs.experiment import Planned
from harness.runs.methods import MethodName, in_words

FIGURES = ("mean_m", "median_m", "nll")
APPEARANCES = {"pca": "PCA of panoramas", "vlad": "VLAD of dense descriptors"}
"""Names of the descriptors in words."""
WAYS_IN_WORDS = {
    "pairs": "pairs",
    "synthesised": "pairs and views made of them",
    "true ranges": "pairs and views made with true ranges",
    "singles": "single images",
}


def localisations_of(done: Iterable[tuple[Planned, dict[str, Any]]]) -> list[dict[str, Any]]:
    """The `localisation` of `summary.json`: for each method, condition and descriptor, means over seeds.

    Parameters
    ----------
    done
        Trials and what `row.row_of` made of them; those without such a test are left out.

    Returns
    -------
    list of dict
        `matcher`, `subpixel`, `condition`, `appearance`, `seeds`; `errors`, a table for each way and number of `images`
        with `mean_m`, `median_m` and `nll`, means over seeds with 95 % intervals by bootstrap (`_ci95`); and `gains`, a
        table for each number of `images`: the mean error with the views that were made over that without
        (`error_ratio`), how many single images have that error (`worth`) and how many that of the pairs alone
        (`pairs_worth`), and the first over the second (`replaced`), with their intervals. Where one of the first two is
        at an end of the numbers that were tried, its `_bound` is `at most` or `at least`, and nothing is `replaced`:
        None.
    """
    groups: dict[tuple[str, str, str, str], list[dict[tuple[str, int], dict[str, Any]]]] = {}
    for planned, payload in done:
        figures = payload.get("localisation") or ()
        for appearance in dict.fromkeys(each["appearance"] for each in figures):
            mine = {(each["way"], each["images"]): each for each in figures if each["appearance"] == appearance}
            groups.setdefault((*planned.method, planned.condition, appearance), []).append(mine)
    return [_entry(*key, seeds) for key, seeds in groups.items()]


def localisations_conclusions(entries: list[dict[str, Any]], names: Mapping[MethodName, str]) -> list[str]:
    """Sentences on how many real images each method's synthesised views replace, by descriptor; none from one seed.

    Parameters
    ----------
    entries
        The entries of `localisations_of`; the sentences are about those of the first condition.
    names
        The names of methods.
    """
    mine = [each for each in entries if each["condition"] == entries[0]["condition"] and each["seeds"] > 1]
    return [_sentence(each, in_words((each["matcher"], each["subpixel"]), names)) for each in mine if each["gains"]]


def _sentence(entry: dict[str, Any], method: str) -> str:
    """An answer for each number of images: smaller or larger beyond doubt, or not certain."""
    start = f"{APPEARANCES[entry['appearance']]}, ranges of {method}: "
    sure = [each for each in entry["gains"] if each["error_ratio_ci95"][1] < 1]
    if not sure:
        worse = [each for each in entry["gains"] if each["error_ratio_ci95"][0] > 1]
        harm = "; they make the error larger with " + _numbers(worse) if worse else ""
        return f"{start}views made of pairs replace no real images that these seeds show{harm}."
    parts = [f"{_with_ends(each, 'error_ratio', '.2f')} with {each['images']}" for each in sure]
    uncertain = [each for each in entry["gains"] if each not in sure]
    unsure = f"; with {_numbers(uncertain)} that is not certain" if uncertain else ""
    last = sure[-1]
    return (
        f"{start}of the localisation error that pairs have, views made of them leave {listed(parts)} real images"
        f"{unsure}. The {last['images']} are as good as {_with_ends(last, 'worth', '.0f')} single images with the "
        f"views, and as {_with_ends(last, 'pairs_worth', '.0f')} without."
    )


def _numbers(gains: list[dict[str, Any]]) -> str:
    return listed([str(each["images"]) for each in gains])


def _with_ends(gain: dict[str, Any], name: str, form: str) -> str:
    low, high = gain[f"{name}_ci95"]
    bound = gain.get(f"{name}_bound", "")
    return f"{bound} {gain[name]:{form}} [{low:{form}}, {high:{form}}]".lstrip()


def _entry(
    matcher: str, subpixel: str, condition: str, appearance: str, seeds: list[dict[tuple[str, int], dict[str, Any]]]
) -> dict[str, Any]:
    names = [key for key in seeds[0] if all(key in each for each in seeds)]
    errors = []
    for way, images in sorted(names, key=lambda key: (WAYS.index(key[0]), key[1])):
        row: dict[str, Any] = {"way": way, "images": images}
        for name in FIGURES:
            mean, ends = mean_with_interval(np.array([each[way, images][name] for each in seeds]))
            row |= {name: mean, f"{name}_ci95": ends}
        errors.append(row)
    means = {key: np.array([each[key]["mean_m"] for each in seeds]) for key in names}
    return {
        "matcher": matcher,
        "subpixel": subpixel,
        "condition": condition,
        "appearance": appearance,
        "seeds": len(seeds),
        "errors": errors,
        "gains": _gains(means, len(seeds)),
    }


def _gains(means: dict[tuple[str, int], Array], seeds: int) -> list[dict[str, Any]]:
    """The gains from synthesised views for each number of real images; see `localisations_of`."""
    weights = resampled(seeds)
    over = weights.sum(axis=1)
    average = {key: (weights @ values) / over for key, values in means.items()}
    counts = np.array(sorted(images for way, images in average if way == SINGLES), dtype=float)
    if not counts.size:
        return []
    curve = np.stack([average[SINGLES, int(count)] for count in counts], axis=-1)
    gains = []
    for way, images in sorted(average, key=lambda key: key[1]):
        if way != SYNTHESISED:
            continue
        synthesised, alone = average[SYNTHESISED, images], average[PAIRS, images]
        worth, pairs_worth = images_with(synthesised, counts, curve), images_with(alone, counts, curve)
        gain: dict[str, Any] = {"images": images}
        drawn = {"error_ratio": synthesised / alone, "worth": worth, "pairs_worth": pairs_worth}
        bounds = {"worth": _bound(worth[0], counts), "pairs_worth": _bound(pairs_worth[0], counts)}
        if not any(bounds.values()):
            drawn["replaced"] = worth / pairs_worth
        gain |= {f"{name}_bound": bound for name, bound in bounds.items()}
        for name in ("error_ratio", "worth", "pairs_worth", "replaced"):
            gain |= {name: None, f"{name}_ci95": None}
            if name in drawn:
                gain[name] = float(drawn[name][0])
            if name in drawn and seeds > 1:
                low, high = between(drawn[name][1:, None], seeds)
                gain[f"{name}_ci95"] = [float(low[0]), float(high[0])]
        gains.append(gain)
    return gains


def _bound(images: float, counts: Array) -> str:
    """`at most` or `at least`, where a number is that of an end of what was tried; else empty."""
    if images <= counts[0] * (1 + 1e-9):
        return "at most"
    return "at least" if images >= counts[-1] * (1 - 1e-9) else ""


def images_with(error_m: Array, counts: Array, curve_m: Array) -> Array:
    """`[draws]`: how many single images have an error, between those that were tried.

    Errors fall with the number of images; where a mean rises by chance, the smallest so far counts.

    Parameters
    ----------
    error_m
        `[draws]`, metres.
    counts
        `[numbers]`, ascending.
    curve_m
        `[draws, numbers]`: the error of so many single images, metres.
    """
    falling = np.minimum.accumulate(curve_m, axis=1)
    logarithms = [
        np.interp(-np.log(error), -np.log(each), np.log(counts)) for error, each in zip(error_m, falling, strict=True)
    ]
    return np.exp(np.array(logarithms))
