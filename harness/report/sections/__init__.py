"""The sections of the report, in their order."""

from harness.report.section import Declared
from harness.report.sections import (
    cases,
    comparison,
    confidence_curves,
    distributions,
    error_budget,
    error_curves,
    error_maps,
    failures,
    locking,
    matching_curve,
    measures,
    motion_cost,
    noise_limit,
    novel_views,
    profiles,
    provenance,
    range_profiles,
    regional_errors,
    scene_to_panorama,
    steps,
    trial_settings,
)
from harness.report.sections.law import decomposition, example, fits, perturbed_angles, verdict

SECTIONS: tuple[Declared, ...] = (
    verdict.section,
    perturbed_angles.section,
    fits.section,
    decomposition.section,
    novel_views.section,
    range_profiles.section,
    cases.section,
    error_curves.section,
    locking.section,
    regional_errors.section,
    measures.section,
    motion_cost.section,
    steps.section,
    noise_limit.section,
    error_budget.section,
    comparison.section,
    scene_to_panorama.section,
    matching_curve.section,
    profiles.section,
    error_maps.section,
    distributions.section,
    confidence_curves.section,
    example.section,
    failures.section,
    trial_settings.section,
    provenance.section,
)
"""Those about all trials, the base trial and the run keep their order among themselves; see `section.About` for which
come first."""
