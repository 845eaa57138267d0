"""The sections of the report, in their order."""

from harness.report.section import Declared
from harness.report.sections import (
    comparison,
    confidence,
    distributions,
    failures,
    images,
    limit,
    locking,
    maps,
    matching_curve,
    measures,
    profiles,
    provenance,
    regions,
    settings,
    steps,
    sweeps,
)
from harness.report.sections.law import decomposition, example, geometry, verdict
from harness.report.sections.law import images as law_images

SECTIONS: tuple[Declared, ...] = (
    verdict.section,
    geometry.section,
    law_images.section,
    decomposition.section,
    sweeps.section,
    locking.section,
    regions.section,
    measures.section,
    steps.section,
    limit.section,
    comparison.section,
    images.section,
    matching_curve.section,
    profiles.section,
    maps.section,
    distributions.section,
    confidence.section,
    example.section,
    failures.section,
    settings.section,
    provenance.section,
)
"""Those about all trials, the base trial and the run keep their order among themselves; see `section.About` for which
come first."""
