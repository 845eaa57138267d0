"""Parsing a calibration file by its own syntax, within limits: YAML, OpenCV's XML, JSON, TOML, or plain text."""

import json
import re
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import yaml

from harness.errors import InputError
from harness.files import not_text, read_regular
from harness.io.calibrations.record import Content
from harness.toml import MOST_BYTES, MOST_LEVELS, parse_toml

_LOADER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_YAML_HEADER = re.compile(r"\A%YAML[: ]1\.\d[^\n]*\n")
"""OpenCV before version 5 writes `%YAML:1.0`, which is no YAML."""
_TOO_DEEP = f"tables and lists are nested more than {MOST_LEVELS} deep"


class _Loader(_LOADER):  # type: ignore[misc]
    """Loads plain values only, and OpenCV's matrices as tables."""


def _opencv_matrix(loader: Any, node: Any) -> dict[str, Any]:
    return dict(loader.construct_mapping(node, deep=True))


_Loader.add_constructor("tag:yaml.org,2002:opencv-matrix", _opencv_matrix)


def read_content(file: Path, what: str = "sensor") -> Content:
    """Read a file and parse it.

    Parameters
    ----------
    what
        What the file should be, for messages: `sensor`, `pose` or `corner`.

    Raises
    ------
    InputError
        When the file cannot be read, is not text, or is cut off.
    """
    data = read_regular(file, MOST_BYTES, what)
    try:
        text = data.decode("utf-8-sig").replace("\r\n", "\n")
    except UnicodeDecodeError as error:
        raise InputError(not_text(data), file=file) from error
    if "\0" in text:
        raise InputError(not_text(data), file=file)
    try:
        return _parsed(file, text)
    except RecursionError as error:
        raise InputError(_TOO_DEEP, file=file) from error
    except InputError as error:
        raise InputError(error.problem, file=file, key=error.key) from error


def _parsed(file: Path, text: str) -> Content:
    start = text.lstrip()
    if start.startswith("<"):
        return Content(file, "xml", text, _xml(text))
    if start.startswith("{"):
        return Content(file, "json", text, _json(text))
    if _YAML_HEADER.match(text):
        return Content(file, "yaml", text, _yaml(_YAML_HEADER.sub("", text)))
    try:
        return Content(file, "toml", text, parse_toml(text))
    except ValueError as error:
        no_toml = InputError(f"not valid TOML: {error}")
    if file.suffix.lower() == ".toml" and re.search(r"^\s*(?:\[[A-Za-z]|[A-Za-z_]\w*\s*=)", text, re.MULTILINE):
        raise no_toml
    if re.search(r"^[^\s#:][^\n:]*:(?:\s|\Z)", text, re.MULTILINE):
        try:
            return Content(file, "yaml", text, _yaml(text))
        except InputError as error:
            raise (no_toml if file.suffix == ".toml" else error) from error
    return Content(file, "text", text)


def _yaml(text: str) -> Any:
    try:
        _check_depth(text)
        return yaml.load(text, Loader=_Loader)  # noqa: S506 - a safe loader's class
    except yaml.YAMLError as error:
        raise InputError(f"not valid YAML: {error}") from error
    except (ValueError, TypeError) as error:  # an impossible date or number; a table as a key
        raise InputError(f"not valid YAML: {error}") from error


def _check_depth(text: str) -> None:
    """Check that nesting is shallow, as the loader in C crashes otherwise, and that there are no references."""
    level = 0
    for event in yaml.parse(text, Loader=_LOADER):
        if isinstance(event, yaml.AliasEvent):
            raise InputError("has references (*name); write the values out")
        level += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        if level > MOST_LEVELS:
            raise InputError(_TOO_DEEP)


def _json(text: str) -> Any:
    try:
        return json.loads(text)
    except ValueError as error:
        raise InputError(f"not valid JSON: {error}") from error


def _xml(text: str) -> Any:
    if re.search(r"<!(?:DOCTYPE|ENTITY)", text, re.IGNORECASE):
        raise InputError("has a document type (<!DOCTYPE); OpenCV writes none, and none is read")
    try:
        root = ET.fromstring(text)  # noqa: S314 - without a document type there are no entities
    except (ET.ParseError, ValueError) as error:
        raise InputError(f"not valid XML: {error}") from error
    return {root.tag: _xml_value(root, 1)}


def _xml_value(element: ET.Element, level: int) -> Any:
    """The value of an element of OpenCV's XML: a table, a list of elements named `_`, a list of words, or text."""
    if level > MOST_LEVELS:
        raise InputError(_TOO_DEEP)
    children = list(element)
    text = (element.text or "").strip()
    if children and all(child.tag == "_" for child in children):
        return [_xml_value(child, level + 1) for child in children]
    if children:
        values = {child.tag: _xml_value(child, level + 1) for child in children}
        if element.get("type_id") == "opencv-matrix" and isinstance(values.get("data"), str):
            values["data"] = values["data"].split()
        return values
    if text.startswith('"') and text.endswith('"') and len(text) > 1:
        return text[1:-1]
    words = text.split()
    return words if len(words) > 1 else text
