"""POV-Ray for tests: runs a scene that was written for it, and reads the image."""

import os
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray


def povray_path() -> str:
    """Where POV-Ray is; without it the test is skipped, but under CI it fails: there it must not be missing."""
    result = shutil.which("povray")
    if result is None:
        message = "no povray on this machine; on Debian: apt-get install povray"
        if os.environ.get("CI"):
            pytest.fail(message)
        pytest.skip(message)
    return result


def traced(folder: Path, *options: str) -> NDArray[np.float64]:
    """The image `[height, width, 3]`, 0 .. 1, of a folder's `scene.ini`, one ray a pixel unless options differ."""
    command = [povray_path(), "scene.ini", "-A", "+FP16", "+Otraced.ppm", "-GA", *options]
    result = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=300, check=False)
    assert result.returncode == 0, result.stderr
    data = (folder / "traced.ppm").read_bytes()
    head = re.match(rb"P6\n(?:#.*\n)*(\d+)\s(\d+)\s65535\n", data)
    assert head is not None, data[:80]
    width, height = map(int, head.groups())
    return np.frombuffer(data[head.end() :], ">u2").reshape(height, width, 3) / 65535


def averaged(folder: Path, width: int, height: int, per_side: int) -> tuple[NDArray, NDArray]:
    """Grey levels `[height, width]`, means of `per_side`² rays a pixel, and how many of each pixel's rays were lost.

    A lost ray is one that slipped between two triangles, and is not in the mean.
    """
    samples = traced(folder, f"+W{width * per_side}", f"+H{height * per_side}")
    lost = samples[..., 0] != samples[..., 1]  # the scene is grey, its background is not
    blocks = height, per_side, width, per_side
    number = lost.reshape(blocks).sum(axis=(1, 3))
    grey = np.where(lost, 0, 255 * samples[..., 1]).reshape(blocks).sum(axis=(1, 3))
    return grey / np.maximum(per_side**2 - number, 1), number


def positions(folder: Path) -> tuple[NDArray, NDArray]:
    """The points `[height, width, 3]` that pixel centres see, metres, and which are not black, `[height, width]`.

    Read as the comment in `scene.pov` says. A point is NaN where it is black, and where the ray was lost.
    """
    text = (folder / "scene.pov").read_text(encoding="utf-8")
    said = re.search(r"round\((\d+)\*C.*low = <(.+?)>, span = (\S+)\.\n", text)
    periods, low, span = int(said[1]), np.array([float(each) for each in said[2].split(",")]), float(said[3])
    coarse, fine = (traced(folder, f"Declare=Shown={each}") for each in (1, 2))
    point = low + span * (np.round(periods * coarse - fine) + fine) / periods
    shown, lost = coarse.max(axis=-1) > 0, (coarse == [1, 0, 1]).all(axis=-1)
    point[~shown | lost] = np.nan
    return point, shown
