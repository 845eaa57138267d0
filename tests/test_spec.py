"""What a user is told when a file is wrong, and that specifications survive a trip through TOML.

The specifications here are made up: the rules hold for every one built on `Spec`.
"""

import math
import tomllib
from pathlib import Path
from typing import Annotated, Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import Field, ValidationError, model_validator

from harness import shipped
from harness.errors import InputError, nearest
from harness.spec import LARGEST, Finite, Positive, Spec, Vector3, dump_toml, load, parse
from harness.toml import read_toml


class Plain(Spec):
    kind: Literal["plain"] = "plain"
    grey: Annotated[float, Field(ge=0, le=1)] = 0.5


class Noise(Spec):
    kind: Literal["noise"]
    sigma_m: Positive
    seed: int = 0


Texture = Annotated[Plain | Noise, Field(discriminator="kind")]


class Box(Spec):
    kind: Literal["box"]
    size_m: Vector3
    texture: Texture = Plain()


class Ball(Spec):
    kind: Literal["ball", "sphere"]
    radius_m: Positive

    @model_validator(mode="after")
    def _small(self) -> "Ball":
        if self.radius_m > 100:
            raise ValueError("radius_m must fit into a room; use at most 100")
        return self


Thing = Annotated[Box | Ball, Field(discriminator="kind")]


class Scene(Spec):
    objects: tuple[Thing, ...] = ()
    named: dict[str, Thing] = Field(default={})
    name: str = "room"
    quality: Literal["fast", "slow"] = "fast"
    samples: Annotated[int, Field(ge=1)] = 1
    closed: bool = True
    grid: tuple[tuple[Finite, ...], ...] = ()
    span_m: tuple[Finite, Finite] | Literal["auto"] = "auto"
    turn_deg: Literal["none"] | tuple[Finite, Finite] = "none"
    spare: Box | None = None
    shape: Plain | Ball | str = "none"


BOX = {"kind": "box", "size_m": [1.0, 2.0, 3.0]}

WRONG = [
    # unknown key: the nearest valid one, or all of them
    ({"nmae": "x"}, "nmae: unknown key 'nmae'; did you mean 'name'?"),
    ({"objects": [BOX, {"kind": "sphere", "raduis": 1}]},
     "objects[1].raduis: unknown key 'raduis'; did you mean 'radius_m'?"),
    ({"objects": [{**BOX, "texture": {"kind": "plain", "q": 1}}]},
     "objects[0].texture.q: unknown key 'q'; valid: grey, kind"),
    ({"spare": {**BOX, "siz": 1}}, "spare.siz: unknown key 'siz'; did you mean 'size_m'?"),
    # missing key
    ({"objects": [{"kind": "ball"}]}, "objects[0].radius_m: this key is missing"),
    ({"named": {"left.wall": {"kind": "box"}}}, 'named."left.wall".size_m: this key is missing'),
    # tag of a union
    ({"objects": [BOX, {**BOX, "texture": {"kind": "nois"}}]},
     "objects[1].texture.kind: unknown kind 'nois'; did you mean 'noise'?"),
    ({"objects": [{**BOX, "texture": {"sigma_m": 1}}]},
     "objects[0].texture.kind: this key is missing; valid: noise, plain"),
    ({"objects": [{"kind": 3}]}, "objects[0].kind: unknown kind '3'; valid: box, ball, sphere"),
    ({"named": {"box": {"kind": "bxo"}}}, "named.box.kind: unknown kind 'bxo'; did you mean 'box'?"),
    # wrong type
    ({"name": 3}, "name: must be text in quotes; found 3"),
    ({"name": {"first": "x"}}, "name: must be text in quotes; found a table"),
    ({"samples": "many"}, "samples: must be a whole number; found 'many'"),
    ({"samples": 1.5}, "samples: must be a whole number; found 1.5"),
    ({"closed": "perhaps"}, "closed: must be true or false; found 'perhaps'"),
    ({"objects": BOX}, "objects: must be a list; found a table"),
    ({"objects": [BOX, 3]}, "objects[1]: must be a table; found 3"),
    ({"objects": [{**BOX, "size_m": [1, 2]}]}, "objects[0].size_m: must be a list of 3; found a list of 2"),
    ({"objects": [{**BOX, "size_m": [1, 2, "x"]}]}, "objects[0].size_m[2]: must be a number; found 'x'"),
    ({"grid": [[1, 2], [3, "x"]]}, "grid[1][1]: must be a number; found 'x'"),
    ({"spare": 3}, "spare: must be a table; found 3"),
    # types that pydantic itself would wave through
    ({"samples": "3"}, "samples: must be a whole number; found '3'"),
    ({"samples": True}, "samples: must be a whole number; found true"),
    ({"closed": 1}, "closed: must be true or false; found 1"),
    ({"grid": [[1.0, "2"]]}, "grid[0][1]: must be a number; found '2'"),
    # out of range
    ({"samples": 0}, "samples: must be at least 1; found 0"),
    ({"samples": math.nan}, "samples: must be a finite number; found nan"),
    ({"samples": 1e308}, "samples: must be a whole number; found 1e+308"),
    ({"samples": False}, "samples: must be a number; found false"),
    ({"objects": [{**BOX, "texture": {"kind": "noise", "sigma_m": -1}}]},
     "objects[0].texture.sigma_m: must be above 0; found -1"),
    ({"objects": [{**BOX, "texture": {"kind": "noise", "sigma_m": "0"}}]},
     "objects[0].texture.sigma_m: must be above 0; found '0'"),
    ({"objects": [{**BOX, "texture": {"kind": "noise", "sigma_m": 1e-300}}]},
     "objects[0].texture.sigma_m: must be at least 1e-09; found 1e-300"),
    ({"objects": [{**BOX, "size_m": [1, -1e300, 2]}]}, "objects[0].size_m[1]: must be at least -1e+09; found -1e+300"),
    ({"objects": [{**BOX, "texture": {"kind": "plain", "grey": 1.5}}]},
     "objects[0].texture.grey: must be at most 1; found 1.5"),
    ({"objects": [{**BOX, "size_m": [1, math.nan, 2]}]}, "objects[0].size_m[1]: must be a finite number; found nan"),
    ({"quality": "fats"}, "quality: 'fats' is not valid; did you mean 'fast'?"),
    ({"quality": 3}, "quality: must be 'fast' or 'slow'; found 3"),
    ({"objects": [{"kind": "ball", "radius_m": 1e3}]}, "objects[0]: radius_m must fit into a room; use at most 100"),
    # a union without a tag: all that it may be, or the member that got furthest
    ({"span_m": "aut"}, "span_m: must be a list or 'auto'; found 'aut'"),
    ({"span_m": [1]}, "span_m: must be a list of 2; found a list of 1"),
    ({"turn_deg": [1, "x"]}, "turn_deg[1]: must be a number; found 'x'"),
    ({"shape": 3}, "shape: must be a table or text in quotes; found 3"),
]  # fmt: skip


