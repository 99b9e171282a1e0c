"""YAML as plain data, read with work that is bounded by the length of its text, and with one error.

YAML aliases and merge keys repeat a part, so a few lines can expand to more than any memory holds: the parts are
counted with all aliases expanded before they are built. The integers of YAML 1.1 in base 60 (1:30) take time quadratic
in their length: they are texts, as in YAML 1.2. Python prints no integer of more than 4300 digits: it is an error.
"""

from __future__ import annotations

from typing import Any

import yaml

MAX_PARTS = 100_000  # of a text, with all aliases expanded
MOST_QUOTED = 40  # characters of a value: enough to find it, and little of a file that is no scene


class YamlError(ValueError):
    """Its text, for the user, has the reason and the line."""


def load_yaml(text: str) -> Any:
    """The content of one document: mappings, lists, texts, numbers and dates, no objects. Raises YamlError."""
    try:
        loader = _Loader(text)
        try:
            node = loader.get_single_node()
            if node is None:
                return None
            _require_few(node)
            return loader.construct_document(node)
        finally:
            loader.dispose()
    except YamlError:
        raise
    except RecursionError:
        raise YamlError("nested too deeply") from None
    except (yaml.YAMLError, ValueError, OverflowError) as error:  # ValueError: an invalid date
        raise YamlError(f"not YAML: {_words(error)}") from error


def shortened(text: str) -> str:
    """`text`, cut to MOST_QUOTED characters."""
    return text if len(text) <= MOST_QUOTED else f"{text[: MOST_QUOTED - 3]}..."


class _Loader(yaml.SafeLoader):
    """SafeLoader with at most MAX_PARTS nodes, and with scalars that Python can print."""

    parts = 0

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        self.parts += 1
        if self.parts > MAX_PARTS:
            raise YamlError(f"more than {MAX_PARTS} parts")
        return super().compose_node(parent, index)

    def construct_scalar_of_tag(self, node: yaml.ScalarNode) -> Any:
        """A truth value, number or date; the text itself if it is a number in base 60, as in YAML 1.2."""
        kind = node.tag.rpartition(":")[2]
        if kind in ("int", "float") and ":" in node.value:
            return node.value
        try:
            value = yaml.SafeLoader.yaml_constructors[node.tag](self, node)
        except (LookupError, AttributeError) as error:  # of an empty text, or one that does not match
            words = f"{shortened(repr(node.value))} is not of the type !!{kind}"
            raise yaml.MarkedYAMLError(problem=words, problem_mark=node.start_mark) from error
        str(value)  # raises ValueError if the integer has too many digits
        return value


for _kind in ("bool", "int", "float", "timestamp"):
    _Loader.add_constructor(f"tag:yaml.org,2002:{_kind}", _Loader.construct_scalar_of_tag)


def _words(error: Exception) -> str:
    """The problem and its line number; PyYAML's own message quotes the line, whatever file it is from."""
    if not isinstance(error, yaml.MarkedYAMLError):
        return _shortened_words(str(error))
    mark = error.problem_mark or error.context_mark
    return _shortened_words(error.problem or error.context or "") + (f", line {mark.line + 1}" if mark else "")


def _shortened_words(text: str) -> str:
    return " ".join(map(shortened, text.split()))


def _require_few(root: yaml.Node) -> None:
    counts: dict[int, int] = {}

    def parts(node: yaml.Node) -> int:
        known = counts.get(id(node))
        if known is not None:
            if known == 0:
                raise YamlError(f"a part contains itself, line {node.start_mark.line + 1}")
            return known
        counts[id(node)] = 0
        inside = [] if isinstance(node, yaml.ScalarNode) else node.value
        if isinstance(node, yaml.MappingNode):
            inside = [each for pair in inside for each in pair]
        counts[id(node)] = 1 + sum(map(parts, inside))
        return counts[id(node)]

    count = parts(root)
    if count > MAX_PARTS:
        raise YamlError(f"{count:.3g} parts with all aliases written out, more than {MAX_PARTS}")
