"""The one exception that is the user's to mend, the one warning, and errors in one line."""

import difflib
import re
from collections.abc import Sequence
from pathlib import Path


class InputError(Exception):
    """An error in the program's input; its text is one line that says where, what is wrong and what would be right.

    Parameters
    ----------
    problem
        The error, and what would be right.
    file
        The file it was found in, if any.
    key
        The dotted key inside that file, or the command-line option.
    """

    def __init__(self, problem: str, *, file: str | Path | None = None, key: str | None = None) -> None:
        self.problem = problem
        self.file = None if file is None else str(file)
        self.key = key
        problem = _without_long_words(problem)
        where = ": ".join(part for part in (self.file, key and _without_long_words(key)) if part)
        text = f"{where}: {problem}" if where else problem
        super().__init__(one_line(text))


def _without_long_words(text: str) -> str:
    """A text whose words of more than 300 characters, which are quoted from a damaged file, are cut in the middle."""
    return re.sub(r"\S{300,}", lambda word: f"{word[0][:60]} ... {word[0][-40:]}", text)


def nearest(word: str, choices: Sequence[str]) -> str:
    """A hint that ends a message: the nearest valid word, or all of them."""
    close = difflib.get_close_matches(word, choices, n=1, cutoff=0.5)
    return f"did you mean '{close[0]}'?" if close else f"valid: {', '.join(choices) or 'none'}"


def with_article(noun: str) -> str:
    """A noun after "a" or "an"; no word of this program begins with a silent h or a u that is a vowel."""
    return f"{'an' if noun[:1].lower() in 'aeio' else 'a'} {noun}"


class Notice(UserWarning):
    """A notice for the user, in one line: the program continues, and its numbers are right."""


def one_line(text: str) -> str:
    """Text on one line that any terminal or file takes: invalid characters are written as escapes."""
    return printable(" ".join(text.split()))


def printable(text: str) -> str:
    """Text with lone surrogates, such as those of file names that are not UTF-8, written as escapes."""
    return text.encode(errors="backslashreplace").decode()


def described(error: BaseException) -> str:
    """The kind of an error and its text on one line; the kind alone if it cannot say."""
    try:
        text = str(error)
    except Exception:  # noqa: BLE001 - an error of somebody else's, which fails even at this
        text = ""
    return one_line(f"{type(error).__name__}: {text}" if text else type(error).__name__)
