"""The settings reference as a table."""

from dataclasses import asdict

import pandas as pd

from harness.runs.settings_reference import find_settings


def settings(key: str | None = None) -> pd.DataFrame:
    """A table of the settings of an experiment: type, unit, default and meaning of every key.

    Parameters
    ----------
    key
        A key (`matching.window_px`), a table (`sensor.camera`) or the last part of a key (`window_px`); all when None.

    Returns
    -------
    pandas.DataFrame
        One row for each key and kind of matcher, object or texture; indexed by the key.

    Raises
    ------
    InputError
        When there is no such key; the message names the nearest.

    Examples
    --------
    >>> import harness
    >>> harness.settings("window_px")[["kinds", "unit", "default"]]
                                  kinds unit default
    key
    matching.window_px  window, column   px      11
    matching.window_px         slanted   px      17
    """
    rows = [asdict(each) | {"kinds": ", ".join(each.kinds)} for each in find_settings(key)]
    return pd.DataFrame(rows).set_index("key")
