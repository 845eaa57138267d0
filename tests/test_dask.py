"""A sweep on Dask: a real scheduler and real workers, started from their command lines, one of them killed."""

import shutil
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import psutil
import pytest
from sweeps import begin, environment, omnirange, rows, wait_for, write_small

pytest.importorskip("distributed")
ROOT = Path(__file__).parent.parent


def free_port() -> int:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return listener.getsockname()[1]


def start(folder: Path, name: str, *arguments: str) -> subprocess.Popen[bytes]:
    """A `dask` command, with a cache of its own, as on another machine."""
    own = folder / name
    own.mkdir()
    with (own / "log").open("wb") as log:
        return subprocess.Popen(
            [sys.executable, "-m", "dask", *arguments],
            cwd=own,
            env=environment(own) | {"PYTHONPATH": str(ROOT)},
            stdout=log,
            stderr=subprocess.STDOUT,
        )


def end(process: subprocess.Popen[bytes]) -> None:
    """Kill a process and its children."""
    try:
        family = [*psutil.Process(process.pid).children(recursive=True), psutil.Process(process.pid)]
    except psutil.NoSuchProcess:
        return
    for each in family:
        each.kill()
    process.wait(timeout=600)


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, list[subprocess.Popen[bytes]]]]:
    folder = tmp_path_factory.mktemp("cluster")
    address = f"tcp://127.0.0.1:{free_port()}"
    with ExitStack() as ends:
        scheduler = ["scheduler", "--host", "127.0.0.1", "--port", address.rpartition(":")[2], "--no-dashboard"]
        ends.callback(end, start(folder, "scheduler", *scheduler))
        workers = []
        for name in ("one", "two"):
            options = ["--nthreads", "1", "--no-dashboard", "--host", "127.0.0.1", "--no-nanny"]
            workers.append(start(folder, name, "worker", address, *options))
            ends.callback(end, workers[-1])
        wait_for_workers(address, 2)
        yield address, workers


def wait_for_workers(address: str, count: int) -> None:
    wait = f"client.wait_for_workers({count}, timeout=60)" if count else "pass"
    program = f"from distributed import Client; client = Client({address!r}, timeout=60); {wait}"
    subprocess.run([sys.executable, "-c", program], check=True, timeout=600, capture_output=True)


@pytest.mark.long
@pytest.mark.slow
def test_a_worker_killed_in_the_middle(tmp_path: Path, cluster: tuple[str, list[subprocess.Popen[bytes]]]) -> None:
    """The scene's picture is on this machine alone, and its folder is gone before the run ends."""
    address, workers = cluster
    home = tmp_path / "home"
    home.mkdir()
    from skimage import data

    shutil.copy(Path(data.__file__).parent / "brick.png", home / "wall.png")
    (home / "room.toml").write_text(
        'name = "room"\n[[objects]]\nkind = "box"\nsize_m = [6.0, 6.0, 6.0]\ninward = true\n'
        'texture = { kind = "image", file = "wall.png", tile_m = 6.0 }\n'
    )
    axes = '[axes]\nscene = ["box", "./room.toml"]\nseed = [1, 2, 3, 4, 5]\n"noise.sigma_grey" = [1.0, 4.0]\n'
    axes += '"matching.window_px" = [5, 7]\n"matching.subpixel" = ["none", "parabola"]\n'
    write_small(home / "far.toml", axes, name="far")

    alone = omnirange(tmp_path, "run", "home/far.toml", "--workers", 1, "--out", "alone", "--no-report")
    assert alone.returncode == 0, alone.stderr

    out = tmp_path / "far"
    process = begin(tmp_path, "run", "home/far.toml", "--dask", address, "--out", out, "--no-report")
    wait_for(out)
    end(workers[0])
    said, complaint = process.communicate(timeout=600)
    assert process.returncode == 0, complaint
    assert "80 of 80 trials run" in said
    assert (out / "trials.csv").read_bytes() == (tmp_path / "alone" / "trials.csv").read_bytes()
    laid_down = list(Path(psutil.Process(workers[1].pid).cwd()).glob("cache/files/*.png"))
    assert len(laid_down) == 1


@pytest.mark.long
@pytest.mark.slow
def test_interrupted_and_resumed_elsewhere(tmp_path: Path, cluster: tuple[str, list[subprocess.Popen[bytes]]]) -> None:
    address, _ = cluster
    write_small(tmp_path / "small.toml", f"[axes]\nseed = {list(range(180))}\n")
    process = begin(tmp_path, "run", "small.toml", "--dask", address, "--out", "out", "--no-report")
    wait_for(tmp_path / "out")
    process.send_signal(2)
    _, said = process.communicate(timeout=600)
    assert process.returncode == 130
    done = len(rows(tmp_path / "out"))
    assert 0 < done < 180
    assert said.split("\n")[-2].startswith(f"omnirange: interrupted; {done} of 180 trials are done and stored")
    assert omnirange(tmp_path, "run", "small.toml", "--out", "out", "--no-report").returncode == 0
    assert omnirange(tmp_path, "run", "small.toml", "--workers", 1, "--out", "one", "--no-report").returncode == 0
    assert (tmp_path / "out" / "trials.csv").read_bytes() == (tmp_path / "one" / "trials.csv").read_bytes()


@pytest.mark.slow
def test_no_workers(tmp_path: Path) -> None:
    address = f"tcp://127.0.0.1:{free_port()}"
    port = address.rpartition(":")[2]
    scheduler = start(tmp_path, "idle", "scheduler", "--host", "127.0.0.1", "--port", port, "--no-dashboard")
    try:
        wait_for_workers(address, 0)
        write_small(tmp_path / "small.toml")
        refused = omnirange(tmp_path, "run", "small.toml", "--dask", address)
    finally:
        end(scheduler)
    assert refused.returncode == 2
    assert refused.stderr == (
        f"omnirange: --dask: the scheduler at '{address}' has no workers; start some with: "
        f"dask worker {address} --nthreads 1\n"
    )
