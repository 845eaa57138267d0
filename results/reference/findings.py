"""The sentences of the README that quote a measured number, made of the files beside this one.

`python results/reference/findings.py` prints those that the README does not have; a test holds the README against
them, so that no number there can be older than its measurement, or say more than its interval.
"""

import json
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent


def findings(folder: Path = HERE) -> list[str]:
    """All sentences, in the order of the README."""
    names = ("paper", "matchers", "budget", "cameras", "law", "law_best")
    files = {name: json.loads((folder / f"{name}.json").read_text()) for name in names}
    return [
        *_claims(files["paper"]["claims"]),
        *_matchers(files["matchers"]),
        *_budget(files["budget"]["budget"]),
        *_cameras(files["cameras"]["cameras"]),
        f"(`omnirange run law`, {files['law']['trials']['done']:,} trials in the box)",
        *_column_windows(files["law"]["law"]),
        *_slanted_windows(files["law_best"]["law"]),
    ]


def _claims(claims: list[dict[str, Any]]) -> list[str]:
    """A line for each claim of the paper."""
    of = {each["id"]: each for each in claims}

    def number(claim: str, name: str, form: str, scale: float = 1.0) -> str:
        measured = of[claim]["numbers"][name]
        value, low, high = (format(scale * each, form) for each in (measured["value"], *measured["ci95"]))
        return f"{value} [{low}, {high}]"

    rounding = {name: number("discretisation", name, ".1f", 1000) for name in ("median_m", "rounding_m")}
    bias = [number("compensation", f"bias_{name}_m", "+.0f", 1000) for name in ("whole", "subpixel")]
    off = {
        part: number("other-rows", f"{part}_bad_1px", form, 100) for part, form in (("floor", ".0f"), ("wall", ".2f"))
    }
    return [
        f"over {claims[0]['seeds']} pairs placed at random in the box",
        _one_line(f"""
            *The discontinuities in the curve are caused by discretization*: {of["discretisation"]["verdict"]}. On walls
            the median error at whole pixels is {rounding["median_m"]} mm, and rounding alone makes
            {rounding["rounding_m"]} mm.
        """),
        _one_line(f"""
            *The sub-pixel method compensates error and bias*: {of["compensation"]["verdict"]}. It leaves
            {number("compensation", "wall_ratio", ".2f")} of the median error on walls. The bias over all pixels is
            {bias[0]} mm before and {bias[1]} mm after: mismatches make it.
        """),
        _one_line(f"""
            *An error of 1 degree costs about 0.3 m* (at 3 m, with a baseline of 0.5 m): {of["one-degree"]["verdict"]}
            at right angles to the baseline. The errors measured on walls are
            {number("one-degree", "measured_over_law", ".3f")} times what the exact law makes of the errors of their
            angles.
        """),
        _one_line(f"""
            *Other rows give similar estimates*: {of["other-rows"]["verdict"]}. On floor and ceiling, where a square
            window covers several disparities, {off["floor"]} % of the estimates are off by more than a pixel, on walls
            {off["wall"]} %.
        """),
    ]


def _matchers(matchers: dict[str, Any]) -> list[str]:
    slanted = {
        (each["scene"], each["noise.sigma_grey"]): each
        for each in matchers["ladder"]
        if each["matching.kind"] == "slanted"
    }
    clean = {scene: slanted[scene, 0] for scene in ("box", "corridor", "room")}
    draws = [each for each in matchers["limit"] if each["matcher"] == "slanted" and each["sigma_grey"]]
    quietest = min(draws, key=lambda each: each["sigma_grey"])
    unbiased = quietest["within_sigma_without_bias"][0]
    over_bound = [each["std_over_bound"] for each in draws]
    one, two = ([each["within_sigma"][k] for each in draws] for k in (0, 1))
    noises = [each["sigma_grey"] for each in draws]
    return [
        _one_line(f"""
            Without noise, slanted windows have a median range error of {1000 * clean["box"]["range_median_abs_m"]:.1f}
            mm on the box. {_share(clean["box"]["bad_1px"])} of their matches are off by more than 1 px there,
            {_share(clean["corridor"]["bad_1px"])} in the corridor, and {_share(clean["room"]["bad_1px"])} in
            the room, where objects occlude each other and the density is {clean["room"]["density"]:.2f}.
        """),
        _one_line(f"""
            Over {draws[0]["seeds"]} draws of noise of {min(noises):g} to {max(noises):g} grey levels on the
            box, their spread is {min(over_bound):.2f} to {max(over_bound):.2f} times the [Cramér-Rao
            bound](docs/bound.md) of their window.
        """),
        _one_line(f"""
            They predict a standard deviation for every match: {_percent(one)} % of the errors lie within one
            (68 % would be right), {_percent(two)} % within two (95 % would be right).
        """),
        _one_line(f"""
            At noise {quietest["sigma_grey"]:g} two faults cancel in that share: the prediction is larger than
            the spread, and each pixel has a bias. With the bias removed, {100 * unbiased:.0f} % lie within one.
        """),
        _one_line(f"""
            At noise 10, over {_draws(matchers, "corridor")["seeds"]} draws, {_within(matchers, "corridor")} of them lie
            within one and two in the corridor and {_within(matchers, "room")} in the room; with the bias removed,
            {_within(matchers, "corridor", "_without_bias")} and {_within(matchers, "room", "_without_bias")}.
        """),
    ]


