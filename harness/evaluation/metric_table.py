"""The table of metrics: one entry each, which rows, tables, report, terminal and `compare` all read.

A metric over a part of the domain has that part before its name, as in
`wall_range_median_abs_m`; see `metric`.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

from harness.evaluation.shape_scores import EDGES_M, NORMALS_DEG
from harness.evaluation.tally import Tally

Better = Literal["lower", "higher", "near zero"]


@dataclass(frozen=True)
class Metric:
    """A figure that sums up the errors of a trial."""

    name: str
    """Its name in rows, `trials.csv` and `summary.json`, which ends in the unit there."""
    quantity: str
    """The quantity: the first part of the heading."""
    statistic: str
    """The statistic: the second part of the heading; may be empty."""
    unit: str
    """The unit in which it is shown."""
    scale: float
    """Shown is `scale` times the value."""
    form: str
    """Format of the shown value."""
    better: Better
    """The better direction."""
    of: Callable[[Tally], float] | None = None
    """Computes it from a trial's errors over the domain. None for the core figures, which also exist for parts of the
    picture; see `metrics.CORE`."""
    geometric: bool = False
    """Averaged over trials as a geometric mean, which suits medians of positive errors; otherwise arithmetically."""

    @property
    def heading(self) -> str:
        """The heading of a column: quantity and statistic."""
        return f"{self.quantity}, {self.statistic}" if self.statistic else self.quantity

    @property
    def short(self) -> str:
        """A short heading: errors are absolute unless stated otherwise."""
        return self.heading.replace(", median |error|", "").replace(", mean |error|", ", mean")


PARTS = {"wall": "Walls", "floor": "Floor", "solid_angle": "Solid angle"}
"""The parts that a name may begin with, and their headings."""


def metric(name: str) -> Metric:
    """The metric of this name, of the whole domain or of one of `PARTS`.

    Raises
    ------
    KeyError
        When there is none.
    """
    for part, heading in PARTS.items():
        if name.startswith(f"{part}_"):
            whole = METRICS[name.removeprefix(f"{part}_")]
            return replace(whole, name=name, quantity=f"{heading}: {whole.quantity[0].lower()}{whole.quantity[1:]}")
    return METRICS[name]


def is_metric(name: str) -> bool:
    """Whether there is a metric of this name; see `metric`."""
    try:
        metric(name)
    except KeyError:
        return False
    return True


def _metrics(*entries: Metric) -> dict[str, Metric]:
    return {each.name: each for each in entries}


def _boundaries() -> Iterator[Metric]:
    """Precision and recall of boundaries, of three heights."""
    for i, limit in enumerate(EDGES_M):
        what = f"Boundaries above {limit:g}\u00a0m"
        yield Metric(
            f"boundary_precision_{limit:g}m", what, "precision", "%", 100, ".1f", "higher", partial(_precision, i)
        )
        yield Metric(f"boundary_recall_{limit:g}m", what, "recall", "%", 100, ".1f", "higher", partial(_recall, i))


def _precision(i: int, errors: Tally) -> float:
    return errors.shape.precision[i]


def _recall(i: int, errors: Tally) -> float:
    return errors.shape.recall[i]


def _normals() -> Iterator[Metric]:
    """Shares of normals within three angles."""
    for i, limit in enumerate(NORMALS_DEG):
        name, what = f"normal_within_{limit:g}deg", f"within {limit:g}°"
        yield Metric(name, "Normals", what, "%", 100, ".1f", "higher", partial(_normals_within, i))


def _normals_within(i: int, errors: Tally) -> float:
    return errors.shape.normal_within[i]


METRICS: dict[str, Metric] = _metrics(
    Metric("density", "Density", "", "%", 100, ".1f", "higher"),
    Metric("disparity_median_abs_px", "Disparity", "median |error|", "px", 1, ".3f", "lower", geometric=True),
    Metric("disparity_rmse_px", "Disparity", "RMSE", "px", 1, ".3f", "lower"),
    Metric("bad_1px", "Above 1\u00a0px", "", "%", 100, ".2f", "lower"),
    Metric("range_median_abs_m", "Range", "median |error|", "mm", 1000, ".1f", "lower", geometric=True),
    Metric("range_mae_m", "Range", "mean |error|", "mm", 1000, ".1f", "lower"),
    Metric("range_rmse_m", "Range", "RMSE", "mm", 1000, ".1f", "lower"),
    Metric("range_bias_m", "Range", "bias", "mm", 1000, "+.1f", "near zero"),
    Metric("disparity_mae_px", "Disparity", "mean |error|", "px", 1, ".3f", "lower", lambda t: t.mean_abs_px),
    Metric("disparity_bias_px", "Disparity", "median signed", "px", 1, "+.3f", "near zero", lambda t: t.median_px[0]),
    Metric("bad_0.5px", "Above 0.5\u00a0px", "", "%", 100, ".2f", "lower", lambda t: t.above[0] / t.matched),
    Metric("bad_2px", "Above 2\u00a0px", "", "%", 100, ".2f", "lower", lambda t: t.above[1] / t.matched),
    Metric("bad_4px", "Above 4\u00a0px", "", "%", 100, ".2f", "lower", lambda t: t.above[2] / t.matched),
    Metric("disparity_a50_px", "A50", "", "px", 1, ".3f", "lower", lambda t: t.quantiles_px[1]),
    Metric("disparity_a90_px", "A90", "", "px", 1, ".3f", "lower", lambda t: t.quantiles_px[2]),
    Metric("disparity_a95_px", "A95", "", "px", 1, ".3f", "lower", lambda t: t.quantiles_px[3]),
    Metric("disparity_a99_px", "A99", "", "px", 1, ".2f", "lower", lambda t: t.quantiles_px[4]),
    Metric("range_abs_rel", "AbsRel", "", "%", 100, ".2f", "lower", lambda t: t.abs_rel),
    Metric("range_sq_rel_m", "SqRel", "", "mm", 1000, ".2f", "lower", lambda t: t.sq_rel_m),
    Metric("range_silog", "SILog", "", "", 1, ".4f", "lower", lambda t: float(t.logarithm.std())),
    Metric("range_delta_1.05", "δ < 1.05", "", "%", 100, ".1f", "higher", lambda t: t.within[0] / t.matched),
    Metric("range_delta_1.1", "δ < 1.1", "", "%", 100, ".1f", "higher", lambda t: t.within[1] / t.matched),
    Metric("range_delta_1.25", "δ < 1.25", "", "%", 100, ".1f", "higher", lambda t: t.within[2] / t.matched),
    Metric("seam_range_m", "Seam", "LRCE of range", "mm", 1000, ".1f", "lower", lambda t: t.shape.seam_m),
    Metric("seam_disparity_px", "Seam", "LRCE of disparity", "px", 1, ".3f", "lower", lambda t: t.shape.seam_px),
    *_boundaries(),
    Metric("normal_mean_deg", "Normals", "mean error", "°", 1, ".2f", "lower", lambda t: t.shape.normal_mean_deg),
    Metric("normal_rmse_deg", "Normals", "RMSE", "°", 1, ".2f", "lower", lambda t: t.shape.normal_rmse_deg),
    *_normals(),
    Metric("motion_rotation_deg", "Rotation of the motion", "error", "°", 1, ".4f", "lower", geometric=True),
    Metric("motion_direction_deg", "Direction of t", "error", "°", 1, ".4f", "lower", geometric=True),
    Metric("motion_range_predicted", "Range by the motion", "predicted σ", "%", 100, ".3f", "lower", geometric=True),
    Metric("motion_range_measured", "Range by the motion", "measured", "%", 100, ".3f", "lower", geometric=True),
    Metric("motion_range_z", "Range by the motion", "error over σ", "", 1, ".2f", "near zero"),
    Metric("view_psnr_db", "New views", "PSNR", "dB", 1, ".2f", "higher"),
    Metric("view_ws_psnr_db", "New views", "WS-PSNR", "dB", 1, ".2f", "higher"),
    Metric("view_ssim", "New views", "SSIM", "", 1, ".3f", "higher"),
    Metric("view_holes", "New views", "holes", "%", 100, ".2f", "lower"),
    Metric("view_ceiling_psnr_db", "New views", "PSNR, true ranges", "dB", 1, ".2f", "higher"),
    Metric("view_floor_psnr_db", "New views", "PSNR, nearest image", "dB", 1, ".2f", "higher"),
    Metric("scan_density", "Range profile", "density", "%", 100, ".1f", "higher"),
    Metric("scan_bias_m", "Range profile", "bias", "mm", 1000, "+.1f", "near zero"),
    Metric("scan_rms_m", "Range profile", "RMS error", "mm", 1000, ".1f", "lower"),
    Metric("scan_median_abs_m", "Range profile", "median |error|", "mm", 1000, ".1f", "lower", geometric=True),
    Metric("scan_within_1_sigma", "Range profile", "within 1 σ", "%", 100, ".1f", "higher"),
    Metric("scan_missed", "Range profile", "missed", "%", 100, ".2f", "lower"),
    Metric("scan_false", "Range profile", "false", "%", 100, ".2f", "lower"),
    Metric("scan_thin_found", "Range profile", "thin obstacles found", "%", 100, ".0f", "higher"),
    Metric("map_iou_free", "Map", "IoU, free", "", 1, ".3f", "higher"),
    Metric("map_iou_occupied", "Map", "IoU, occupied", "", 1, ".3f", "higher"),
    Metric("map_border_m", "Map", "distance of borders", "mm", 1000, ".1f", "lower"),
    Metric("map_missed_borders", "Map", "borders missed", "%", 100, ".2f", "lower"),
    Metric("map_ceiling_iou_free", "Map", "IoU, free, true ranges", "", 1, ".3f", "higher"),
    Metric("map_ceiling_iou_occupied", "Map", "IoU, occupied, true ranges", "", 1, ".3f", "higher"),
    Metric("occlusion_precision", "Occlusion", "precision", "%", 100, ".1f", "higher"),
    Metric("occlusion_recall", "Occlusion", "recall", "%", 100, ".1f", "higher"),
    Metric("refined", "Refined", "", "%", 100, ".1f", "higher"),
)
"""All metrics by name, in the order of the columns. An entry with `of` needs nothing else: rows have it, and all that
reads rows."""
