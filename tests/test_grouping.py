"""Trials are grouped by their settings, never by what a table shows of them."""

import csv
import math
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from specifications import PLAIN, TEXT
from sweeps import write_small

from harness.cli.tables import methods_table
from harness.display import shortened_labels
from harness.evaluation.metric_table import METRICS
from harness.matching.program import Program
from harness.matching.window.settings import WindowMatcher
from harness.report import theme
from harness.report.markup import html
from harness.report.method_styles import methods_of
from harness.report.paired_differences import build_comparison
from harness.report.sections import error_curves, measures
from harness.report.sweep import sweep_of, texts_of
from harness.runs.load import load_experiment
from harness.runs.methods import method_id, method_names
from harness.runs.run import open_run, rows_of, run_experiment, write_tables
from harness.runs.values import identity_of, shown, text_of, value_of
from harness.spec import checked_plain

PLUGIN = """
import numpy as np
from harness.geometry.angles import angle_between

def match(pair, limits, *, tag="", off=0.0, range_m=2.0):
    alpha_2 = angle_between(range_m * pair.directions - pair.t_v1, pair.t_v1)
    return np.minimum(alpha_2 + float(off) + 0.01 * tag.count("b"), 3.1)
"""
ALIKE = "/a/folder/whose/name/is/longer/than/any/table/would/show/of/it/"


@pytest.fixture
def plugin(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """A module of its own for each test, as modules are loaded once."""
    name = f"grouped_{abs(hash(tmp_path)):x}"
    (tmp_path / f"{name}.py").write_text(PLUGIN)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("OMNIRANGE_CACHE", str(tmp_path / "cache"))
    return f"{name}:match"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("key", "values"),
    [
        ("matching.parameters.tag", [f"{ALIKE}a", f"{ALIKE}b"]),
        ("matching.parameters.tag", [f"a{ALIKE}{ALIKE}", f"b{ALIKE}{ALIKE}"]),
        ("matching.parameters.tag", [f"{ALIKE}a{ALIKE}{ALIKE}", f"{ALIKE}b{ALIKE}{ALIKE}"]),
        ("matching.parameters.off", [0.1, 0.1000000001]),
        ("matching.parameters.off", [1e-3, "1e-3"]),
        ("view_2.baseline_m", [0.5, 0.5000001]),
    ],
)
def test_values_that_look_alike_stay_apart(tmp_path: Path, plugin: str, key: str, values: list) -> None:
    experiment = load_experiment(str(write_small(tmp_path / "e.toml")), [f"matching.kind={plugin}"])
    result = run_experiment(experiment.model_copy(update={"axes": {"seed": [1, 2], key: values}}), workers=1)
    swept = sweep_of(result)
    (axis,) = swept.axes
    assert axis.values == values
    assert len(set(axis.texts)) == 2
    assert all(len(text) <= 60 for text in axis.texts)
    measured = measures.all_measures(swept).data
    assert len(measured.rows) == 2
    for value, row in zip(values, measured.rows, strict=True):
        figures = [r.payload["figures"]["range_median_abs_m"] for r in result.rows if r.coordinates[key] == value]
        assert len(figures) == 2
        column = measured.headings.index("range_median_abs_m")
        assert row[column] == pytest.approx(np.mean(figures), rel=1e-12)  # the same sum, in another order
    assert result.cells["quiet"].nunique() == 4
    with theme.style():
        for figure in error_curves.swept_figures(swept, 2.0)[:1]:
            assert len({row[4] for row in figure.data.rows}) == 2


@pytest.mark.slow
def test_an_axis_with_infinity_is_drawn(tmp_path: Path, plugin: str) -> None:
    experiment = load_experiment(
        str(write_small(tmp_path / "e.toml")), [f"matching.kind={plugin}"], ["matching.d_max_m=5,10,inf"]
    )
    result = run_experiment(experiment, workers=1)
    swept = sweep_of(result)
    assert swept.axes[0].texts == ["5", "10", "inf"]
    with theme.style():
        assert error_curves.swept_figures(swept, 2.0)[0].pictures


