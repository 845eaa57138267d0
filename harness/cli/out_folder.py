"""Checks, before the work, of files whose names nobody has given."""

from argparse import Namespace
from pathlib import Path

from harness.files import PAGE_MARK, OwnFiles, check_folder, check_no_others, check_replaces_none


def check_out_folder(options: Namespace, own: OwnFiles) -> None:
    """Refuse an output folder that cannot be used, has somebody else's files, or would lose an image that is read.

    Parameters
    ----------
    options
        Those of `range.add_matching`, with `--out`.
    own
        The files that are written.

    Raises
    ------
    InputError
        Names the folder, or one of the files.
    """
    from harness.api.masks import OF_A_MASK

    check_folder(options.out)
    check_no_others(options.out, own)
    if options.mask == Path("auto"):
        check_no_others(options.out, OF_A_MASK)
    given = (options.sensor, options.sensor_2, options.mask, options.mask_2, *(options.pose or ()))
    read = [options.left, options.right, *getattr(options, "more", ()), *(Path(each) for each in given if each)]
    check_replaces_none([options.out / name for name in own.marks], read)


def check_default_page(page: Path) -> None:
    """Refuse to write a page under its default name over a file that is no page of this program.

    Raises
    ------
    InputError
        Names the file.
    """
    own = OwnFiles("page of this program", {page.name: PAGE_MARK})
    check_no_others(page.parent, own, option=None, advice="give another name with --out")
