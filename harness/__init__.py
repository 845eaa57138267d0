"""omnirange: a simulation-driven evaluation harness for omnidirectional (catadioptric) stereo.

It renders pairs of mirror images with exact ground truth, matches them, and reports how large the errors of the range
are, where they come from, and whether they follow the law that theory predicts. The command line is `omnirange --help`.

A tour
------
Run an experiment, look at its tables, and write its report:

>>> import harness
>>> result = harness.run("smoke", axes={"matching.window_px": [7]}, sets={"seed": 1, "view_2.baseline_m": 0.5})
>>> result
RunResult('smoke', 4 of 4 trials done)
>>> len(result.trials), list(result.summary.index.names)
(4, ['pixels', 'method'])
>>> page = result.report("report.html")

Every trial has its maps, arrays on the first view's panorama:

>>> outcome = result.outcome({"noise.sigma_grey": 4.0, "matching.subpixel": "parabola"})
>>> outcome.range_m.shape, outcome.range_error_m.shape, outcome.sigma_range_m.shape
((50, 180), (50, 180), (50, 180))

Render a view; estimate range from two images, rendered or photographed:

>>> left, right = (harness.render("room", position_m=(x, 0, 1), samples=4) for x in (0, 0.5))
>>> estimate = harness.estimate_range(left.image, right.image, left.sensor, (0.5, 0, 0), matcher="column")
>>> estimate.range_m.shape, estimate.points_m.shape[1]
((200, 720), 3)

What there is
-------------
run, open_results
    An experiment's trials: `RunResult` with `trials`, `summary`, `settings`, `outcome(...)`, `report(...)`.
load_experiment, load_scene, load_sensor
    From shipped names, files or tables: `Experiment`, `Scene`, `Sensor`. A sensor also from another program's
    calibration.
describe_sensor, convert_sensor, load_motion
    What a sensor sees; its calibration in another program's format; the motion between the cameras of a calibration.
render, estimate_range, estimate_sequence, estimate_motion
    `RenderedView`: a mirror image with its range. `RangeEstimate`: range from two images, with a `Verdict` on their
    geometry. `SequenceRange`: from each image with the next. `MotionEstimate`: how two stand to each other, and its
    `Status`.
warp_view
    `NewView`: two images and their ranges as a view from somewhere else.
range_scan, range_map
    `RangeScan`: two images as a robot's range profile, the nearest obstacle for each bearing. `RangeMap`: several of
    these as an occupancy grid.
make_dataset, open_dataset
    `DataSet`: pairs with their truth, each a `DatasetPair`; `check` has a `Finding` for each fault, `score` gives a
    `DatasetScore` of anybody's maps.
calibrate
    A sensor from images of a chessboard: `CalibrationResult`, with standard deviations of its numbers and rays.
describe_rig, find_rigs
    `RigDescription`: what range errors to expect of a rig, by cause; and the rigs that reach an accuracy.
run_trial
    One trial with all that its stages made, an `Outcome`, for `harness.testing.assertions`.
settings
    What every key of an experiment means: a table.
project, unproject, relative_motion
    Directions to pixels and back; the `Motion` between two `Pose`s.
Trial, TrialMaps, Grid, Panorama, Pair, Matches, Reason, Camera, Mirror, Lens, FieldOfView
    The types that these take and return. A matcher of your own takes a `Pair` and returns `Matches`.
InputError
    What is raised when something given is wrong: one line that says where, what, and what would be right.

Angles are radians and lengths metres unless a name says otherwise (`yaw_deg`, `window_px`). Missing is NaN.
Everything is loaded when it is first used: `import harness` takes no time.
"""

import harness.first_moment  # noqa: F401, I001 - before all else: from here on Ctrl-C is answered
from importlib import import_module
from typing import TYPE_CHECKING, Any

from harness.version import __version__

