"""The maps of a trial: the same numbers as the trial's own, in memory, in a file, and in a run that was resumed."""

import builtins
import dataclasses
import re
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
from sweeps import write_small

from harness.cli import main
from harness.errors import InputError
from harness.pipeline import maps as maps_module
from harness.pipeline.maps import MAPS, README, TrialMaps, has_maps, maps_file, maps_of, read_maps, write_maps
from harness.pipeline.specification import Trial
from harness.pipeline.trial import Outcome, run_trial
from harness.runs.executors import Backend
from harness.runs.load import load_experiment
from harness.runs.run import run_plan, run_status
from harness.runs.store import Store
from harness.spec import parse


@pytest.fixture(scope="module")
def outcome(tmp_path_factory: pytest.TempPathFactory) -> Outcome:
    path = write_small(tmp_path_factory.mktemp("maps") / "small.toml", "[trial.noise]\nsigma_grey = 2.0\n")
    return run_trial(load_experiment(str(path)).trial)


@pytest.fixture(scope="module")
def maps(outcome: Outcome) -> TrialMaps:
    return maps_of(outcome)


def test_errors_are_those_that_the_trial_was_scored_by(outcome: Outcome, maps: TrialMaps) -> None:
    assert np.array_equal(maps.range_error_m, outcome.errors.range_m, equal_nan=True)
    assert np.array_equal(maps.alpha_2_error, outcome.errors.alpha_2, equal_nan=True)
    assert np.array_equal(maps.disparity_error_px, outcome.errors.disparity_px, equal_nan=True)
    assert np.array_equal(maps.valid, outcome.valid)
    assert maps.domain.sum() == outcome.reference.domain.sum()


def test_sigma_of_the_range_is_that_of_a_shifted_angle(maps: TrialMaps) -> None:
    """d_1 = |t| sin(alpha_2)/sin(alpha_2 - alpha_1), moved by a hundredth of sigma to either side."""
    baseline = maps.trial.true_motion.baseline_m
    step = 0.01 * maps.sigma_alpha_2

    def ranged(alpha_2: np.ndarray) -> np.ndarray:
        return baseline * np.sin(alpha_2) / np.sin(alpha_2 - maps.alpha_1)

    slope = (ranged(maps.alpha_2 + step) - ranged(maps.alpha_2 - step)) / (2 * step)
    there = maps.domain & np.isfinite(maps.sigma_range_m)
    assert there.sum() > 1000
    # The central difference is off by the third derivative: (step/(alpha_2 - alpha_1))² of the whole, below 1e-3 here.
    expected = np.abs(slope * maps.sigma_alpha_2)[there]
    assert np.allclose(maps.sigma_range_m[there], expected, rtol=1e-3)


def test_maps_cannot_be_written_to(maps: TrialMaps) -> None:
    with pytest.raises(ValueError, match="read-only"):
        maps.range_m[0, 0] = 1.0


def test_a_file_gives_the_same_maps_back(maps: TrialMaps, tmp_path: Path) -> None:
    write_maps(maps, tmp_path)
    back = read_maps(tmp_path, maps.trial)
    assert back is not None
    for name in MAPS:
        one, other = getattr(maps, name), getattr(back, name)
        assert one.dtype == other.dtype
        assert np.array_equal(one, other, equal_nan=one.dtype.kind == "f")
    first = maps_file(tmp_path, maps.key).read_bytes()
    write_maps(maps, tmp_path)
    assert maps_file(tmp_path, maps.key).read_bytes() == first


def test_the_text_beside_the_files_names_every_array(maps: TrialMaps, tmp_path: Path) -> None:
    write_maps(maps, tmp_path)
    with np.load(maps_file(tmp_path, maps.key), allow_pickle=False) as archive:
        assert all(re.search(rf"^{name} ", README, re.MULTILINE) for name in archive.files)
        height, width = maps.grid.shape
        assert archive["phi"].shape == (width,)
        assert archive["z"].shape == (height,)
        assert parse(Trial, tomllib.loads(str(archive["settings"]))) == maps.trial
        assert archive["baseline_m"] == pytest.approx(0.5, abs=1e-15)
        assert all(archive[name].shape == (height, width) for name in MAPS)