@pytest.mark.parametrize(("table", "message"), WRONG, ids=[message.split(";")[0] for _, message in WRONG])
def test_message_names_file_place_and_remedy(table: dict, message: str) -> None:
    with pytest.raises(InputError) as caught:
        parse(Scene, table, file="scene.toml")
    assert str(caught.value) == f"scene.toml: {message}"


def test_misspelt_key_is_told_before_the_key_that_it_leaves_missing() -> None:
    with pytest.raises(InputError, match="unknown key 'sigma'; did you mean 'sigma_m'"):
        parse(Noise, {"kind": "noise", "sigma": 1})


def test_place_of_the_table_inside_its_file_leads_the_key() -> None:
    with pytest.raises(InputError) as caught:
        parse(Noise, {"kind": "noise", "sigma_m": 0}, file="a.toml", key="runs[2].noise")
    assert (caught.value.file, caught.value.key) == ("a.toml", "runs[2].noise.sigma_m")


@pytest.mark.parametrize("value", [3, "room.toml", None, [1]])
def test_something_else_in_place_of_a_table(value: object) -> None:
    with pytest.raises(InputError, match=r"^a\.toml: scene: must be a table; found "):
        parse(Scene, value, file="a.toml", key="scene")  # type: ignore[arg-type]


def test_message_is_one_line() -> None:
    with pytest.raises(InputError) as caught:
        parse(Scene, {"name\nof": 1}, file="a.toml")
    assert "\n" not in str(caught.value)


def test_specifications_cannot_be_changed() -> None:
    with pytest.raises(ValidationError):
        Plain().grey = 1.0  # type: ignore[misc]
    assert hash(Plain()) == hash(Plain(grey=0.5)) != hash(Plain(grey=0.25))


def test_whole_numbers_are_taken_for_numbers_and_lists_for_tuples() -> None:
    box = parse(Box, {"kind": "box", "size_m": [1, 2, 3]})
    assert box.size_m == (1.0, 2.0, 3.0)


numbers = st.floats(-LARGEST, LARGEST)
lengths = st.floats(min_value=1 / LARGEST, max_value=100)
textures = st.one_of(
    st.builds(Plain, kind=st.just("plain"), grey=st.floats(0, 1)),
    st.builds(Noise, kind=st.just("noise"), sigma_m=lengths, seed=st.integers(-(2**63), 2**63 - 1)),
)
things = st.one_of(
    st.builds(Box, kind=st.just("box"), size_m=st.tuples(numbers, numbers, numbers), texture=textures),
    st.builds(Ball, kind=st.sampled_from(["ball", "sphere"]), radius_m=lengths),
)
# TOML is UTF-8: it has no lone surrogates, and no carriage return but as a line's end.
text = st.text(st.characters(codec="utf-8"))
scenes = st.builds(
    Scene,
    objects=st.lists(things, max_size=3).map(tuple),
    named=st.dictionaries(text, things, max_size=2),
    name=text,
    closed=st.booleans(),
    span_m=st.one_of(st.just("auto"), st.tuples(numbers, numbers)),
    grid=st.lists(st.lists(numbers, max_size=3).map(tuple), max_size=3).map(tuple),
    spare=st.one_of(st.none(), things.filter(lambda thing: isinstance(thing, Box))),
)