PROGRAM = """
import sys, numpy as np
from pathlib import Path
panorama = np.load(Path(sys.argv[1]) / "view_1" / "panorama.npy")
np.save(Path(sys.argv[2]) / "alpha_2.npy", np.full(panorama.shape, {angle}))
"""


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="python3 is not the name of a program there")
def test_two_programs_are_two_methods(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMNIRANGE_CACHE", str(tmp_path / "cache"))
    for name, angle in (("one", 1.7), ("two", 1.9)):
        (tmp_path / f"{name}.py").write_text(PROGRAM.format(angle=angle))
    cases = "".join(
        f'[[cases]]\nname = "program {name}"\n"matching.kind" = "program"\n'
        f'"matching.command" = ["python3", "{name}.py", "{{input}}", "{{output}}"]\n'
        for name in ("one", "two")
    )
    experiment = load_experiment(str(write_small(tmp_path / "e.toml", cases)))
    result = run_experiment(experiment, workers=1)
    assert list(result.summary["comparison"]) == ["program one.py", "program two.py"]
    first, second = result.summary["comparison"].values()
    assert first["range_median_abs_m"] != second["range_median_abs_m"]
    swept = sweep_of(result)
    assert [(method.matcher, method.label) for method in swept.methods] == [
        ("program one.py", "program one"),
        ("program two.py", "program two"),
    ]
    assert not swept.axes
    assert [method.label for method in methods_of(result.outcomes, experiment.planned)] == list(
        result.summary["comparison"]
    )
    assert result.summary["labels"] == {f"program {name}.py": f"program {name}" for name in ("one", "two")}
    assert set(result.cells["matcher"]) == {"program one.py", "program two.py"}
    assert methods_table(result.summary).row_count == 4


@pytest.mark.parametrize(("trials", "title"), [(1, "mine: errors"), (32, "mine, the base trial: errors")])
def test_the_table_of_a_sweep_says_that_it_is_the_base_trials(trials, title) -> None:
    figures = dict.fromkeys(METRICS)
    summary = {
        "experiment": "mine",
        "comparison": {"pixel": figures},
        "comparison_wall": {"pixel": figures},
        "trials": {"total": trials},
    }
    assert str(methods_table(summary).title).startswith(title)


def test_names_of_methods() -> None:
    words = ("{input}", "{output}")
    programs = [
        Program(command=("python3", path, level, *words)) for path in ("/a/m.py", "/b/m.py") for level in ("1", "2")
    ]
    names = method_names([WindowMatcher(), *programs, WindowMatcher(subpixel="none"), WindowMatcher(window_px=5)])
    assert [names[method_id(each)][0] for each in programs] == [
        "program /a/m.py 1",
        "program /a/m.py 2",
        "program /b/m.py 1",
        "program /b/m.py 2",
    ]
    assert names[method_id(WindowMatcher())] == ("window", "parabola")
    assert list(method_names(programs[:1]).values()) == [("program", "own")]
    odd = Program(command=("m", *words))
    assert list(method_names([odd, programs[0]]).values()) == [
        ("program m {input} {output}", "own"),
        ("program python3 /a/m.py 1 {input} {output}", "own"),
    ]


@pytest.mark.slow
@given(st.lists(st.text(max_size=90), min_size=1, max_size=6))
def test_texts_are_told_apart(texts: list[str]) -> None:
    short = shortened_labels(texts, 20)
    assert len(set(short)) == len(texts)
    assert all(len(text) <= 20 for text in short)


def test_texts_are_cut_to_where_they_differ() -> None:
    assert shortened_labels(["short", "x" * 100], 20) == ["short", "x" * 10 + "…" + "x" * 9]
    assert shortened_labels(["x" * 50 + "1" + "y" * 50, "x" * 50 + "2" + "y" * 50], 20) == [
        "…xxxxxx1yy…yyyyyyyyy",
        "…xxxxxx2yy…yyyyyyyyy",
    ]
    assert shortened_labels(["a", "a"], 20) == ["a (1)", "a (2)"]


@given(st.lists(PLAIN.map(checked_plain), min_size=1, max_size=5, unique_by=lambda each: identity_of("x", each)))
def test_texts_of_different_values_differ(values: list) -> None:
    assert len(set(texts_of(values))) == len(values)


@given(PLAIN)
def test_the_text_of_a_value_reads_back(value: object) -> None:
    assert identity_of("matching", value_of(text_of(value))) == identity_of("matching", value)


places = st.tuples(TEXT | st.just("x, b = y"), TEXT | st.just("y, b = z")).map(lambda two: {"a": two[0], "b": two[1]})


@given(places, places)
def test_places_with_other_values_have_other_words(one: dict, other: dict) -> None:
    assert (shown(one) == shown(other)) == (one == other)
    assert shown({"a": "x, b = y", "b": "z"}) != shown({"a": "x", "b": "y, b = z"})


def test_one_number_in_two_types_is_one_value() -> None:
    assert identity_of("noise.sigma_grey", 1) == identity_of("noise.sigma_grey", 1.0)
    assert identity_of("matching.parameters.a", 1) != identity_of("matching.parameters.a", 1.0)
    assert identity_of("scene.objects.0.texture.seed", 2**53) != identity_of("scene.objects.0.texture.seed", 2**53 + 1)
    assert identity_of("a", True) != identity_of("a", 1)
    assert identity_of("a", 0.0) != identity_of("a", -0.0)
    assert identity_of("a", math.inf) == identity_of("a", math.inf)


def written(tmp_path: Path, plugin: str, name: str, axis: list) -> Path:
    experiment = load_experiment(str(write_small(tmp_path / "e.toml")), [f"matching.kind={plugin}"])
    experiment = experiment.model_copy(
        update={"axes": {"view_2.baseline_m": axis, "matching.parameters.tag": ["a", "1"]}}
    )
    folder = tmp_path / name
    folder.mkdir()
    run_experiment(experiment, folder, workers=1)
    with open_run(experiment, folder) as store:
        write_tables(experiment, rows_of(experiment, store), store, folder)
    return folder


@pytest.mark.slow
def test_runs_are_paired_by_values(tmp_path: Path, plugin: str) -> None:
    first = written(tmp_path, plugin, "first", [0.5, 0.75])
    with (first / "trials.csv").open() as stream:
        assert [row["matching.parameters.tag"] for row in csv.DictReader(stream)] == ["a", '"1"'] * 2
    (same,) = build_comparison(first, written(tmp_path, plugin, "second", [0.5, 0.75])).pairings
    assert (same.pairs, same.differing) == (4, {})
    (close,) = build_comparison(first, written(tmp_path, plugin, "third", [0.5, 0.75000000000001])).pairings
    assert close.pairs == 2
    (other,) = build_comparison(
        first, written(tmp_path, plugin, "fourth", [0.50000000000001, 0.75000000000001])
    ).pairings
    assert other.pairs == 0
    assert other.differing == {"view_2.baseline_m": ("0.5, 0.75", "0.50000000000001, 0.75000000000001")}


@pytest.mark.slow
@pytest.mark.parametrize("coupled", [True, False])
def test_the_caption_of_settings_that_change_together_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, coupled: bool
) -> None:
    monkeypatch.setenv("OMNIRANGE_CACHE", str(tmp_path / "cache"))
    product = '[axes]\n"noise.sigma_grey" = [0.0, 4.0]\n"matching.window_px" = [5, 7]\n'
    file = write_small(tmp_path / "e.toml", product)
    sweep = sweep_of(run_experiment(load_experiment(str(file)), workers=1))
    if coupled:  # as in runs of the last version, whose cases had no name and a column for each key
        diagonal = sweep.trials["noise.sigma_grey"] == sweep.trials["matching.window_px"]
        sweep = replace(sweep, trials=sweep.trials[diagonal])
    figures = [each for each in error_curves.swept_figures(sweep, 2.0) if each.id != "sweep-range"]
    assert [each.coupled for each in figures] == [coupled, coupled]
    said = "No setting of the other axes has an error at every value"
    captions = [html(error_curves._ERRORS, swept=each, several=True, axes=2) for each in figures]
    assert [said in caption for caption in captions] == [coupled, coupled]
