"""Standard output that may be closed or full without stopping the command."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any, TextIO

from harness.errors import InputError


class Output:
    """A wrapper of a stream that discards what can no longer be written.

    A reader that goes away (`| head`) is not an error. Any other failure is stored in `error`.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._is_gone = False
        self.error: OSError | None = None

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """Write, if the stream still accepts data."""
        if not self._is_gone:
            try:
                self._stream.write(text)
            except OSError as error:
                self._lose(error)
        return len(text)

    def flush(self) -> None:
        """Flush the stream."""
        if not self._is_gone:
            try:
                self._stream.flush()
            except OSError as error:
                self._lose(error)

    def _lose(self, error: OSError) -> None:
        self._is_gone = True
        self.error = None if isinstance(error, BrokenPipeError) else error
        with suppress(OSError, ValueError):  # discard what is still buffered, or Python would try again at its end
            null = os.open(os.devnull, os.O_WRONLY)
            os.dup2(null, self._stream.fileno())
            os.close(null)


@contextmanager
def patient_output() -> Iterator[None]:
    """Let standard output fail without stopping the command, and escape characters that it cannot encode.

    Raises
    ------
    InputError
        On exit, when writing failed for a reason other than a reader that has gone away.
    """
    stream = sys.stdout
    if stream is None:
        yield
        return
    errors = getattr(stream, "errors", None)
    if hasattr(stream, "reconfigure"):
        stream.reconfigure(errors="backslashreplace")
    output = Output(stream)
    sys.stdout = output
    try:
        yield
        output.flush()
    finally:
        output.flush()
        sys.stdout = stream
        if hasattr(stream, "reconfigure"):
            with suppress(OSError):
                stream.reconfigure(errors=errors)
    if output.error is not None:
        raise InputError(f"cannot be written ({output.error.strerror})", file="standard output")