def _draws(matchers: dict[str, Any], scene: str) -> dict[str, Any]:
    """What many draws of noise make of slanted windows in a scene other than the box."""
    (one,) = (each for each in matchers["limit_elsewhere"][scene] if each["matcher"] == "slanted")
    return one


def _within(matchers: dict[str, Any], scene: str, kind: str = "") -> str:
    """The shares of errors within one and two of the predicted standard deviations."""
    one, two = _draws(matchers, scene)[f"within_sigma{kind}"][:2]
    return f"{100 * one:.0f} and {100 * two:.0f} %"


def _budget(budget: list[dict[str, Any]]) -> list[str]:
    """What a misaligned mirror costs, where the matcher's own errors are what it predicts of them."""
    own = {each["range_m"]: each for each in budget if not each["causes"]}
    told = [
        range_m
        for range_m, each in own.items()
        if each["measured_ci95_m"] and abs(each["over_drawn"] - 1) < _PREDICTED  # of one draw nothing is said
    ]

    def times(case: str) -> str:
        of_case = {each["range_m"]: each["measured_m"] for each in budget if each["case"] == case}
        ratios = [of_case[range_m] / own[range_m]["measured_m"] for range_m in told]
        return f"{min(ratios):.2g} to {max(ratios):.2g}"

    draws = max(each["seeds"] for each in budget)
    return [
        _one_line(f"""
            in the box (`omnirange run budget`, {draws} draws), {min(told):.1f} to {max(told):.1f} m away, errors are
            {times("alignment, calibrated")} times the matcher's own with the best calibration of a central sensor,
            and {times("alignment")} times where the mirror is taken for aligned
        """)
    ]


_PREDICTED = 0.25
"""Nearer and farther than where they are so near their prediction, the matcher's own errors are mostly of edges and
grazing walls, and hide the others."""


def _cameras(cameras: list[dict[str, Any]]) -> list[str]:
    rows = {(each["scene"], each["matcher"], each["surface"], each["sensor"]): each for each in cameras}

    def ratios(surface: str, sensor: str) -> str:
        box, room = (rows[scene, "slanted", surface, sensor] for scene in ("box", "room"))
        return f"{_ratio(box)} in the box and {_ratio(room)} in the room"

    mirrors = [rows[scene, "slanted", "all", "mirror"] for scene in ("box", "room")]
    columns = [each for each in cameras if each["matcher"] == "column"]
    off = max(abs(each["ratio_to_mirror"] - 1) for each in columns)
    densities = [
        abs(each["density"] - rows[each["scene"], each["matcher"], "all", "mirror"]["density"]) for each in cameras
    ]
    return [
        f"over {mirrors[0]['seeds']} seeds that place the rig",
        _one_line(f"""
            With slanted windows the fisheye's median range error is {ratios("all", "fisheye")} times that of the
            mirror ({" and ".join(f"{1000 * each['range_median_abs_m']:.2f}" for each in mirrors)} mm), the
            equirectangular camera's {ratios("all", "equirectangular")}.
        """),
        _one_line(f"""
            On walls these are {ratios("wall", "fisheye")}, and {ratios("wall", "equirectangular")}.
        """),
        _one_line(f"""
            With column-following windows on the panorama the camera matters little: no ratio, on walls or floors,
            is further than {100 * off:.1f} % from 1. Densities differ from the mirror's by at most
            {100 * max(densities):.1f} points.
        """),
    ]


def _ratio(entry: dict[str, Any]) -> str:
    low, high = entry["ratio_to_mirror_ci95"]
    return f"{entry['ratio_to_mirror']:.2f} [{low:.2f}, {high:.2f}]"


