"""The names that people use for the keys of a trial, in sentences, legends and tables."""

_NAMES = {
    "view_2.baseline_m": ("baseline |t|", "m"),
    "matching.window_px": ("window", "px"),
    "matching.pitch_px": ("pitch", "px"),
    "noise.sigma_grey": ("noise σ", "grey levels"),
    "filter.log_sigma_px": ("LoG σ", "px"),
    "scene.objects.0.size_m": ("size of the first object", "m"),
}


def name_and_unit(key: str) -> tuple[str, str]:
    """The name of a key, and its unit as shown; the key itself, and none, where there is no name for it."""
    return _NAMES.get(key, (key, ""))


def name_of(key: str) -> str:
    """The name with its unit."""
    name, unit = name_and_unit(key)
    return f"{name} ({unit})" if unit else name
