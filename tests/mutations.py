"""TOML files as nobody would write them: values, keys and bytes of a valid one changed at random."""

import copy
import datetime as dt
import math
import random
from collections.abc import Iterator
from typing import Any

import tomli_w

ODD: list[Any] = [
    0,
    -1,
    1,
    3,
    -0.0,
    0.5,
    1e-300,
    5e-324,
    1e308,
    -1e308,
    1e22,
    2**31,
    2**63 - 1,
    2**64,
    -(2**63),
    10**30,
    10**400,
    math.nan,
    math.inf,
    -math.inf,
    True,
    False,
    1e-9,
    1e9,
    89.999,
    90.0,
    17,
    4,
    255,
    256,
    16385,
    -75.0,
    360.0,
    10**9,
    "",
    "0",
    "nan",
    "true",
    "x" * 5000,
    "é漢字",
    "\u202e\x07\x1b[31m",
    "<b>",
    "../../x",
    "/dev/zero",
    "pipe",
    "none",
    "box",
    "loop.toml",
    "folder.toml",
    "~nobody-here/x.toml",
    "~",
    ".",
    "/",
    "a\0b",
    "a.b:c",
    "os:getcwd",
    "{input}",
    "*",
    "$b$",
    "slanted",
    "semi-global",
    "column",
    "cubic",
    [],
    [0],
    [1, 2, 3],
    [[1]],
    [math.nan] * 3,
    ["a"],
    [{}],
    {},
    {"a": 1},
    {"kind": 5},
    {"kind": []},
    {"kind": "grey"},
    {"kind": "grey", "value": math.nan},
    {"kind": "program", "command": 3},
    {"kind": "image", "file": "/dev/zero", "tile_m": 1.0},
    {"": {"": {"": 0}}},
    {"kind": "os:getcwd"},
    {"kind": "program", "command": ["x", "{input}", "{output}"]},
    dt.date(2020, 1, 1),
    dt.time(1, 2),
    dt.datetime(2020, 1, 1, tzinfo=dt.UTC),
]
KEYS = [
    "zzz",
    "Kind",
    "class",
    "__init__",
    "",
    "a b",
    "model_config",
    "<b>",
    "parameters",
    "files",
    "é",
    "a.b",
    "x" * 300,
]
AXES = [
    "",
    ".",
    "a.b",
    "scene",
    "sensor",
    "matching",
    "matching.kind",
    "scene.objects.99.size_m",
    "scene.objects.-1",
    "seed",
    "trial.seed",
    "seed.x",
    "scene.objects.0.size_m.1",
    "sensor..x",
    "matching.parameters.x",
    "matching.command",
    "name",
    "matching.files",
    "é",
    "scene.objects.\u0663",
    "scene.objects.0.texture.kind",
    "view_1",
    "panorama.width_px",
]
BYTES = [b"\0", b"\xff\xfe", b"\xc3", b"\r", b'"', b"'''", b"[[", b"=", b"\xef\xbb\xbf"]


def mutated(table: dict[str, Any], draw: random.Random) -> bytes:
    """A table as TOML with one or a few things wrong, in its values, its keys or its bytes."""
    table = copy.deepcopy(table)
    for _ in range(draw.choice([1, 1, 2, 3])):
        if "trial" in table and draw.random() < 0.3:
            _vary(table, draw)
        else:
            _change(table, draw)
    data = tomli_w.dumps(table).encode()
    return _garbled(data, draw) if draw.random() < 0.25 else data


def _paths(value: Any, above: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, each in items:
        yield (*above, key)
        yield from _paths(each, (*above, key))


def _change(table: dict[str, Any], draw: random.Random) -> None:
    *above, key = draw.choice(list(_paths(table)) or [("a",)])
    inside: Any = table
    for each in above:
        inside = inside[each]
    what = draw.random()
    if what < 0.5:
        inside[key] = copy.deepcopy(draw.choice(ODD))
    elif what < 0.6 and isinstance(inside, dict):
        inside.pop(key, None)
    elif what < 0.7 and isinstance(inside, dict) and key in inside:
        inside[f"{key}{draw.choice(['x', '_', ' ', 'é', '.'])}"] = inside.pop(key)
    elif what < 0.85 and isinstance(inside, dict):
        inside[draw.choice(KEYS)] = copy.deepcopy(draw.choice(ODD))
    elif isinstance(inside, list) and draw.random() < 0.5:
        inside *= draw.choice([0, 2, 50])
    else:
        inside[key] = draw.choice([[inside.get(key) or 0], {"x": 1}]) if isinstance(inside, dict) else [inside[key]]


def _vary(table: dict[str, Any], draw: random.Random) -> None:
    keys = [".".join(map(str, path)) for path in _paths(table["trial"])] if isinstance(table["trial"], dict) else []
    key = draw.choice([*keys, *AXES])
    values = draw.choice(
        [[draw.choice(ODD)], [draw.choice(ODD), draw.choice(ODD)], draw.choice(ODD), [1, 1.0], [5, 7], [0.1, 0.2]]
    )
    if draw.random() < 0.6 and isinstance(table.setdefault("axes", {}), dict):
        table["axes"][key] = copy.deepcopy(values)
    elif isinstance(table.setdefault("cases", []), list):
        table["cases"].append({"name": f"case {len(table['cases'])}", key: copy.deepcopy(draw.choice(ODD))})


def _garbled(data: bytes, draw: random.Random) -> bytes:
    at = draw.randrange(len(data) + 1)
    deep = draw.choice([50, 500, 20000])
    return draw.choice(
        [
            lambda: data[:at],
            lambda: data[:at] + bytes([draw.randrange(256)]) + data[at + 1 :],
            lambda: data[:at] + draw.choice(BYTES) + data[at:],
            lambda: data + data[at : at + 40],
            lambda: b"zz = " + b"[" * deep + b"]" * deep + b"\n" + data,
            lambda: data + b"\n[" + b".".join([b"a"] * deep) + b"]\nb = 1\n",
            lambda: b"zz = " + b"{a = " * deep + b"1" + b"}" * deep + b"\n" + data,
            lambda: b"\xef\xbb\xbf" + data,
            lambda: data.replace(b"\n", draw.choice([b"\r\n", b"\r", b"\n\n"])),
        ]
    )()
