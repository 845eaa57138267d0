"""The parser of the command line, whose errors are one line each in the words of the rest of the program."""

import argparse
import re
import sys
from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NoReturn

from harness.cli.exits import INPUT
from harness.display import shortened
from harness.errors import nearest

_NUMBER = {"float": "a number", "int": "a whole number"}


class Parser(argparse.ArgumentParser):
    """An argument parser without abbreviations, which takes nothing twice and whose errors are one line."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options, allow_abbrev=False)
        # argparse's pattern of values that begin with a dash. Its default does not recognise 1e-3 and inf.
        self._negative_number_matcher = re.compile(r"-(?:\.?\d|inf|nan)", re.IGNORECASE)
        self._words: list[str] = []

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse; what is not taken is an error of the sub-command, not of the program. Overrides argparse's."""
        self._words = list(sys.argv[1:] if args is None else args)
        self._check_twice()
        if self._has_commands() and (option := self._unknown_option()):
            self.error(self._not_taken(option))
        options, rest = super().parse_known_args(self._words, namespace)
        if rest:
            self.error(self._not_taken(rest[0]))
        return options, rest

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        """Check that a value is one of the choices; the error names the nearest one. Overrides argparse's."""
        if action.choices is not None and value not in action.choices:
            what = "command " if action.metavar == "COMMAND" else ""
            hint = nearest(str(value), [str(each) for each in action.choices])
            raise argparse.ArgumentError(None if what else action, f"unknown {what}'{value}'; {hint}")

    def _get_values(self, action: argparse.Action, arg_strings: list[str]) -> Any:
        """Refuse an empty path or name, as an unset variable of a shell leaves it: it would mean the working folder."""
        if "" in arg_strings and action.nargs != argparse.PARSER:  # a sub-command has words of its own
            raise argparse.ArgumentError(action, "must not be empty")
        return super()._get_values(action, arg_strings)

    def error(self, message: str) -> NoReturn:
        """Print the error, and exit."""
        text = shortened(self._reworded(message))
        print(f"omnirange: {text}{' See' if text.endswith('?') else '; see'} {self.prog} --help", file=sys.stderr)
        raise SystemExit(INPUT)

    def _check_twice(self) -> None:
        """Refuse an option that is given twice, unless it is repeatable: argparse takes the last."""
        given = [self._option_string_actions.get(word.partition("=")[0]) for word in self._before_dashes()]
        for action in given:
            if action and action.nargs != 0 and not _is_repeatable(action) and given.count(action) > 1:
                self.error(f"{'/'.join(action.option_strings)}: is given twice; leave one out")

    def _before_dashes(self) -> Sequence[str]:
        return self._words[: self._words.index("--")] if "--" in self._words else self._words

    def _unknown_option(self) -> str | None:
        """The first word that looks like an option and is none; of the program itself, the first before the command."""
        for word in self._before_dashes():
            if self._has_commands() and not word.startswith("-"):
                return None
            if self._looks_like_option(word) and word.partition("=")[0] not in self._option_string_actions:
                return word
        return None

    def _looks_like_option(self, word: str) -> bool:
        return word.startswith("-") and len(word) > 1 and not self._negative_number_matcher.match(word)

    def _has_commands(self) -> bool:
        return any(each.nargs == argparse.PARSER for each in self._get_positional_actions())

    def _not_taken(self, word: str) -> str:
        """What is said of a word that neither is an option nor belongs anywhere."""
        if self._looks_like_option(word):
            name = word.partition("=")[0]
            if name in self._option_string_actions:
                return f"'{name}' is behind --, after which nothing is an option"
            # The dashes, which all have, would make any two alike.
            words = [each[2:] for each in self._option_string_actions if each.startswith("--")]
            hint = nearest(name.lstrip("-"), words).replace("did you mean '", "did you mean '--")
            if not hint.startswith("did you mean"):
                hint = "a command's options follow its name" if self._has_commands() and self._words[1:] else ""
            return f"unknown option '{name}'" + (f"; {hint}" if hint else "")
        problem = f"'{word}' is one argument too many"
        if hint := self._repeat_hint(word):
            return f"{problem}; {hint}"
        if f"--{word}" in self._option_string_actions:
            return f"{problem}; did you mean '--{word}'?"
        row = next((each for each in self._get_positional_actions() if each.nargs in ("*", "+")), None)
        return problem if row is None else f"'{word}' stands apart; write each {row.metavar} beside the others"

    def _repeat_hint(self, word: str) -> str:
        """How a repeatable option is written that was given several values at once, of which this is one."""
        if word not in self._words:
            return ""
        for before in reversed(self._words[: self._words.index(word)]):
            if action := self._option_string_actions.get(before):
                break
        else:
            return ""
        return f"{before} takes one value each time: {before} A {before} B" if _is_repeatable(action) else ""

    def _dash_hint(self, action: argparse.Action) -> str:
        """How a value that begins with a dash is written, if that is what stands behind an option of one value."""
        for word, behind in pairwise(self._words):
            is_value = behind.startswith("-") and behind.partition("=")[0] not in self._option_string_actions
            if word in action.option_strings and action.nargs is None and is_value:
                return f"; one that begins with a dash is written {word}={behind}"
        return ""

    def _reworded(self, message: str) -> str:
        """An error of argparse in the words of this program."""
        if missing := re.fullmatch(r"the following arguments are required: (.*)", message, re.DOTALL):
            if option := self._unknown_option():  # what is missing may be its mistyped name
                return self._not_taken(option)
            # A word behind the first value of a repeatable option was taken for something else.
            plain = zip(self._words[1:], self._words[2:], strict=False)
            behind = [word for before, word in plain if not before.startswith("-") and not word.startswith("-")]
            hint = next(filter(None, map(self._repeat_hint, behind)), "")
            return f"{missing[1]}: missing{hint and f'; {hint}'}"
        found = re.match(r"argument (\S+): (.*)", message, re.DOTALL)
        if not found:
            return message
        name, problem = found.groups()
        if problem.startswith("expected "):
            action = self._option_string_actions.get(name.split("/")[0])
            problem = f"must be followed by {_values(action)}{self._dash_hint(action)}" if action else problem
        elif value := re.fullmatch(r"invalid (float|int) value: (.*)", problem, re.DOTALL):
            problem = f"must be {_NUMBER[value[1]]}; found {value[2]}"
        elif other := re.fullmatch(r"not allowed with argument (.*)", problem):
            problem = f"excludes {other[1]}; leave one of them out"
        elif value := re.fullmatch(r"ignored explicit argument (.*)", problem, re.DOTALL):
            problem = f"takes no value; found {value[1]}"
        return f"{name}: {problem}"


def _is_repeatable(action: argparse.Action) -> bool:
    return isinstance(action, argparse._AppendAction)  # noqa: SLF001 - it has no public name


def _values(action: argparse.Action) -> str:
    """The values of an option, as its help shows them."""
    name = action.metavar or action.dest.upper()
    text = " ".join(name) if isinstance(name, tuple) else name
    return f"one {text} or more" if action.nargs == "+" else text
