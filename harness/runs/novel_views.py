"""The quality of views warped from a run's ranges, against their distance, over seeds."""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from harness.display import listed
from harness.evaluation.statistics import mean_with_interval
from harness.runs.experiment import Planned
from harness.runs.methods import MethodName, in_words

_VIEWS = ("warped", "ceiling", "floor")


def novel_views_of(done: Iterable[tuple[Planned, dict[str, Any]]]) -> list[dict[str, Any]]:
    """The `novel_views` of `summary.json`: for each method, condition and distance, means over seeds.

    Parameters
    ----------
    done
        Trials and what `row.row_of` made of them; those without such views are left out.

    Returns
    -------
    list of dict
        `matcher`, `subpixel`, `condition`, `distance_m`, `seeds`; `psnr_db` and `psnr_ci95_db` (bootstrap over seeds)
        of the `warped` view, the `ceiling` (true ranges) and the `floor` (nearest image), tables by these names;
        `gain_db`, warped less floor, with `gain_ci95_db`; and of the warped view `ws_psnr_db`, `ssim`, `holes`,
        `disoccluded` (a share) and `disoccluded_rmse_grey`.
    """
    groups: dict[tuple[str, str, str, float], list[dict[str, Any]]] = {}
    for planned, payload in done:
        for view in payload.get("novel_views") or ():
            groups.setdefault((*planned.method, planned.condition, view["distance_m"]), []).append(view)
    return [_entry(*key, views) for key, views in sorted(groups.items(), key=lambda each: each[0])]


def views_conclusions(entries: list[dict[str, Any]], names: Mapping[MethodName, str]) -> list[str]:
    """Sentences on the distances at which each method's warped views beat the nearest image; none from one seed.

    Parameters
    ----------
    entries
        The entries of `novel_views_of`; the sentences are about those of the first condition.
    names
        The names of methods.
    """
    mine = [each for each in entries if each["condition"] == entries[0]["condition"] and each["gain_ci95_db"]]
    methods = dict.fromkeys((each["matcher"], each["subpixel"]) for each in mine)
    return [
        _reach_of(in_words(method, names), [each for each in mine if (each["matcher"], each["subpixel"]) == method])
        for method in methods
    ]


def _reach_of(method: str, entries: list[dict[str, Any]]) -> str:
    entries = sorted(entries, key=lambda each: each["distance_m"])
    sure = [each for each in entries if each["gain_ci95_db"][0] > 0]
    if not sure:
        return f"Warped views ({method}) are not certain to be better than the nearest image at any distance."
    least, most = (_gain(pick(sure, key=lambda each: float(each["gain_db"]))) for pick in (min, max))
    unsure = [each for each in entries if each not in sure]
    gains = least if least == most else f"{least} to {most}"
    sentence = f"Warped views ({method}) are {gains} dB better than the nearest image at {_distances(sure, entries)}"
    return f"{sentence}; at {_distances(unsure, entries)} that is not certain." if unsure else f"{sentence}."


def _gain(entry: dict[str, Any]) -> str:
    low, high = entry["gain_ci95_db"]
    return f"{entry['gain_db']:.1f} [{low:.1f}, {high:.1f}]"


def _distances(some: list[dict[str, Any]], entries: list[dict[str, Any]]) -> str:
    """Distances in words, as a range if they are consecutive."""
    names = [f"{each['distance_m']:g}" for each in some]
    start = entries.index(some[0])
    if len(some) > 2 and entries[start : start + len(some)] == some:
        return f"{names[0]} to {names[-1]} m"
    return f"{listed(names)} m"


def _entry(
    matcher: str, subpixel: str, condition: str, distance_m: float, views: list[dict[str, Any]]
) -> dict[str, Any]:
    psnr = {name: np.array([view[name]["psnr_db"] for view in views]) for name in _VIEWS}
    own = {name: [view["warped"][name] for view in views] for name in views[0]["warped"]}
    gain, gain_ends = mean_with_interval(psnr["warped"] - psnr["floor"])
    means = {name: mean_with_interval(values) for name, values in psnr.items()}
    unseen = [each for each in own["disoccluded_rmse_grey"] if each is not None]
    return {
        "matcher": matcher,
        "subpixel": subpixel,
        "condition": condition,
        "distance_m": distance_m,
        "seeds": len(views),
        "psnr_db": {name: mean for name, (mean, _) in means.items()},
        "psnr_ci95_db": {name: ends for name, (_, ends) in means.items()},
        "gain_db": gain,
        "gain_ci95_db": gain_ends,
        **{name: float(np.mean(own[name])) for name in ("ws_psnr_db", "ssim", "holes", "disoccluded")},
        "disoccluded_rmse_grey": float(np.mean(unseen)) if unseen else None,
    }
