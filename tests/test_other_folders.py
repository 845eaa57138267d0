"""No command writes over files of another's, or of one's own, that have the names of its files."""

import os
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import harness
from harness.api.masks import OF_A_MASK, write_mask
from harness.api.sequence import OF_A_SEQUENCE
from harness.api.warping import OF_A_VIEW
from harness.cli import main
from harness.cli.map import OF_A_MAP
from harness.errors import InputError
from harness.files import PAGE_MARK, PICTURE_MARK, OwnFiles, check_no_others, write
from harness.mapping.map_files import write_map
from harness.mapping.occupancy import Cell, GridFrame
from harness.pipeline.photographs import OF_A_RANGE

SENSOR = {"camera": {"width_px": 200, "height_px": 150, "focal_px": 191.9, "cx_px": 99.5, "cy_px": 74.5}}


@pytest.fixture(scope="module")
def pair(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pair")
    for number, x in enumerate((0.0, 0.5)):
        view = harness.render("box", sensor=SENSOR, position_m=(x, 0.0, 1.0), samples=1)
        view.write(folder / str(number))
    return folder


def arguments(pair, name, out):
    more = {"range": [], "warp": ["--to", "0.2", "0", "0"], "scan": ["--height", "1"], "map": ["--height", "1"]}[name]
    images = [str(pair / each / "omni.png") for each in "01"]
    sensor = ["--sensor", str(pair / "0" / "sensor.toml"), "--baseline", "0.5", "0", "0", "--matcher", "sgm"]
    return [name, *images, *sensor, *more, "--out", str(out)]


WHAT = {"range": "range of two images", "warp": "warped view", "scan": "scan", "map": "map"}


@pytest.mark.parametrize(
    ("name", "files"),
    [
        ("range", ["range.npy"]),
        ("range", ["range.json", "points.ply"]),
        ("warp", ["range.npy"]),
        ("warp", ["README.txt"]),
        ("warp", ["state.npy", "view.png"]),
        ("scan", ["scan.csv"]),
        ("scan", ["scan.json", "scan.ply"]),
        ("map", ["map.yaml"]),
        ("map", ["pairs.csv", "map.png"]),
    ],
)
def test_what_has_the_name_of_a_file_is_kept(name, files, pair, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(harness, "estimate_range", None)  # it is told before anything is matched
    for each in files:
        (tmp_path / each).write_text('{"mine": 1}')
    assert main(arguments(pair, name, tmp_path)) == 2
    problem = f"is there already, and nothing shows that it is from an earlier {WHAT[name]}; give another folder"
    said = [f"omnirange: {tmp_path / each}: --out: {problem}\n" for each in files]
    assert capsys.readouterr().err in said
    assert {each.name: each.read_text() for each in tmp_path.iterdir()} == dict.fromkeys(files, '{"mine": 1}')


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "marked", "other"),
    [
        pytest.param("range", "range.json", "across.csv", marks=pytest.mark.long),
        pytest.param("warp", "README.txt", None, marks=pytest.mark.long),
        ("scan", "scan.json", "scan.csv"),
    ],
)
@pytest.mark.usefixtures("undrawn")
def test_ones_own_results_are_written_again_though_cut_short(name, marked, other, pair, tmp_path, capsys):
    words = arguments(pair, name, tmp_path)
    assert main(words) == 0
    whole = {each.name: each.stat().st_size for each in tmp_path.iterdir()}
    for size in (whole[marked] // 2, whole[marked] // 2 if other is None else 5):
        (tmp_path / marked).write_bytes((tmp_path / marked).read_bytes()[:size])
        assert main(words) == 0
    assert {each.name: each.stat().st_size for each in tmp_path.iterdir()} == whole
    for each in whole.keys() - {marked}:
        (tmp_path / each).write_bytes(b"")
    assert main(words) == 0
    if other is not None:  # among our files, too
        (tmp_path / other).write_text("mine")
        assert main(words) == 2
        assert f"{tmp_path / other}: --out: is there already" in capsys.readouterr().err
        assert (tmp_path / other).read_text() == "mine"


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_a_sequence_and_a_pair_do_not_replace_each_other(pair, tmp_path, capsys):
    one, many = tmp_path / "one", tmp_path / "many"
    pair_words = arguments(pair, "range", one)
    words = arguments(pair, "range", many)
    words.insert(3, words[1])
    assert main(pair_words) == main(words) == 0
    before = {each: each.read_bytes() for each in tmp_path.rglob("*.*")}
    for given, what, out in ((pair_words, "range of two images", many), (words, "range of a sequence", one)):
        capsys.readouterr()
        assert main([*given[:-1], str(out)]) == 2
        assert capsys.readouterr().err == (
            f"omnirange: {out / 'range.html'}: --out: is there already, and nothing shows that it is from an earlier "
            f"{what}; give another folder\n"
        )
    assert {each: each.read_bytes() for each in tmp_path.rglob("*.*")} == before
    assert main(words) == 0  # its own is written again


@pytest.mark.parametrize("name", ["sequence.json", "points.ply", "0000/range.npy", "0001/pair.json"])
def test_a_sequence_replaces_and_removes_nothing_of_ones_own(name, pair, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(harness.api.sequence, "estimate_range", None)
    own = tmp_path / name
    own.parent.mkdir(exist_ok=True)
    own.write_text("mine")
    words = arguments(pair, "range", tmp_path)
    words.insert(3, words[1])
    assert main(words) == 2
    assert f"omnirange: {own}: --out: is there already, and nothing shows" in capsys.readouterr().err
    assert own.read_text() == "mine"


@pytest.mark.long
@pytest.mark.slow
def test_a_mask_of_ones_own_is_kept(pair, tmp_path, capsys):
    own = tmp_path / "mask.png"
    Image.fromarray(np.full((150, 200), 255, np.uint8)).save(own)
    before = own.read_bytes()
    words = [*arguments(pair, "range", tmp_path), "--mask", "auto"]
    assert main(words) == 2
    assert capsys.readouterr().err == (
        f"omnirange: {own}: --out: is there already, and nothing shows that it is from an earlier mask of what moves "
        "with the camera; give another folder\n"
    )
    assert own.read_bytes() == before
    write_mask(np.ones((150, 200), bool), own)  # as a command that was interrupted leaves it
    assert main(words) == 0


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_an_image_that_is_read_is_not_replaced(pair, tmp_path, capsys):
    out = tmp_path / "w"
    assert main(arguments(pair, "warp", out)) == 0
    before = (out / "view.png").read_bytes()
    words = arguments(pair, "warp", out)
    words[1] = str(out / "view.png")
    assert main(words) == 2
    assert f"{out / 'view.png'}: --out: would be written over, and is read" in capsys.readouterr().err
    assert (out / "view.png").read_bytes() == before


@pytest.mark.parametrize("command", ["range", "scan", "warp", "map", "render", "score"])
def test_a_folder_that_cannot_be_is_told_before_the_work(command, pair, tmp_path, capsys, monkeypatch):
    for work in ("estimate_range", "render", "open_dataset"):
        monkeypatch.setattr(harness, work, None)
    (tmp_path / "file").write_text("mine")
    out = tmp_path / "file" / "out"
    if command == "render":
        words = ["render", "box", "--at", "0", "0", "1", "--out", str(out)]
    elif command == "score":
        words = ["score", str(tmp_path), "--truth", str(tmp_path), "--out", str(out)]
    else:
        words = arguments(pair, command, out)
    assert main(words) == 2
    why = f"{tmp_path / 'file'} is no folder"
    said = f"omnirange: {out}: --out: cannot be used as the output folder ({why})\n"
    assert capsys.readouterr().err == said


def test_scores_replace_nothing_of_ones_own(tmp_path, capsys):
    own = tmp_path / "scores.csv"
    own.write_text("student,score\n")
    assert main(["score", "est", "--truth", "set", "--out", str(tmp_path)]) == 2
    assert capsys.readouterr().err == (
        f"omnirange: {own}: --out: is there already, and nothing shows that it is from an earlier score; "
        "give another folder\n"
    )
    assert own.read_text() == "student,score\n"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "name"),
    [(["design"], "design.html"), (["sensor", "s.toml"], "sensor.html"), (["compare", "a", "b"], "b/comparison.html")],
)
@pytest.mark.usefixtures("undrawn")
def test_a_page_whose_name_nobody_gave_replaces_none_of_ones_own(words, name, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "s.toml").write_text("[camera]\nfocal_px = 614.0\n")
    own = tmp_path / name
    own.parent.mkdir(exist_ok=True)
    own.write_text("<!DOCTYPE html>\n<title>Mine</title>")
    assert main(words) == 2
    assert capsys.readouterr().err == (
        f"omnirange: {name}: is there already, and nothing shows that it is from an earlier page of this program; "
        "give another name with --out\n"
    )
    assert own.read_text() == "<!DOCTYPE html>\n<title>Mine</title>"
    if words[0] != "compare":
        own.unlink()
        assert main(words) == main(words) == 0


