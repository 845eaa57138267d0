"""Differences between operating systems, so that no other file needs to know them."""

import ctypes
import os
import platform
import signal
import subprocess
from pathlib import Path

FORK_SAFE: set[int] = set()
"""Native ids of threads that hold no lock while the process forks."""
_M_MMAP_THRESHOLD = -3
"""The option's number in malloc.h of the GNU C library."""


def available_cpus() -> int:
    """CPUs that this process may use: those it is bound to where the system binds processes, else all."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def can_be_copied() -> bool:
    """Whether a copy of this process can help it: on Linux, with more than one CPU. (Forks elsewhere are not safe.)"""
    return hasattr(os, "fork") and platform.system() == "Linux" and available_cpus() > 1


def has_one_thread() -> bool:
    """Whether this process has a single thread, those of libraries included; False where the system does not say.

    Threads in `FORK_SAFE` do not count.
    """
    try:
        return len({int(each.name) for each in Path("/proc/self/task").iterdir()} - FORK_SAFE) == 1
    except OSError:
        return False


def give_back_memory() -> bool:
    """Whether memory of a megabyte or more goes back to the system as soon as it is free.

    The GNU C library keeps what it guesses to be wanted again, which is up to 32 MB at a time: with images of several
    megapixels that adds up to half a gigabyte. Elsewhere nothing is changed.
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):  # another library; TypeError on Windows
        return False
    return bool(mallopt(_M_MMAP_THRESHOLD, 1 << 20))


def cpu_model() -> str:
    """The processor's name; `unknown` where the system does not say."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    named = (line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    return next(named, "") or platform.processor() or "unknown"


def has_process_groups() -> bool:
    """Whether a program can be ended together with all processes that it has started (not on Windows)."""
    return hasattr(os, "killpg") and hasattr(signal, "SIGKILL")


def kill(process: subprocess.Popen[bytes], group: int | None = None) -> None:
    """End a program at once, with its process group where there are such, and wait for its end.

    On Windows only the program itself is ended: what it has started keeps running.

    Parameters
    ----------
    group
        The process group; the program's own when None.
    """
    try:
        if has_process_groups():
            os.killpg(group or process.pid, signal.SIGKILL)
        else:
            process.kill()
    except (ProcessLookupError, PermissionError):  # the second on macOS and Windows, of a process that has ended
        pass
    process.wait()
