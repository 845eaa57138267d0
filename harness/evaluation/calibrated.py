"""The covariance of a calibration's parameters, as `omnirange calibrate` writes it.

Errors of a calibration are correlated: a focal length too long goes with a mirror too flat. They are drawn, and
propagated, along the columns of the covariance's Cholesky factor, which are independent and one standard deviation
long each.
"""

import json
from collections.abc import Mapping
from dataclasses import replace
from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator, Field, model_validator

from harness.camera.sensor import Sensor
from harness.errors import InputError
from harness.evaluation.propagation import Parameter, Rig, with_error
from harness.files import path_of, read_regular
from harness.geometry.angles import Array
from harness.spec import Spec

_PARTS = ("camera", "model", "lens")
_LIMIT_BYTES = 1 << 28
_ROUNDING = 1e-9
"""Share by which rounding may leave a covariance not symmetric, or a variance below zero."""


class CalibrationCovariance(Spec):
    """The covariance of a calibration's parameters; of a file, its contents alone count."""

    keys: Annotated[tuple[str, ...], Field(min_length=1, max_length=64)]
    """Dotted keys of a sensor, such as `camera.focal_px`."""
    covariance: tuple[tuple[float, ...], ...]
    """Their covariance, in the units of the keys."""

    @model_validator(mode="before")
    @classmethod
    def _read(cls, given: Any) -> Any:
        if isinstance(given, Mapping) and isinstance(given.get("file"), str):
            return _contents(given["file"])
        return given

    @model_validator(mode="after")
    def _is_one(self) -> "CalibrationCovariance":
        for key in self.keys:
            if key.partition(".")[0] not in _PARTS:
                raise ValueError(
                    f"'{key}' is no key of a central sensor's calibration; calibrate without --misalignment"
                )
        n = len(self.keys)
        if len(self.covariance) != n or any(len(row) != n for row in self.covariance):
            raise ValueError(f"covariance must be {n} x {n}, a row and a column for each key")
        self.factor()
        return self

    def factor(self) -> Array:
        """The lower Cholesky factor L of the covariance, L L' `[keys, keys]`.

        Raises
        ------
        ValueError
            When the matrix is no covariance.
        """
        matrix = np.array(self.covariance, dtype=np.float64)
        sigma = np.sqrt(np.maximum(np.diag(matrix), 0.0))
        if not np.isfinite(matrix).all() or (np.diag(matrix) < 0).any():
            raise ValueError("covariance must have finite numbers, and variances of 0 or more on its diagonal")
        unit = np.where(sigma > 0, sigma, 1.0)
        correlation = matrix / np.outer(unit, unit)
        if np.abs(correlation - correlation.T).max() > _ROUNDING:
            raise ValueError("covariance must be symmetric")
        exact = sigma == 0
        if np.abs(correlation[exact]).max(initial=0.0) > 0:
            raise ValueError("covariance must be 0 in the row and column of a variance of 0")
        correlation[exact, exact] = 1.0
        try:
            lower = np.linalg.cholesky(correlation + _ROUNDING * np.eye(len(unit)))
        except np.linalg.LinAlgError:
            raise ValueError("covariance must have no negative eigenvalue") from None
        return np.asarray(sigma[:, None] * lower)

    def parameters(self, sensor: Sensor) -> tuple[Parameter, ...]:
        """Independent errors of a sensor's calibration, each of standard deviation 1.

        Raises
        ------
        InputError
            When the sensor has not all of the keys, with the key.
        """
        for key in self.keys:
            part, _, name = key.partition(".")
            if not isinstance(getattr(getattr(sensor, part), name, None), float):
                raise InputError(
                    f"the calibration has '{key}', and the sensor, {sensor.model.title}, has no such parameter",
                    key="calibration",
                )
        columns = self.factor().T
        return tuple(
            Parameter(f"calibrated.{self.keys[i]}", "", 0.1, _along(self.keys, column))
            for i, column in enumerate(columns)
            if column.any()
        )


def _along(keys: tuple[str, ...], column: Array) -> Any:
    def changed(rig: Rig, by: float) -> Rig:
        first, second = (_moved(each, keys, by * column) for each in rig.sensors)
        return replace(rig, sensors=(first, second))

    return changed


def _moved(sensor: Sensor, keys: tuple[str, ...], by: Array) -> Sensor:
    for key, error in zip(keys, by.tolist(), strict=True):
        part, _, name = key.partition(".")
        sensor = with_error(sensor, part, name, error)
    return sensor


def _contents(file: str) -> dict[str, Any]:
    """The keys and the covariance in what `omnirange calibrate` wrote."""
    what = "what omnirange calibrate writes beside the sensor (JSON)"
    try:
        table = json.loads(read_regular(path_of(file), _LIMIT_BYTES, "calibration"))
    except InputError as error:
        raise ValueError(f"'{file}': {error.problem}") from error
    except ValueError as error:
        raise ValueError(f"'{file}' must be {what}; it is no valid JSON") from error
    try:
        return {"keys": [each["key"] for each in table["parameters"]], "covariance": table["covariance"]}
    except (KeyError, TypeError):
        raise ValueError(f"'{file}' must be {what}; it has no 'parameters' with a 'covariance'") from None


def _named(given: Any) -> Any:
    """A path as the table that names it."""
    if isinstance(given, str):
        return {"file": given}
    if given is None or isinstance(given, Mapping | CalibrationCovariance):
        return given
    raise ValueError(f"must be the path of what omnirange calibrate wrote (JSON), in quotes; found {given!r}")


Calibrated = Annotated[CalibrationCovariance | None, BeforeValidator(_named)]
"""A calibration's covariance, given as the path of what `omnirange calibrate` wrote; None for none."""