@pytest.mark.parametrize("harm", ["cut short", "empty", "other code", "missing", "changed", "another trial's"])
def test_a_file_that_is_damaged_or_stale_is_not_read(
    harm: str, maps: TrialMaps, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_maps(maps, tmp_path)
    file = maps_file(tmp_path, maps.key)
    if harm == "cut short":
        file.write_bytes(file.read_bytes()[:-1000])
    elif harm == "empty":
        file.write_bytes(b"")
    elif harm == "other code":
        monkeypatch.setattr(maps_module, "code_hash", lambda: "another")
    elif harm == "changed":
        data = bytearray(file.read_bytes())
        data[len(data) // 4] ^= 0xFF
        file.write_bytes(data)
    elif harm == "another trial's":
        write_maps(dataclasses.replace(maps, key="0" * 16), tmp_path)
        maps_file(tmp_path, "0" * 16).replace(file)
    else:
        file.unlink()
    assert not has_maps(tmp_path, maps.key)
    assert read_maps(tmp_path, maps.trial) is None


def test_damage_inside_an_array_is_noticed(maps: TrialMaps, tmp_path: Path) -> None:
    write_maps(maps, tmp_path)
    file = maps_file(tmp_path, maps.key)
    data = bytearray(file.read_bytes())
    data[len(data) // 4] ^= 0xFF
    file.write_bytes(data)
    assert read_maps(tmp_path, maps.trial) is None


@pytest.mark.slow
def test_a_run_keeps_maps_also_of_trials_that_were_done_before(tmp_path: Path) -> None:
    path = write_small(tmp_path / "small.toml", "[axes]\nseed = [1, 2]\n")
    trials = [each.trial for each in load_experiment(str(path)).planned]
    out = tmp_path / "out"
    command = ["run", str(path), "--out", str(out), "--no-report", "--workers", "1"]
    assert main(command) == 0
    rows = (out / "trials.csv").read_bytes()
    assert not (out / "maps").exists()
    assert main([*command, "--keep-arrays"]) == 0
    assert (out / "trials.csv").read_bytes() == rows
    assert (out / "maps" / "README.txt").read_text(encoding="utf-8") == README
    for trial in trials:
        stored, anew = read_maps(out / "maps", trial), maps_of(run_trial(trial))
        assert stored is not None
        assert np.array_equal(stored.range_m, anew.range_m, equal_nan=True)
    written = maps_file(out / "maps", trials[0].key).stat().st_mtime_ns
    maps_file(out / "maps", trials[1].key).unlink()
    assert main([*command, "--keep-arrays"]) == 0  # the one that is missing, and no other
    assert maps_file(out / "maps", trials[1].key).is_file()
    assert maps_file(out / "maps", trials[0].key).stat().st_mtime_ns == written


@pytest.mark.slow
def test_workers_keep_maps_too(tmp_path: Path) -> None:
    path = write_small(tmp_path / "small.toml", "[axes]\nseed = [1, 2]\n")
    out = tmp_path / "out"
    assert main(["run", str(path), "--out", str(out), "--no-report", "--workers", "2", "--keep-arrays"]) == 0
    for each in load_experiment(str(path)).planned:
        assert has_maps(out / "maps", each.key)


def test_maps_are_not_kept_by_workers_on_a_cluster(tmp_path: Path) -> None:
    experiment = load_experiment(str(write_small(tmp_path / "small.toml")))
    with Store() as store:
        left = run_status(experiment, store, tmp_path).plan
        remote = Backend(lambda: None, workers=1, slots=1, remote=True)
        with pytest.raises(InputError, match="--keep-arrays: writes into a folder of this machine"):
            run_plan(left, store, remote, maps=tmp_path)


def test_xarray(maps: TrialMaps, monkeypatch: pytest.MonkeyPatch) -> None:
    data = maps.to_xarray()
    assert data.range_m.dims == ("z", "phi")
    assert data.range_m.attrs["units"] == "m"
    assert np.array_equal(data.range_error_m.values, maps.range_error_m, equal_nan=True)
    assert float(data.phi[0]) == pytest.approx(-np.pi + np.pi / maps.grid.width_px)
    assert data.attrs["key"] == maps.key
    real = builtins.__import__

    def without_xarray(name: str, *rest: object) -> object:
        if name == "xarray":
            raise ImportError(name)
        return real(name, *rest)

    monkeypatch.delitem(sys.modules, "xarray")
    monkeypatch.setattr(builtins, "__import__", without_xarray)
    with pytest.raises(ImportError, match=r"to_xarray needs xarray: pip install 'omnirange\[xarray\]'"):
        maps.to_xarray()


def test_maps_show_themselves_as_pictures(maps: TrialMaps) -> None:
    shown = maps._repr_html_()
    assert shown.count("data:image/png;base64,") == 2
    assert len(shown) < 300_000
    assert repr(maps).startswith("TrialMaps(key='")
    assert "\n" not in repr(maps)
