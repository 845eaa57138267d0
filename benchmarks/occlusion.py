"""How slanted windows, semi-global matching and OpenCV's StereoSGBM do where objects hide each other.

On the shipped scenes and on random rooms, without noise and with noise of 10 grey levels. Each line has, over the
pixels that both views see at least 30 degrees from the baseline: density, how much of them can be matched at all (see
`possible`), median error, the share above 1 px (bad-1), the shares above 1, 2 and 3 predicted standard deviations, and
how many of the pixels without texture are matched (blank). Over all pixels that far from the baseline whose point lies
in view 2's field, `hidden` is the precision and recall of "view 2 does not see this". Of StereoSGBM the line is that of
the setting, of the best ones of `experiments/peers.toml`, with the lowest bad-1 on the pair itself.

StereoSGBM's full mode keeps its costs for all disparities, which are those of a half circle where the baseline is
longer than the nearest range searched: up to 8 GB for the rooms 11 and 12, which it gives back.

    pip install 'omnirange[peers]'
    python benchmarks/occlusion.py [--unseen] [--only NAME] [--ours]

Weights and limits were chosen on the shipped scenes and the first rooms; `--unseen` takes others. The number and width
of the windows' steps were chosen with a look at these, too. Rooms 20 to 22 were used for nothing: see
`docs/decisions.md`.
"""

import argparse
import math
from collections.abc import Iterator

import numpy as np
from matching import BEST_OF_PEERS

from harness.datasets.rigs import draw_poses
from harness.datasets.rooms import draw_room
from harness.datasets.specification import DatasetSpec, Furniture, Rig, Surfaces
from harness.geometry.panorama import directions
from harness.matching.interface import MatcherSettings, Matches, Reason
from harness.matching.semi_global.match import SemiGlobal
from harness.matching.slanted.settings import Slanted
from harness.pipeline.specification import Noise, Rendering, SecondView, Trial
from harness.pipeline.trial import Outcome, run_trial
from harness.simulation.scene import load_scene

SHIPPED = ("box", "corridor", "room", "poles")
RIG = Rig(baseline_m=(0.3, 0.6), turn_deg=0.0, tilt_deg=0.0, sway_deg=0.0, clearance_m=0.5)
ROOMS = {
    "furniture": DatasetSpec(name="furniture", rig=RIG),
    "curved": DatasetSpec(
        name="curved", rig=RIG, furniture=Furniture(boxes=(0, 2), tables=(0, 0), curved=(3, 5), poles=(1, 3))
    ),
    "blank": DatasetSpec(name="blank", rig=RIG, surfaces=Surfaces(textureless=4.0)),
}
"""What random rooms are drawn from: furniture, curved bodies and poles, and blank walls."""
TUNED, UNSEEN = (0, 1), (10, 11, 12)
"""Numbers of the rooms of each kind."""
NOISE = (0.0, 10.0)
EDGE_ON = 0.05
"""A pixel that view 2 sees on less than this part of its area is seen edge-on. In the room that is 1e-4 or 0.3 and
more: two pillars have sides in whose planes viewpoint 2 lies, to 0.01 degrees."""


def trials(*, unseen: bool) -> Iterator[tuple[str, Trial]]:
    """Every pair of views, without a matcher of its own yet."""
    if not unseen:
        for name in SHIPPED:
            yield name, Trial(scene=load_scene(name))
    for name, spec in ROOMS.items():
        for number in UNSEEN if unseen else TUNED:
            room = draw_room(spec, number)
            first, second = draw_poses(spec, room, number, 0)
            x, y, z = np.subtract(second.position_m, first.position_m).tolist()
            view_2 = SecondView(
                baseline_m=math.hypot(x, y, z),
                azimuth_deg=math.degrees(math.atan2(y, x)),
                elevation_deg=math.degrees(math.atan2(z, math.hypot(x, y))),
                yaw_deg=first.yaw_deg,
            )
            limits = Slanted(d_min_m=0.5, d_max_m=15.0)
            yield (
                f"{name} {number}",
                Trial(scene=room.scene(), view_1=first, view_2=view_2, matching=limits, render=Rendering(samples=4)),
            )


def limited(matcher: MatcherSettings, trial: Trial) -> MatcherSettings:
    """The matcher with the limits of the trial's search."""
    return matcher.model_copy(update={"d_min_m": trial.matching.d_min_m, "d_max_m": trial.matching.d_max_m})