def test_every_page_says_whose_it_is():
    folder = Path(harness.__file__).parent / "report" / "templates"
    pages = [each for each in folder.glob("*.j2") if "<!DOCTYPE html>" in each.read_text(encoding="utf-8")]
    assert len(pages) >= 8
    assert all(PAGE_MARK in each.read_bytes() for each in pages)


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_a_rendered_views_ranges_are_no_estimates(pair):
    before = (pair / "0" / "range.npy").read_bytes()
    images = [pair / each / "omni.png" for each in "01"]
    sensor = harness.load_sensor(pair / "0" / "sensor.toml")
    estimate = harness.estimate_range(*images, sensor, (0.5, 0.0, 0.0), "sgm")
    view = harness.warp_view(estimate, (0.2, 0.0, 0.0))
    for made in (estimate, view):
        with pytest.raises(InputError, match=r"--out: is there already"):
            made.write(pair / "0")
    assert (pair / "0" / "range.npy").read_bytes() == before
    for _ in range(2):  # its own folder is written again, and not by another
        estimate.write(pair / "range")
    with pytest.raises(InputError, match=r"range\.npy: --out: is there already"):
        view.write(pair / "range")
    np.testing.assert_array_equal(np.load(pair / "range" / "range.npy"), estimate.range_m)