if TYPE_CHECKING:
    from harness.api.calibrating import CalibrationResult, calibrate
    from harness.api.datasets import DataSet, DatasetPair, DatasetScore, make_dataset, open_dataset
    from harness.api.designing import RigDescription, describe_rig, find_rigs
    from harness.api.loading import load_experiment, load_motion, load_scene, load_sensor
    from harness.api.mapping import RangeMap, RangeScan, range_map, range_scan
    from harness.api.motion import MotionEstimate, Status, estimate_motion
    from harness.api.ranging import RangeEstimate, Verdict, estimate_range
    from harness.api.results import RunResult, open_results
    from harness.api.running import run
    from harness.api.sensors import convert_sensor, describe_sensor
    from harness.api.sequence import SequenceRange, estimate_sequence
    from harness.api.settings import settings
    from harness.api.views import render
    from harness.api.warping import NewView, warp_view
    from harness.camera.intrinsics import Camera, FieldOfView
    from harness.camera.lens import Lens
    from harness.camera.models.hyperboloid import Mirror
    from harness.camera.sensor import Sensor, project, unproject
    from harness.datasets.checks.finding import Finding
    from harness.errors import InputError
    from harness.geometry.panorama import Grid, Panorama
    from harness.geometry.pose import Motion, Pose, relative_motion
    from harness.matching.interface import Matches, Reason
    from harness.matching.pair import Pair
    from harness.pipeline.maps import TrialMaps
    from harness.pipeline.rendered_view import RenderedView
    from harness.pipeline.specification import Trial
    from harness.pipeline.trial import Outcome, run_trial
    from harness.runs.experiment import Experiment
    from harness.simulation.scene import Scene

__all__ = [
    "CalibrationResult",
    "Camera",
    "DataSet",
    "DatasetPair",
    "DatasetScore",
    "Experiment",
    "FieldOfView",
    "Finding",
    "Grid",
    "InputError",
    "Lens",
    "Matches",
    "Mirror",
    "Motion",
    "MotionEstimate",
    "NewView",
    "Outcome",
    "Pair",
    "Panorama",
    "Pose",
    "RangeEstimate",
    "RangeMap",
    "RangeScan",
    "Reason",
    "RenderedView",
    "RigDescription",
    "RunResult",
    "Scene",
    "Sensor",
    "SequenceRange",
    "Status",
    "Trial",
    "TrialMaps",
    "Verdict",
    "__version__",
    "calibrate",
    "convert_sensor",
    "describe_rig",
    "describe_sensor",
    "estimate_motion",
    "estimate_range",
    "estimate_sequence",
    "find_rigs",
    "load_experiment",
    "load_motion",
    "load_scene",
    "load_sensor",
    "make_dataset",
    "open_dataset",
    "open_results",
    "project",
    "range_map",
    "range_scan",
    "relative_motion",
    "render",
    "run",
    "run_trial",
    "settings",
    "unproject",
    "warp_view",
]

_MODULES = {
    "api.calibrating": ("CalibrationResult", "calibrate"),
    "api.datasets": ("DataSet", "DatasetPair", "DatasetScore", "make_dataset", "open_dataset"),
    "api.designing": ("RigDescription", "describe_rig", "find_rigs"),
    "api.loading": ("load_experiment", "load_motion", "load_scene", "load_sensor"),
    "api.mapping": ("RangeMap", "RangeScan", "range_map", "range_scan"),
    "api.motion": ("MotionEstimate", "Status", "estimate_motion"),
    "api.ranging": ("RangeEstimate", "Verdict", "estimate_range"),
    "api.results": ("RunResult", "open_results"),
    "api.running": ("run",),
    "api.sensors": ("convert_sensor", "describe_sensor"),
    "api.sequence": ("SequenceRange", "estimate_sequence"),
    "api.settings": ("settings",),
    "api.views": ("render",),
    "api.warping": ("NewView", "warp_view"),
    "camera.intrinsics": ("Camera", "FieldOfView"),
    "camera.lens": ("Lens",),
    "camera.models.hyperboloid": ("Mirror",),
    "camera.sensor": ("Sensor", "project", "unproject"),
    "datasets.checks.finding": ("Finding",),
    "errors": ("InputError",),
    "geometry.panorama": ("Grid", "Panorama"),
    "geometry.pose": ("Motion", "Pose", "relative_motion"),
    "matching.interface": ("Matches", "Reason"),
    "matching.pair": ("Pair",),
    "pipeline.maps": ("TrialMaps",),
    "pipeline.rendered_view": ("RenderedView",),
    "pipeline.specification": ("Trial",),
    "pipeline.trial": ("Outcome", "run_trial"),
    "runs.experiment": ("Experiment",),
    "simulation.scene": ("Scene",),
}
"""The modules of the public names; each is loaded at its first use (PEP 562)."""

_HOME = {name: module for module, names in _MODULES.items() for name in names}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'harness' has no attribute '{name}'")
    value = getattr(import_module(f"harness.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
