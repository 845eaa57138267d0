"""The order in which trials are run, so that shared results are computed once, and an estimate of the time."""

from collections.abc import Hashable, Iterable, Sequence
from dataclasses import dataclass

from harness.pipeline.specification import Trial
from harness.pipeline.stages import StageKeys, setup_of
from harness.pipeline.trial import RENDER, sharing_keys
from harness.runs.experiment import Planned

BATCH_S = 1.0
"""Work that a worker gets at a time: long enough to hide the overhead, short enough for a kill to cost little."""


@dataclass(frozen=True)
class Plan:
    """Trials in an order in which neighbours share the most."""

    trials: tuple[Planned, ...]
    seconds: tuple[float, ...]
    """Seconds of each trial after the one before it, on one thread; a rough guess, from the sizes of images and the
    matcher. A matcher whose time is not known counts for nothing."""
    new_geometry: tuple[bool, ...]
    """Whether a trial has other renders than the one before it."""

    @property
    def total_s(self) -> float:
        """Seconds of all trials, on one thread."""
        return sum(self.seconds)

    @property
    def unknown(self) -> list[str]:
        """The matchers whose time is not known."""
        kinds = (each.method[0] for each in self.trials if each.trial.matching.match_seconds(1.0, 1.0) is None)
        return list(dict.fromkeys(kinds))

    @property
    def renders(self) -> int:
        """Distinct images to render."""
        return len({key for each in self.trials for key in _render_keys(each.trial)})

    def batches(self, batch_s: float = BATCH_S) -> list[tuple[Planned, ...]]:
        """The trials in runs of about `batch_s` seconds, in order; single ones when it is 0.

        Trials of one geometry stay together up to three times as long: each worker that gets some must render it.
        """
        batches: list[list[Planned]] = []
        filled = 0.0
        for trial, cost, is_new in zip(self.trials, self.seconds, self.new_geometry, strict=True):
            if not batches or filled + cost > (batch_s if is_new else 3 * batch_s):
                batches.append([])
                filled = 0.0
            batches[-1].append(trial)
            filled += cost
        return [tuple(batch) for batch in batches]


def plan(trials: Sequence[Planned]) -> Plan:
    """Order trials by the results that they share, in the order of the pipeline; otherwise as they come."""
    keys = [sharing_keys(each.trial) for each in trials]
    ranks: list[dict[Hashable, int]] = []
    for stage in keys[0] if keys else ():
        first: dict[Hashable, int] = {}
        for key in keys:
            first.setdefault(key[stage], len(first))
        ranks.append(first)
    ranks_of_trial = [
        tuple(rank[key] for rank, key in zip(ranks, each.values(), strict=True)) for each in keys
    ]  # trials that share a stage share its rank
    order = sorted(range(len(trials)), key=lambda i: (ranks_of_trial[i], i))
    done: dict[str, Hashable] = {}
    seconds, new_geometry = [], []
    for i in order:
        new = {stage for stage, key in keys[i].items() if done.get(stage) != key}
        seconds.append(_seconds(trials[i].trial, new))
        new_geometry.append("render" in new)
        done = keys[i]
    return Plan(tuple(trials[i] for i in order), tuple(seconds), tuple(new_geometry))


def _seconds(trial: Trial, new: Iterable[str]) -> float:
    """A guess at a trial's time, given the stages that it does not share with the one before: one thread of 2024."""
    images = [each.camera.width_px * each.camera.height_px / 1e6 for each in trial.sensors]
    image, panorama = sum(images), trial.panorama.width_px * trial.panorama.height_px / 1e6
    samples_a_curve = trial.panorama.width_px / 720 / trial.matching.sampled(trial.true_motion.t_v1)[1]
    traced = 1 if all(each.is_central for each in trial.sensors) else 6  # every sample of a misaligned mirror
    stages = {
        "render": image * (0.08 + 0.006 * trial.render.samples * traced) + panorama * 0.75,
        "noise": image * 0.02,
        "pair": panorama * 0.3 + (_MOTION_S if trial.motion.source == "estimated" else 0.0),
        "match": trial.matching.match_seconds(images[0], panorama * samples_a_curve) or 0.0,
    }
    scoring = trial.scoring
    scored = 0.6 * panorama * (1 + scoring.confidence)
    scored += panorama * (2.0 * scoring.budget + 2.0 * bool(scoring.bound or scoring.sample_px))
    views = len(trial.novel_views.distances_m)
    scored += views * (panorama * _VIEW_S_A_MP + images[0] * (0.08 + 0.006 * trial.render.samples))
    scored += _SCAN_S * bool(trial.scan.bearings)
    own = sum(stages.values())  # of a pair that shares nothing
    scored += (own + _SCAN_S) * len(trial.map.stations())
    local = trial.localisation
    if local.most:
        made = local.most // 2 * local.synthesised * 2  # with either ranges
        scored += own * (local.most * 1.5 + local.queries / 2) + made * (panorama * _VIEW_S_A_MP + _DESCRIBED_S)
    return scored + sum(stages.get(stage, 0.0) for stage in new)


_VIEW_S_A_MP = 8.0
"""Seconds that it takes to warp a new view, and its ceiling, for a megapixel of the panorama."""
_DESCRIBED_S = 0.05
"""Seconds that it takes to describe an image for localisation."""
_SCAN_S = 0.3
"""Seconds that a range profile and the true one take."""
_MOTION_S = 6.0
"""Seconds that it takes to estimate a motion from two images."""


def _render_keys(trial: Trial) -> list[Hashable]:
    keys = StageKeys(setup_of(trial))
    return [keys.of(RENDER, view) for view in RENDER.views]
