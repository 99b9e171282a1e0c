"""Commands in README and docs/: the command, its options and arguments exist, and so do targets, modules and files."""

from __future__ import annotations

import re
import shlex
from importlib.util import find_spec
from pathlib import Path

import pytest

from fracture_collision.cli.commands import main
from fracture_collision.ros.start import NODES

ROOT = Path(__file__).resolve().parents[2]
DOCUMENTS = sorted((*ROOT.glob("*.md"), *ROOT.glob("docs/*.md"), ROOT / "bags" / "README.md"))
OURS = re.compile(r"^(?:\.venv/bin/)?(fracture-collision|make|python3?|ros2|[a-z_]+_node)\b")


def commands(document: Path) -> list[str]:
    """Commands in indented blocks and in `code`, without their comments."""
    text = re.sub(r"```.*?```", "", document.read_text(), flags=re.DOTALL)
    blocks = re.findall(r"^    (\S.*)$", text, re.MULTILINE)
    prose = re.sub(r"^    .*$", "", text, flags=re.MULTILINE)
    spans = [" ".join(span.split()) for span in re.findall(r"`([^`]+)`", prose)]
    parts = [part for line in (*blocks, *spans) for part in re.split(r"\s&&\s|\s\|\s", re.split(r"\s+# ", line)[0])]
    return [part.strip() for part in parts if OURS.match(part.strip()) and " " in part.strip()]


ALL = [(document, command) for document in DOCUMENTS for command in dict.fromkeys(commands(document))]


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with what a reader has who follows the documents."""
    folder = tmp_path_factory.mktemp("reader")
    (folder / "out").mkdir()
    for name in ("smash", "play", "b", "3", "scene"):
        (folder / "out" / name).mkdir()
        (folder / "out" / name / "bag").symlink_to(ROOT / "bags" / "pane")
    for name in ("bags", "config", "docs", "examples", "benchmarks", "test"):
        (folder / name).symlink_to(ROOT / name)
    for name in ("bunny.obj", "my.yaml", "part.stl"):
        (folder / name).touch()
    (folder / "bag").symlink_to(ROOT / "bags" / "pane")
    return folder


@pytest.mark.parametrize(("document", "command"), ALL, ids=lambda each: each.name if isinstance(each, Path) else each)
def test_a_command_in_a_document_is_valid(
    document: Path, command: str, place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(place)
    program, *words = shlex.split(command)
    program = program.rsplit("/", 1)[-1]
    if any(re.search(r"\.\.\.|<|\b[A-Z]{3,}\b", word) for word in words):  # placeholders
        words = words[:1]
    if program == "make":
        targets = re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE)
        assert {word for word in words if "=" not in word} <= set(targets)
    elif program == "fracture-collision":
        check_cli(words)
    elif program in ("python", "python3"):
        check_python(words)
    elif program == "ros2" and words[:1] == ["launch"]:
        assert words[1] == "fracture_collision" and (ROOT / "launch" / words[2]).is_file()
    elif program == "ros2" and words[:1] == ["run"] and len(words) > 1:
        assert words[1] == "fracture_collision" and words[2] in NODES
    elif program.endswith("_node"):
        assert program in NODES


def check_cli(words: list[str]) -> None:
    if words[:1] in (["--help"], ["--version"]):
        return
    with main.make_context("fracture-collision", list(words)) as context:
        name, command, rest = main.resolve_command(context, list(words))
        assert command is not None
        if "--help" in rest:
            return
        needed = [each for each in command.params if each.required and each.param_type_name == "argument"]
        if len(rest) < len(needed):  # the command's name alone, in running text
            return
        command.make_context(name, rest, parent=context)


def check_python(words: list[str]) -> None:
    if words[:1] == ["-m"]:
        assert find_spec(words[1]) is not None, words[1]
    elif words and not words[0].startswith("-"):
        assert (ROOT / words[0]).is_file(), words[0]


def test_commands_are_found() -> None:
    found = [command for _, command in ALL]
    assert len(found) > 30 and "make smash" in found and any("replay" in command for command in found)
