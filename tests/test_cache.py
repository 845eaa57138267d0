"""The cache of renders: never a wrong image, never more than the limit, and shared by processes."""

import hashlib
import io
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from sweeps import omnirange, write_small

from harness import compiled
from harness.errors import InputError
from harness.files import cache_folder
from harness.geometry.pose import Pose
from harness.pipeline.render_cache import RenderCache, limit_bytes
from harness.pipeline.stage_cache import StageCache
from harness.pipeline.trial import run_trial
from harness.runs.load import load_experiment

IMAGE = np.arange(12, dtype=np.float32).reshape(3, 4) + np.float32(0.1)


class Maker:
    """Counts how often it is asked."""

    def __init__(self, image: np.ndarray = IMAGE) -> None:
        self.image, self.calls = image, 0

    def __call__(self) -> np.ndarray:
        self.calls += 1
        return self.image


def only_file(folder: Path) -> Path:
    (path,) = (folder / "renders").iterdir()
    return path


def test_made_once_and_read_back_to_the_bit(tmp_path: Path) -> None:
    make = Maker()
    first = RenderCache(tmp_path, 10**6).get("key", make)
    again = RenderCache(tmp_path, 10**6).get("key", make)
    assert make.calls == 1
    assert first.tobytes() == again.tobytes()
    assert (again.dtype, again.shape, again.flags.writeable) == (IMAGE.dtype, IMAGE.shape, False)


def test_keys_are_told_apart(tmp_path: Path) -> None:
    cache = RenderCache(tmp_path, 10**6)
    keys = ["scene", ("scene", 1), ("scene", "1"), Pose(), Pose(yaw_deg=1e-12)]
    for number, key in enumerate(keys):
        cache.get(key, Maker(IMAGE + number))
    assert [float(cache.get(key, Maker())[0, 0] - IMAGE[0, 0]) for key in keys] == pytest.approx(range(len(keys)))


@pytest.mark.parametrize("harm", ["truncated", "empty", "bit", "other"])
def test_a_file_that_is_harmed_is_made_anew(tmp_path: Path, harm: str) -> None:
    make = Maker()
    RenderCache(tmp_path, 10**6).get("key", make)
    path = only_file(tmp_path)
    data = bytearray(path.read_bytes())
    data[-3] ^= 1
    path.write_bytes(
        {"truncated": bytes(data[:-10]), "empty": b"", "bit": bytes(data), "other": b"not an image" * 99}[harm]
    )
    assert np.array_equal(RenderCache(tmp_path, 10**6).get("key", make), IMAGE)
    assert make.calls == 2
    RenderCache(tmp_path, 10**6).get("key", make)
    assert make.calls == 2


def test_a_failure_is_not_kept(tmp_path: Path) -> None:
    def fail() -> np.ndarray:
        raise InputError("inside a wall")

    cache = RenderCache(tmp_path, 10**6)
    with pytest.raises(InputError):
        cache.get("key", fail)
    assert cache.contents().files == 0
    assert np.array_equal(cache.get("key", Maker()), IMAGE)


def test_the_least_recently_used_goes_first(tmp_path: Path) -> None:
    image = np.zeros(1000, dtype=np.float32)
    cache = RenderCache(tmp_path, 50_000)
    for number in range(40):
        cache.get(number, Maker(image))
        cache.get(0, Maker(image))  # in use all the time
        for age, path in enumerate(sorted((tmp_path / "renders").iterdir(), key=lambda each: each.stat().st_mtime_ns)):
            os.utime(path, ns=(age * 10**9, age * 10**9))  # clocks of file systems are coarse
        assert cache.contents().bytes <= 50_000
    assert cache.contents().files >= 5
    stored, old = Maker(image), Maker(image)
    cache.get(0, stored)
    cache.get(1, old)
    assert (stored.calls, old.calls) == (0, 1)


def test_an_image_beyond_the_limit_is_not_kept(tmp_path: Path) -> None:
    cache = RenderCache(tmp_path, 100)
    assert np.array_equal(cache.get("key", Maker()), IMAGE)
    assert cache.contents().files == 0


def test_a_folder_that_cannot_be_written_costs_time_alone(tmp_path: Path) -> None:
    (tmp_path / "renders").write_text("in the way")
    assert np.array_equal(RenderCache(tmp_path, 10**6).get("key", Maker()), IMAGE)


def test_what_dead_processes_left_is_cleared_away(tmp_path: Path) -> None:
    cache = RenderCache(tmp_path, 10**6)
    cache.get("key", Maker())
    old, new = (tmp_path / "renders" / f".{name * 32}.partial" for name in ("0", "1"))
    old.write_bytes(b"half")
    new.write_bytes(b"half")
    os.utime(old, (0, time.time() - 7200))
    assert cache.contents().files == 1
    assert (old.exists(), new.exists()) == (False, True)


@pytest.mark.slow
def test_processes_share_it(tmp_path: Path) -> None:
    """Four processes write and read the same thirty images, under a limit that holds ten of them."""
    program = """
import sys, numpy as np
from pathlib import Path
from harness.pipeline.render_cache import RenderCache
cache = RenderCache(Path(sys.argv[1]), 45_000)
draws = np.random.default_rng(int(sys.argv[2]))
for _ in range(300):
    number = int(draws.integers(30))
    image = cache.get(number, lambda: np.full(1000, number, dtype=np.float32))
    assert image.shape == (1000,) and (image == number).all()
"""
    processes = [
        subprocess.Popen([sys.executable, "-c", program, str(tmp_path), str(seed)], stderr=subprocess.PIPE)
        for seed in range(4)
    ]
    assert [process.communicate(timeout=600)[1] for process in processes] == [b""] * 4
    assert RenderCache(tmp_path, 45_000).contents().bytes <= 2 * 45_000
    assert not list((tmp_path / "renders").glob("*.partial"))