def figures(outcome: Outcome, matches: Matches) -> dict[str, float]:
    """The figures of a line; see above."""
    expected, truth = outcome.reference, outcome.truth
    error = (matches.alpha_2 - expected.alpha_2)[expected.domain]
    matched = np.isfinite(error)
    off = np.abs(error[matched]) / outcome.trial.panorama.phi_pitch
    z = np.full(off.size, np.nan)
    if matches.sigma_alpha_2 is not None:
        z = np.abs(error[matched]) / matches.sigma_alpha_2[expected.domain][matched]
    blank = truth.textureless[expected.domain]
    looked_at = expected.sideways & np.isfinite(truth.range_m) & truth.in_field_2
    hidden, said = looked_at & ~truth.unoccluded, looked_at & (matches.reasons == Reason.OCCLUDED)
    return {
        "density": float(matched.mean()),
        "possible": float(possible(outcome)[expected.domain].mean()),
        "median": float(np.median(off)),
        "bad_1": float(np.mean(off > 1)),
        **{f"z{k}": float(np.mean(z > k)) for k in (1, 2, 3)},
        "blank": float(np.mean(matched[blank])) if blank.any() else math.nan,
        "blank_share": float(blank.mean()),
        "precision": share(hidden & said, said),
        "recall": share(hidden & said, hidden),
    }


def possible(outcome: Outcome) -> np.ndarray:
    """Pixels that a matcher can match: with texture, no nearer than the search, and not seen edge-on by view 2.

    The solid angle of a piece of surface is its area times the cosine of its slant over its distance squared.
    """
    truth, trial, t = outcome.truth, outcome.trial, outcome.pair.t_v1
    x, normal = directions(outcome.pair.grid), truth.normal @ trial.poses[0].R_world_from_view
    from_2 = x * truth.range_m[..., None] - t
    range_2 = np.linalg.norm(from_2, axis=-1)
    slant_1, slant_2 = np.sum(normal * x, axis=-1), np.sum(normal * from_2, axis=-1) / range_2
    area = (slant_2 / range_2**2) / (slant_1 / truth.range_m**2)
    return (area >= EDGE_ON) & (truth.range_m >= trial.matching.d_min_m) & ~truth.textureless


def share(part: np.ndarray, whole: np.ndarray) -> float:
    """How much of the whole is part of it; NaN where there is none."""
    return float(np.count_nonzero(part) / np.count_nonzero(whole)) if whole.any() else math.nan


HEADING = (
    f"{'':32} {'density':>8} {'of':>6} {'median':>7} {'bad-1':>7}"
    f" {'z>1':>6} {'z>2':>6} {'z>3':>6} {'blank':>12} {'hidden':>12}"
)


def line(name: str, f: dict[str, float]) -> str:
    return (
        f"{name:32} {100 * f['density']:8.2f} {100 * f['possible']:6.1f} {f['median']:7.4f} {100 * f['bad_1']:7.3f}"
        + "".join(f" {100 * f[f'z{k}']:6.2f}" for k in (1, 2, 3))
        + f" {100 * f['blank']:5.0f} /{100 * f['blank_share']:4.1f}"
        + f" {100 * f['precision']:5.0f} {100 * f['recall']:5.0f}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--unseen", action="store_true", help="rooms that no weight or limit was chosen on")
    parser.add_argument("--only", default="", help="scenes whose names begin so")
    parser.add_argument("--ours", action="store_true", help="slanted windows alone")
    arguments = parser.parse_args()
    print(HEADING)
    for name, trial in trials(unseen=arguments.unseen):
        if not name.startswith(arguments.only):
            continue
        for sigma_grey in NOISE:
            slanted = limited(Slanted(), trial)
            outcome = run_trial(trial.model_copy(update={"noise": Noise(sigma_grey=sigma_grey), "matching": slanted}))
            title = f"{name}, noise {sigma_grey:g}"
            print(line(f"{title:22} slanted", figures(outcome, outcome.matches)), flush=True)
            if arguments.ours:
                continue
            sgm = limited(SemiGlobal(), trial).match(outcome.pair)
            print(line(f"{'':22} sgm", figures(outcome, sgm)))
            peers = [figures(outcome, limited(each, trial).match(outcome.pair)) for each in BEST_OF_PEERS]
            print(line(f"{'':22} SGBM", min(peers, key=lambda each: each["bad_1"])), flush=True)


if __name__ == "__main__":
    main()
