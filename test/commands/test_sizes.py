"""The lint rule for sizes of folders and files finds what exceeds them."""

from __future__ import annotations

from pathlib import Path

from lint.sizes import FILES, LINES, LONGER, problems


def test_the_project_keeps_its_limits_of_size() -> None:
    assert problems() == []


def test_a_full_folder_and_a_long_file_are_found(tmp_path: Path) -> None:
    folder = tmp_path / "test" / "full"
    folder.mkdir(parents=True)
    (folder / "__init__.py").write_text("")
    for k in range(FILES):
        (folder / f"test_{k}.py").write_text("1\n" * LINES)
    of_others = {line for line in problems(tmp_path) if line.split(":")[0] in LONGER}
    assert set(problems(tmp_path)) == of_others and len(of_others) == len(LONGER)
    (folder / "test_long.py").write_text("1\n" * (LINES + 1))
    found = {line.split(":")[0] for line in set(problems(tmp_path)) - of_others}
    assert found == {"test/full", "test/full/test_long.py"}
