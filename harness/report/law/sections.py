"""All sections on the law together."""

from typing import Any

from harness.report.law.best_baseline import best_baseline
from harness.report.law.decomposition import decomposition
from harness.report.law.geometry import geometry
from harness.report.law.images import images
from harness.report.law.verdict import findings
from harness.report.sweep import Sweep


def sections_of(sweep: Sweep, law: dict[str, Any], column_deg: float) -> dict[str, Any]:
    """The verdict and the parts, under the names that the template `law.html.j2` knows them by.

    Parameters
    ----------
    law
        The summary's `law`.
    column_deg
        One pixel of disparity.
    """
    return {
        "findings": findings(sweep, law),
        "geometry": geometry(),
        "images": images(sweep, law),
        "decomposition": decomposition(sweep, law, column_deg),
        "best_baseline": best_baseline(sweep, law),
    }