def _column_windows(law: dict[str, Any]) -> list[str]:
    whole, parabola = (_fit(law["images"], "wall", step) for step in ("none", "parabola"))
    by_noise = [each for each in law["by_noise"] if (each["surface"], each["subpixel"]) == ("wall", "none")]
    slopes = ", ".join(f"{each['slope']:.2f}" for each in by_noise)
    noises = ", ".join(f"{each['sigma_grey']:g}" for each in by_noise)
    at = min(range(len(whole["by_alpha_1"])), key=lambda i: float(whole["by_alpha_1"][i]["slope"]))
    lowest, refined = (fit["by_alpha_1"][at] for fit in (whole, parabola))
    return [
        _one_line(f"""
            on walls the slope is {_slope(whole)} at whole pixels and {_slope(parabola)} with the parabola: the
            error grows a little more slowly than the law says.
        """),
        _one_line(f"""
            At whole pixels it is {slopes} at noise {noises} grey levels: most of that error is rounding, which
            is constant in angle by construction, so these slopes confirm the geometry, not a property of the
            noise.
        """),
        _one_line(f"""
            The slope dips at {lowest["from_deg"]:g} to {lowest["to_deg"]:g}° from the baseline: {_slope(lowest)} at
            whole pixels, {_slope(refined)} with the parabola. There the second view sees walls beside the rig the most
            foreshortened, and a window covers several disparities, the more the longer the baseline: over ranges of
            more than five baselines it is {_slope(lowest["short"])} and {_slope(refined["short"])}.
        """),
    ]


def _slanted_windows(law: dict[str, Any]) -> list[str]:
    everything = {surface: _fit(law["images"], surface) for surface in ("wall", "floor")}
    limited = {surface: _fit(law["noise_limited"], surface) for surface in ("wall", "floor")}
    product = {surface: _fit(law["noise_limited"], surface, law="bound") for surface in ("wall", "floor")}
    apart = {each["surface"]: each for each in law["law_and_bound"]}
    return [
        _one_line(f"""
            over all cells the slope is {_slope(everything["wall"])} on walls and {_slope(everything["floor"])}
            on floors: without noise the matcher's own systematic errors dominate, and they grow faster than the
            law says.
        """),
        _one_line(f"""
            On the cells where noise makes most of the error it is {_slope(limited["wall"])} and
            {_slope(limited["floor"])} with one constant sigma for all textures, and {_slope(product["wall"], 3)}
            and {_slope(product["floor"], 3)} with the Cramér-Rao bound of each cell's texture in its place.
        """),
        _one_line(f"""
            With a coefficient for each, the law has {_coefficient(apart["wall"], "law")} and the bound
            {_coefficient(apart["wall"], "bound")} on walls, {_coefficient(apart["floor"], "law")} and
            {_coefficient(apart["floor"], "bound")} on floors. The law's coefficients are within
            {_off_one(apart)} % of 1{_but(apart)}; the bound explains only a part of what the texture does.
        """),
    ]


def _one_line(text: str) -> str:
    return " ".join(text.split())


def _fit(fits: list[dict[str, Any]], surface: str, step: str | None = None, law: str = "exact") -> dict[str, Any]:
    return next(
        each for each in fits if each["surface"] == surface and each["law"] == law and step in (None, each["subpixel"])
    )


def _slope(fit: dict[str, Any], digits: int = 2) -> str:
    low, high = fit["slope_ci95"]
    return f"{fit['slope']:.{digits}f} [{low:.{digits}f}, {high:.{digits}f}]"


def _coefficient(fit: dict[str, Any], name: str) -> str:
    low, high = fit[f"{name}_ci95"]
    return f"{fit[name]:.2f} [{low:.2f}, {high:.2f}]"


def _off_one(apart: dict[str, dict[str, Any]]) -> str:
    return f"{max(100 * abs(each['law'] - 1) for each in apart.values()):.0f}"


def _but(apart: dict[str, dict[str, Any]]) -> str:
    """What the intervals add to that."""
    outside = [surface for surface, each in apart.items() if not each["law_ci95"][0] <= 1 <= each["law_ci95"][1]]
    return (
        f", though the intervals exclude 1 on {' and '.join(f'{each}s' for each in sorted(outside, reverse=True))}"
        if outside
        else ""
    )


def _share(value: float) -> str:
    """In per cent, with two significant digits, however small."""
    if not value:
        return "None"
    return f"{float(f'{100 * value:.2g}'):g} %"


def _percent(values: list[float]) -> str:
    low, high = 100 * min(values), 100 * max(values)
    return f"{low:.0f}" if f"{low:.0f}" == f"{high:.0f}" else f"{low:.0f} to {high:.0f}"


def main() -> None:
    """Print the sentences that the README does not have."""
    readme = " ".join((HERE.parents[1] / "README.md").read_text(encoding="utf-8").split())
    sentences = findings()
    missing = [each for each in sentences if each not in readme]
    if missing:
        print(f"README.md does not say {len(missing)} of {len(sentences)} sentences that follow from these numbers:")
    else:
        print(f"README.md says all {len(sentences)} sentences that follow from these numbers")
    print("\n".join(missing), end="\n" if missing else "")


if __name__ == "__main__":
    main()
