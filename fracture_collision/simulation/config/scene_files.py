"""Files of a scene, read as data and nothing else: sizes bounded before anything is made of them, errors in words.

YAML's aliases name a part again, so that a few lines can stand for more than any memory holds: a text's parts are
counted as they would be written out, before they are made.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from fracture_collision.simulation.config.scene_fields import SceneError, shortened

MAX_SCENE_BYTES = 1_000_000
MAX_TRACK_BYTES = 20_000_000  # hours of a hand, a row a step
MAX_PARTS = 100_000  # of a scene, written out without aliases


def read_text(file: Path, most_bytes: int) -> str:
    """The text of a regular file of at most `most_bytes`; raises SceneError."""
    try:
        if not file.is_file():  # a device or a pipe may never end
            raise SceneError(f"{file}: no file")
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
    """What a YAML file says: mappings, lists, texts and numbers, no objects; raises SceneError."""
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
        raise SceneError(f"{file}: not YAML that can be read: too deep") from None
    except (yaml.YAMLError, ValueError, OverflowError) as error:  # ValueError: of a date or a number that is none
        raise SceneError(f"{file}: not YAML: {_words(error)}") from error


def _words(error: Exception) -> str:
    """What is wrong, and in which line; PyYAML's own words have the line itself, whatever file it is of."""
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
