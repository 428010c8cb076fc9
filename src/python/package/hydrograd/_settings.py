"""Settings as the library reads them: ``key=value``, the value in TOML."""

from __future__ import annotations

import json
import numbers
import os
from collections.abc import Mapping
from typing import Any

import numpy as np


def assignments(*layers: Mapping[str, Any]) -> list[str]:
    """``key=value`` of every entry, in their order; a value of None leaves the key as it is."""
    found: dict[str, str] = {}
    for layer in layers:
        for key, value in layer.items():
            if value is not None:
                found[key] = f"{key}={toml(value)}"
    return list(found.values())


def toml(value: Any) -> str:
    """A value as TOML."""
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, os.PathLike):
        value = os.fspath(value)
    if isinstance(value, str):
        # A string of JSON is one of TOML, but for two characters that it leaves as they are.
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, numbers.Integral):
        return str(int(value))
    if isinstance(value, numbers.Real):
        # Python says inf and nan as TOML does.
        return repr(float(value))
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{json.dumps(str(key))} = {toml(one)}" for key, one in value.items()) + " }"
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(toml(one) for one in value) + "]"
    raise TypeError(f"a setting is a number, a text, True or False, or a list of these, not {type(value).__name__}: {value!r}")