def test_one_image_for_two_views(pair, tmp_path, capsys):
    words = arguments(pair, "range", tmp_path / "out")
    words[2] = words[1]
    assert main(words) == 2
    said = f"omnirange: {words[1]}: is given for two views in a row; give the image of each\n"
    assert capsys.readouterr().err == said


@pytest.mark.parametrize(
    ("own", "names"),
    [
        (OF_A_RANGE, {"range.json": "", "range.html": "<!DOCTYPE html>\n<title>Range from two mirror images</title>"}),
        (OF_A_SEQUENCE, {"sequence.json": "[\n  {", "range.html": PAGE_MARK.decode() + ' sequence">'}),
        (OF_A_VIEW, {"README.txt": "view", "view.png": PICTURE_MARK.decode()}),
        (OF_A_MAP, {"pairs.csv": "left,", "map.png": PICTURE_MARK.decode()}),
    ],
)
def test_what_was_emptied_or_cut_short_is_known_by_what_is_beside_it(own, names, tmp_path):
    (tmp_path / next(name for name, mark in own.marks.items() if mark is None and name not in names)).write_text("1")
    for name, text in names.items():
        (tmp_path / name).write_text(text)
    check_no_others(tmp_path, own)
    (tmp_path / list(names)[1]).write_text("1")
    with pytest.raises(InputError, match="is there already, and nothing shows"):
        check_no_others(tmp_path, own)


def test_pictures_say_whose_they_are(tmp_path):
    write_mask(np.ones((3, 4), bool), tmp_path / "mask.png")
    write_map(np.full((3, 4), Cell.FREE, np.uint8), GridFrame((0.0, 0.0), 0.1, (3, 4)), tmp_path)
    for own in (OF_A_MASK, OF_A_MAP):
        assert own.are_in(tmp_path)
        check_no_others(tmp_path, own)


def test_a_file_is_known_by_how_it_begins(tmp_path):
    """Somebody's table may have a column of the same name further on."""
    own = OwnFiles("run", {"trials.csv": b"state,"})
    (tmp_path / "trials.csv").write_text("country,state,city\n")
    with pytest.raises(InputError, match=r"trials\.csv: --out: is there already"):
        check_no_others(tmp_path, own)
    (tmp_path / "trials.csv").write_text("state,seed\n")
    check_no_others(tmp_path, own)


def test_what_is_no_file_is_not_replaced(tmp_path):
    own = OwnFiles("scan", {"a": b"a,b", "b": None})
    (tmp_path / "a").write_text("a,b")
    (tmp_path / "b").symlink_to("nowhere")
    with pytest.raises(InputError, match="b: --out: is there already"):
        check_no_others(tmp_path, own)
    (tmp_path / "b").unlink()
    (tmp_path / "b").mkdir()
    with pytest.raises(InputError, match="b: --out: is there already"):
        check_no_others(tmp_path, own)


def test_a_link_that_leads_nowhere_is_called_so(tmp_path, capsys):
    (tmp_path / "link").symlink_to("nowhere")
    for out, what in ((tmp_path / "link", "it"), (tmp_path / "link" / "out", tmp_path / "link")):
        for more in ([], ["--dry-run"]):
            assert main(["run", "smoke", "--out", str(out), *more]) == 2
            problem = f"cannot be used as the output folder ({what} is a link that leads nowhere)"
            assert capsys.readouterr().err == f"omnirange: {out}: --out: {problem}\n"


def test_what_is_write_protected_stays(tmp_path, capsys, monkeypatch):
    """A rename would replace it all the same."""
    page = tmp_path / "mine.html"
    page.write_text("mine")
    may = os.access
    monkeypatch.setattr(os, "access", lambda path, mode: Path(path) != page and may(path, mode))  # root may all
    assert main(["design", "--out", str(page)]) == 2
    problem = "--out: is write-protected; give another place, or allow writing"
    assert capsys.readouterr().err == f"omnirange: {page}: {problem}\n"
    with pytest.raises(InputError, match="is write-protected"):
        write(page, "ours")
    with pytest.raises(InputError, match=r"mine\.html: --out: is write-protected"):
        check_no_others(tmp_path, OwnFiles("page", {"mine.html": b"mine"}))
    assert [each.name for each in tmp_path.iterdir()] == ["mine.html"]
    assert page.read_text() == "mine"
