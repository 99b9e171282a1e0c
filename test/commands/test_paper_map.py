"""The names of code in docs/paper.md, for each section of the paper, and in CONTRIBUTING.md exist."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

from benchmarks.studies.page import STUDIES

ROOT = Path(__file__).resolve().parents[2]
TEXT = (ROOT / "docs" / "paper.md").read_text(encoding="utf-8")
NAMES = sorted(set(re.findall(r"`([\w/]+\.py): (\w+)`", TEXT)))


@pytest.mark.parametrize(("file", "name"), NAMES)
def test_names_in_the_paper_map_exist(file: str, name: str) -> None:
    tree = ast.parse((ROOT / "fracture_collision" / file).read_text(encoding="utf-8"))
    assert name in {node.name for node in tree.body if isinstance(node, ast.FunctionDef | ast.ClassDef)}


def test_every_section_of_the_paper_has_code() -> None:
    sections = re.split(r"^## ", TEXT, flags=re.M)[1:]
    assert [title.split()[0] for title in sections] == ["3", "4", "5", "6", "7", "8"]
    for number in ("4.1", "4.2", "4.3", "4.4", "4.5", "5.1", "5.2", "5.3", "6.1", "6.2", "6.3", "7.2"):
        assert re.search(rf"^\| {re.escape(number)}\b", TEXT, flags=re.M), number
    assert len(NAMES) > 30


def test_studies_in_the_paper_map_exist() -> None:
    named = set(re.findall(r"fracture-collision bench (\w+)", TEXT))
    assert named and named <= set(STUDIES)


def test_files_named_in_contributing_exist() -> None:
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    where = text[text.index("## Where things are") : text.index("## Rules")]
    files = re.findall(r"`([\w/]+\.py)`", where)
    assert len(files) > 20
    assert [file for file in files if not (ROOT / "fracture_collision" / file).is_file()] == []
