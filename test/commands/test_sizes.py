"""The lint rule for sizes of folders and files finds what exceeds them."""

from __future__ import annotations

from pathlib import Path

from lint.sizes import FILES, LINES, problems


def test_the_project_keeps_its_limits_of_size() -> None:
    assert problems() == []


def test_a_full_folder_and_a_long_file_are_found(tmp_path: Path) -> None:
    folder = tmp_path / "test" / "full"
    folder.mkdir(parents=True)
    (folder / "__init__.py").write_text("")
    for k in range(FILES):
        (folder / f"test_{k}.py").write_text("1\n" * LINES)
    assert problems(tmp_path) == []
    (folder / "test_long.py").write_text("1\n" * (LINES + 1))
    assert {line.split(":")[0] for line in problems(tmp_path)} == {"test/full", "test/full/test_long.py"}
