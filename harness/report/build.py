"""Assemble the report: one self-contained HTML file."""

from collections.abc import Callable, Sequence
from dataclasses import replace

from harness import interrupts
from harness.copies import made_with_a_copy
from harness.report import theme, words
from harness.report.markup import html, template
from harness.report.opening import opening
from harness.report.section import MOST_BYTES, About, Context, Declared, Paragraph, Section
from harness.report.sections import SECTIONS
from harness.runs.conclusions import leading
from harness.runs.run import Result


def build_report(
    result: Result,
    failures: list[str] | None = None,
    sections: Sequence[Declared] | None = None,
    observe: Callable[[int, int], None] = lambda _done, _all: None,
    *,
    may_copy: bool = False,
) -> str:
    """The report of a finished experiment as HTML text, the same for the same result.

    Statements about all trials come from their rows. The base trial is shown in detail, once for each method.

    Parameters
    ----------
    failures
        Gets a line for each figure that could not be drawn and each section that could not be made; the page says so
        in its place.
    sections
        The sections of the page instead of `SECTIONS`; those about the same subject keep their order.
    observe
        Called with the number of sections that are made, and of all, as each is begun.
    may_copy
        Whether a copy of this process may make some of the sections, see `copies`.
    """
    context = Context.of(result)
    page_sections = sections_of(context, failures, sections, observe, may_copy=may_copy)
    said, more = leading(result.summary.get("conclusions", ()))
    return template("report.html.j2").render(
        result=result,
        experiment=result.experiment,
        trial=context.trial,
        sweep=context.sweep,
        opening=opening(context, page_sections),
        abstract=list(words.abstract(result, context.trial, context.compared)),
        said=said,
        more=more,
        overview=list(words.overview(result, context.sweep)),
        sections=page_sections,
    )


def sections_of(
    context: Context,
    failures: list[str] | None = None,
    sections: Sequence[Declared] | None = None,
    observe: Callable[[int, int], None] = lambda _done, _all: None,
    *,
    may_copy: bool = False,
) -> list[Section]:
    """The sections of a report in their order, without those that have nothing to show; see `build_report`."""
    ordered = _in_order(SECTIONS if sections is None else sections, context)
    last = [number for number, each in enumerate(ordered) if each.takes_the_rest]
    first = [number for number in range(len(ordered)) if number not in last]

    with theme.style() as missing:

        def make(number: int, room: int = MOST_BYTES) -> tuple[Section | None, list[str]]:
            missing.clear()
            section = _section_of(ordered[number], replace(context, room=room), missing)
            return section, missing[:]

        def size(number: int) -> int:
            section, _ = made[number]
            return section.size if section else 0

        # Those that take the rest are begun first, as they take long, and mostly fit.
        made = made_with_a_copy(make, (*last, *first), lambda before: observe(before, len(ordered)), may_copy=may_copy)
        left = MOST_BYTES - sum(map(size, first))
        for number in last:
            if size(number) > left:
                made[number] = make(number, left)
            left -= size(number)
    if failures is not None:
        failures.extend(line for number in (*first, *last) for line in made[number][1])
    return [section for _, (section, _) in sorted(made.items()) if section]


def _in_order(sections: Sequence[Declared], context: Context) -> list[Declared]:
    """All trials come first in a sweep, the base trial elsewhere, and where the paper's claims open the page: its
    figures show them. The run itself comes last.
    """
    first, second = About.ALL_TRIALS, About.BASE_TRIAL
    if not context.sweep.several or context.summary.get("claims"):
        first, second = second, first
    order = (first, second, About.THE_RUN)
    return sorted(sections, key=lambda each: order.index(each.about))


def _section_of(declared: Declared, context: Context, failures: list[str]) -> Section | None:
    """The section; if it fails, a section with the error in its place, so that the others are unaffected."""
    title = declared.id
    try:
        title = declared.title_in(context)
        return declared(context)
    except Exception as error:  # noqa: BLE001
        interrupts.check()  # Ctrl-C may come wrapped as another error
        reason = theme.reason_of(error)
        failures.append(f"a section of the report could not be made: {declared.id}: {reason}")
        return Section(declared.id, title, (Paragraph(html(_FAILED, reason=reason)),))


_FAILED = '<p class="missing">This section could not be made: {{ reason }}</p>'