def test_place_and_limit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMNIRANGE_CACHE", str(tmp_path / "own"))
    assert cache_folder() == tmp_path / "own"
    monkeypatch.delenv("OMNIRANGE_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache_folder() == tmp_path / "omnirange"
    monkeypatch.setenv("OMNIRANGE_CACHE_LIMIT_MB", "1.5")
    assert limit_bytes() == 1.5 * 2**20
    monkeypatch.setenv("OMNIRANGE_CACHE_LIMIT_MB", "much")
    with pytest.raises(InputError, match="OMNIRANGE_CACHE_LIMIT_MB: must be a number of megabytes; found 'much'"):
        limit_bytes()


def test_a_trial_does_not_know_of_it(tmp_path: Path) -> None:
    trial = load_experiment(str(write_small(tmp_path / "small.toml"))).trial
    plain = run_trial(trial, StageCache())
    for _ in range(2):  # filling it, and filled
        cached = run_trial(trial, StageCache(backing={"render": RenderCache(tmp_path, 10**7)}))
        assert all(a.tobytes() == b.tobytes() for a, b in zip(plain.images, cached.images, strict=True))
        assert plain.range_m.tobytes() == cached.range_m.tobytes()


def test_files_of_the_users_own_in_the_folder_stay(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A folder `renders` may be a user's, and so may `kernels`, and `omnirange` in NUMBA_CACHE_DIR."""
    own = [tmp_path / "renders" / name for name in ("mine.npy", "mine.partial", f"{'0' * 63}.npy")]
    own += [tmp_path / "kernels" / f"{number}" / "main.cu" for number in range(compiled.VERSIONS_ON_DISK + 3)]
    for each in own:
        each.parent.mkdir(parents=True, exist_ok=True)
        each.write_text("mine")
        os.utime(each, (0, 0))
    cache = RenderCache(tmp_path, 3000)
    for number in range(20):  # several times the limit
        cache.get(number, Maker())
    assert cache.contents().bytes <= 3000
    cache.clear()
    assert cache.contents().files == 0
    state = tmp_path / "kernels" / ("0" * 32)
    (state / "code").mkdir(parents=True)
    monkeypatch.setattr(compiled, "folder", lambda: state)
    compiled._prune(state)
    assert compiled.contents()[1] == 1
    compiled.clear()
    assert sorted(path for path in tmp_path.rglob("*") if path.is_file()) == sorted(own)
    assert not state.exists()


@pytest.mark.slow
def test_command(tmp_path: Path) -> None:
    write_small(tmp_path / "small.toml")
    assert "0 renders, 0.0 MB of at most 2048 MB" in omnirange(tmp_path, "cache").stdout
    assert omnirange(tmp_path, "run", "small.toml", "--no-report").returncode == 0
    shown = omnirange(tmp_path, "cache").stdout
    assert shown.startswith(f"{tmp_path / 'cache' / 'renders'}: 2 renders, 0.1 MB")
    assert "0 renders" in omnirange(tmp_path, "cache", "--clear").stdout
    assert not list((tmp_path / "cache" / "renders").iterdir())


@pytest.mark.parametrize("content", [b"x" * 99, b"", "other type", "object", "other name"])
def test_what_answers_to_its_checksum_and_is_no_image_is_made_anew(tmp_path: Path, content: bytes | str) -> None:
    """Somebody has computed the checksum, or copied another image's file here."""
    cache, make = RenderCache(tmp_path, 10**6), Maker()
    cache.get("key", make)
    path = only_file(tmp_path)
    if content == "other name":
        cache.get("other", Maker(2 * IMAGE))
        (other,) = set(path.parent.iterdir()) - {path}
        path.write_bytes(other.read_bytes())
    else:
        stream = io.BytesIO()
        if content == "other type":
            np.save(stream, np.arange(3))
        elif content == "object":
            np.save(stream, np.array([{}]), allow_pickle=True)
        data = stream.getvalue() if isinstance(content, str) else content
        path.write_bytes(hashlib.sha256(path.name.encode() + data).digest() + data)
    assert np.array_equal(RenderCache(tmp_path, 10**6).get("key", make), IMAGE)
    assert make.calls == 2


def test_a_pipe_in_its_place_is_not_waited_for(tmp_path: Path) -> None:
    cache, make = RenderCache(tmp_path, 10**6), Maker()
    cache.get("key", make)
    path = only_file(tmp_path)
    path.unlink()
    os.mkfifo(path)
    assert np.array_equal(cache.get("key", make), IMAGE)


def test_a_cache_that_may_only_be_read_is_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    make = Maker()
    RenderCache(tmp_path, 10**6).get("key", make)

    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(30, "Read-only file system")

    monkeypatch.setattr(os, "utime", refuse)
    assert np.array_equal(RenderCache(tmp_path, 10**6).get("key", make), IMAGE)
    assert make.calls == 1
