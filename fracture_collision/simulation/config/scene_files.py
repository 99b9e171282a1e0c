"""Files of a scene, read as plain data: sizes are bounded before anything is built, and every error is a SceneError.

YAML aliases repeat a part, so a few lines can expand to more than any memory holds: the parts are counted with all
aliases expanded before they are built.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from fracture_collision.simulation.config.scene_fields import SceneError, shortened

MAX_SCENE_BYTES = 1_000_000
MAX_TRACK_BYTES = 20_000_000  # hours of a hand, at one row per step
MAX_PARTS = 100_000  # of a scene, with all aliases expanded


def read_text(file: Path, most_bytes: int) -> str:
    """The text of a regular file of at most `most_bytes`; raises SceneError."""
    try:
        if not file.is_file():  # a device or a pipe may never end
            raise SceneError(f"{file}: no such file")
        with file.open("rb") as stream:
            data = stream.read(most_bytes + 1)
    except (OSError, ValueError) as error:
        raise error if isinstance(error, SceneError) else SceneError(f"{file}: {error}") from error
    if len(data) > most_bytes:
        raise SceneError(f"{file}: more than {most_bytes} bytes")
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise SceneError(f"{file}: not UTF-8: {error}") from error


def read_yaml(file: Path) -> Any:
    """Content of a YAML file: mappings, lists, texts and numbers, no objects; raises SceneError."""
    try:
        loader = yaml.SafeLoader(read_text(file, MAX_SCENE_BYTES))
        try:
            node = loader.get_single_node()
            if node is None:
                return None
            _require_few(node, file)
            return loader.construct_document(node)
        finally:
            loader.dispose()
    except SceneError:
        raise
    except RecursionError:
        raise SceneError(f"{file}: nested too deeply") from None
    except (yaml.YAMLError, ValueError, OverflowError) as error:  # ValueError: an invalid date or number
        raise SceneError(f"{file}: not YAML: {_words(error)}") from error


def _words(error: Exception) -> str:
    """The problem and its line number; PyYAML's own message quotes the line, whatever file it is from."""
    if not isinstance(error, yaml.MarkedYAMLError):
        return _shortened_words(str(error))
    mark = error.problem_mark or error.context_mark
    return _shortened_words(error.problem or error.context or "") + (f", line {mark.line + 1}" if mark else "")


def _shortened_words(text: str) -> str:
    return " ".join(map(shortened, text.split()))


def _require_few(root: yaml.Node, file: Path) -> None:
    counts: dict[int, int] = {}

    def parts(node: yaml.Node) -> int:
        known = counts.get(id(node))
        if known is not None:
            if known == 0:
                raise SceneError(f"{file}: a part contains itself, line {node.start_mark.line + 1}")
            return known
        counts[id(node)] = 0
        inside = [] if isinstance(node, yaml.ScalarNode) else node.value
        if isinstance(node, yaml.MappingNode):
            inside = [each for pair in inside for each in pair]
        counts[id(node)] = 1 + sum(map(parts, inside))
        return counts[id(node)]

    count = parts(root)
    if count > MAX_PARTS:
        raise SceneError(f"{file}: {count:.3g} parts with all aliases written out, more than {MAX_PARTS}")
