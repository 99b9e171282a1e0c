"""The lint rule for signatures finds functions that take or do too much."""

from __future__ import annotations

from pathlib import Path

from lint.signatures import KERNELS, LINES, PARAMETERS, functions, problems


def test_the_project_keeps_its_limits_of_signatures() -> None:
    assert problems() == []


def test_long_functions_and_long_parameter_lists_are_found(tmp_path: Path) -> None:
    folder = tmp_path / "lint"
    folder.mkdir()
    taken = ", ".join(f"p{k}" for k in range(PARAMETERS))
    documented = '    """Text.\n\n' + "    more\n" * LINES + '    """\n'
    (folder / "kept.py").write_text(
        f"class A:\n    def method(self, {taken}):\n        pass\n\n\ndef documented():\n{documented}"
        + "    x = 1\n" * LINES
    )
    unused = {line.split(": small enough")[0] for line in problems(tmp_path)}
    assert unused == frozenset().union(*KERNELS.values())
    (folder / "broken.py").write_text(
        f"def wide({taken}, *, more):\n    pass\n\n\nasync def long():\n" + "    x = 1\n" * LINES
    )
    found = {line for line in problems(tmp_path) if "small enough" not in line}
    assert found == {
        f"lint/broken.py: wide: {PARAMETERS + 1} parameters, 2 lines",
        f"lint/broken.py: long: 0 parameters, {LINES + 1} lines",
    }
    assert [f.name for f in functions(folder / "kept.py", "kept.py")] == ["kept.py: documented", "kept.py: method"]