@pytest.mark.slow
@given(scenes)
def test_toml_round_trip_is_exact(scene: Scene) -> None:
    assert parse(Scene, tomllib.loads(dump_toml(scene))) == scene


def test_toml_text_spells_every_default_out() -> None:
    assert tomllib.loads(dump_toml(Plain())) == {"kind": "plain", "grey": 0.5}


def test_load_reads_a_file(tmp_path) -> None:
    path = tmp_path / "noise.toml"
    path.write_text('kind = "noise"\nsigma_m = 0.5\n')
    assert load(Noise, path) == Noise(kind="noise", sigma_m=0.5)


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (None, "no such file"),
        (b"a = \n", "not valid TOML: Invalid value (at line 1, column 5)"),
        (b"a = '\xff'\n", "is no TOML file in UTF-8: byte 0xff in line 1"),
    ],
)
def test_unreadable_file_is_named(tmp_path, content, problem) -> None:
    path = tmp_path / "a.toml"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError) as caught:
        read_toml(path)
    assert str(caught.value).startswith(f"{path}: {problem}")


def test_folder_in_place_of_a_file_is_named(tmp_path) -> None:
    with pytest.raises(InputError, match="is not a regular file"):
        read_toml(tmp_path)


def test_nearest_word_or_all_words() -> None:
    assert nearest("fats", ["fast", "slow"]) == "did you mean 'fast'?"
    assert nearest("zz", ["fast", "slow"]) == "valid: fast, slow"
    assert nearest("zz", []) == "valid: none"


class TestShipped:
    @pytest.fixture(autouse=True)
    def checkout(self, tmp_path, monkeypatch):
        """A checkout with two scenes, and the working directory elsewhere."""
        (tmp_path / "harness").mkdir()
        (tmp_path / "scenes").mkdir()
        for name in ("room", "box"):
            (tmp_path / "scenes" / f"{name}.toml").touch()
        (tmp_path / "elsewhere").mkdir()
        monkeypatch.setattr(shipped, "_PACKAGE", tmp_path / "harness")
        monkeypatch.chdir(tmp_path / "elsewhere")
        return tmp_path

    def test_names_are_sorted(self) -> None:
        assert shipped.names("scenes") == ["box", "room"]

    def test_word_is_a_shipped_name(self, checkout) -> None:
        assert shipped.find("scenes", "box") == checkout / "scenes" / "box.toml"

    def test_installed_package_has_its_own(self, checkout) -> None:
        inside = checkout / "harness" / "_shipped" / "scenes"
        inside.mkdir(parents=True)
        (inside / "hall.toml").touch()
        assert shipped.names("scenes") == ["hall"]
        assert shipped.find("scenes", "hall") == inside / "hall.toml"

    def test_anything_else_is_a_path(self, checkout) -> None:
        own = checkout / "elsewhere" / "box.toml"
        own.touch()
        assert shipped.find("scenes", "box.toml").resolve() == own
        assert shipped.find("scenes", "./box.toml").resolve() == own
        assert shipped.find("scenes", str(own), relative_to=checkout) == own

    def test_path_is_relative_to_the_file_that_names_it(self, checkout) -> None:
        experiments = checkout / "experiments"
        experiments.mkdir()
        result = shipped.find("scenes", "../scenes/room.toml", relative_to=experiments)
        assert result.resolve() == checkout / "scenes" / "room.toml"

    def test_file_of_that_name_comes_before_a_shipped_sensor(self, checkout) -> None:
        """A calibration may have any ending, or none."""
        (checkout / "sensors").mkdir()
        (checkout / "sensors" / "wide.toml").touch()
        assert shipped.or_shipped("sensors", Path("wide")) == checkout / "sensors" / "wide.toml"
        assert shipped.or_shipped("sensors", Path("wide.toml")) == Path("wide.toml")
        assert shipped.or_shipped("sensors", Path("tele")) == Path("tele")
        (checkout / "elsewhere" / "wide").touch()
        assert shipped.or_shipped("sensors", Path("wide")) == Path("wide")

    @pytest.mark.parametrize("name", ["bxo", "bxo.toml", "./box", ""])
    def test_absent_file_lists_the_shipped_names(self, name: str) -> None:
        with pytest.raises(InputError, match=r"no such scene;.* give the path of a TOML file.*: box, room$") as caught:
            shipped.find("scenes", name)
        assert caught.value.file == name
