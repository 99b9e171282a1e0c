"""Documents: their code runs and prints what they say, and their links and pictures exist."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from benchmarks.snippets import DOCS, blocks, run

WITH_CODE = ["tutorial.md", "solvers.md", "../README.md"]


@pytest.mark.parametrize("name", WITH_CODE)
def test_the_code_prints_what_the_document_says(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    _, printed = run(DOCS / name)
    assert printed
    for block in printed:
        assert block.got == block.expected, f"{name}, line {block.line}"


@pytest.mark.parametrize("name", WITH_CODE)
def test_every_block_has_a_language_that_is_checked(name: str) -> None:
    assert {block.language for block in blocks(DOCS / name)} <= {"python", "text"}


@pytest.mark.parametrize("name", [*(file.name for file in sorted(DOCS.glob("*.md"))), "../README.md"])
def test_links_and_pictures_exist(name: str) -> None:
    place = (DOCS / name).parent
    for target, anchor in re.findall(r"\]\(([^)#:]+)(?:#([\w-]+))?\)", (DOCS / name).read_text()):
        assert (place / target).exists(), target
        if anchor:
            headings = re.findall(r"^#+ (.*)$", (place / target).read_text(), re.MULTILINE)
            assert anchor in {re.sub(r"[^\w -]", "", h).strip().lower().replace(" ", "-") for h in headings}, anchor
