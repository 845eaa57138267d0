"""Pages without their drawings, which take most of the time, for tests of what else a page says or stands beside."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest


@contextmanager
def undrawn() -> Iterator[None]:
    """Leave the figures of pages blank. All is plotted into them as ever, so that what fails there fails here too.

    Each kind of page has tests of its own in which it is drawn.
    """
    from matplotlib.figure import Figure

    draw = Figure.savefig

    def leave_blank(figure: Figure, stream: Any, **options: Any) -> None:
        if options["format"] == "svg":
            stream.write('<svg xmlns="http://www.w3.org/2000/svg" width="9pt" height="9pt"></svg>\n')
        else:
            draw(figure, stream, **options)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Figure, "savefig", leave_blank)
        yield
