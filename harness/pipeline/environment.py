"""The environment that results may depend on besides an experiment's settings: program, machine and libraries."""

import hashlib
import platform
from datetime import UTC, datetime
from functools import lru_cache
from importlib import metadata
from pathlib import Path
from typing import Any

from harness.machine import available_cpus, cpu_model
from harness.version import __version__

_ROOT = Path(__file__).parent.parent
_LIBRARIES = ("numpy", "scipy", "numba", "embreex", "trimesh", "scikit-image", "pydantic", "pillow")
"""Libraries that the pipeline computes with."""


_OPTIONAL = ("opencv-contrib-python-headless", "poselib")
"""Libraries that only some matchers compute with, or the estimation of a motion."""


def environment() -> dict[str, Any]:
    """The program, the machine and the libraries."""
    return {
        "omnirange": __version__,
        "source_sha256": source_hash(),
        "finished": datetime.now(UTC).isoformat(timespec="seconds"),
        "python": platform.python_version(),
        "platform": platform.platform(),
        "cpu": cpu_model(),
        "cpus": available_cpus(),
        "packages": {
            name: version for name in (*_LIBRARIES, *_OPTIONAL, "matplotlib") if (version := _version_if_there(name))
        },
    }


def source_hash() -> str:
    """SHA-256 of all of the program's source."""
    return _hash_of("**/*.py", "**/*.j2", "**/*.css")


@lru_cache(maxsize=1)
def code_hash() -> str:
    """SHA-256 of the code that a trial's row depends on: source from the camera to the evaluation, and libraries.

    The report, the command line, and the code that runs trials and stores their rows are not included.
    """
    rooms = ("geometry", "camera", "io", "simulation", "motion", "matching", "evaluation", "pipeline")
    versions = [f"{name} {metadata.version(name)}" for name in _LIBRARIES]
    versions += [f"{name} {each}" for name in _OPTIONAL if (each := _version_if_there(name))]
    files = ("compiled.py", "spec.py", "images.py", "third_party.py", "source_files.py")
    source = _hash_of(*(f"{room}/**/*.py" for room in rooms), *files)
    return hashlib.sha256("\n".join([source, platform.python_version(), *versions]).encode()).hexdigest()


@lru_cache(maxsize=1)
def render_hash() -> str:
    """SHA-256 of the source that a rendered image depends on."""
    return _hash_of(
        "geometry/**/*.py", "camera/**/*.py", "io/**/*.py", "simulation/**/*.py", "compiled.py", "spec.py", "images.py"
    )


def _version_if_there(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def _hash_of(*patterns: str) -> str:
    """SHA-256 over source files, names and contents, in alphabetical order."""
    digest = hashlib.sha256()
    for path in sorted({path for pattern in patterns for path in _ROOT.glob(pattern)}):
        digest.update(path.relative_to(_ROOT).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()
