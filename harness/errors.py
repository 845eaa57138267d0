"""The one exception that is the user's to mend, and the one warning."""

from pathlib import Path


class InputError(Exception):
    """Something given to the program is wrong; its text is one line that says where, what and what would be right.

    Parameters
    ----------
    problem
        What is wrong and what would be right.
    file
        The file it was found in, if any.
    key
        The dotted key inside that file, or the command-line option.
    """

    def __init__(self, problem: str, *, file: str | Path | None = None, key: str | None = None) -> None:
        self.problem = problem
        self.file = None if file is None else str(file)
        self.key = key
        where = ": ".join(part for part in (self.file, key) if part)
        text = f"{where}: {problem}" if where else problem
        super().__init__(" ".join(text.split()))


class Notice(UserWarning):
    """Something that a user may want to know, in one line: the program goes on, and its numbers are right."""
