"""The .msg text of a message with all types that it uses, as stored in bags for readers without ROS."""

from __future__ import annotations

import importlib
import inspect
import json
import re
from pathlib import Path
from typing import Any

_SEPARATOR = "=" * 80
_BUILT_IN = re.compile(r"(bool|byte|char|u?int(8|16|32|64)|float(32|64)|w?string)\b")


def type_name(message_class: Any) -> str:
    """The ROS name of a message class: package/msg/Name."""
    return f"{message_class.__module__.split('.')[0]}/msg/{message_class.__name__}"


def message_definition(message_class: Any) -> str:
    """Schema text in `ros2msg` form. FileNotFoundError if a package's .msg files are not installed."""
    first = type_name(message_class)
    texts = {first: _file(first, ".msg").read_text()}
    waiting = [first]
    while waiting:
        name = waiting.pop(0)
        for used in _used_types(texts[name], package=name.split("/")[0]):
            if used not in texts:
                texts[used] = _file(used, ".msg").read_text()
                waiting.append(used)
    parts = [texts.pop(first)]
    parts += [f"MSG: {name.replace('/msg/', '/')}\n{text}" for name, text in texts.items()]
    return f"\n{_SEPARATOR}\n".join(parts)


def type_hash(message_class: Any) -> str:
    """The RIHS01 hash by which ROS 2 identifies the type's content."""
    name = type_name(message_class)
    for entry in json.loads(_file(name, ".json").read_text())["type_hashes"]:
        if entry["type_name"] == name:
            return entry["hash_string"]
    return ""


def _used_types(text: str, package: str) -> list[str]:
    used = []
    for line in text.splitlines():
        words = line.split("#")[0].split()
        if not words or _BUILT_IN.match(words[0]):
            continue
        name = re.sub(r"\[.*\]$", "", words[0])
        parts = name.split("/")
        used.append(f"{parts[0] if len(parts) > 1 else package}/msg/{parts[-1]}")
    return used


def _file(name: str, suffix: str) -> Path:
    package, _, message = name.split("/")
    # Not by the ament index: that needs AMENT_PREFIX_PATH, which Python environments with ROS from wheels do not set.
    for prefix in Path(inspect.getfile(importlib.import_module(f"{package}.msg"))).resolve().parents:
        file = prefix / "share" / package / "msg" / f"{message}{suffix}"
        if file.is_file():
            return file
    raise FileNotFoundError(f"{name}: no share/{package}/msg/{message}{suffix} in any prefix above its Python package")
