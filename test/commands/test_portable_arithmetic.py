"""Functions that round identically on every processor, and the lint rules for arithmetic and for signatures."""

from __future__ import annotations

import math
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fracture_collision import portable_math
from fracture_collision.simulation.rotations import DEGREE, from_euler_angles, random_quaternion
from lint.portable_arithmetic import violations
from lint.signatures import KERNELS, LINES, PARAMETERS, functions, problems

RNG = np.random.default_rng(5)
ANGLES = np.concatenate(
    [RNG.uniform(-size, size, 20_000) for size in (1e-9, 1e-3, 1.0, 10.0, 1e5)] + [np.arange(-900, 900) * np.pi / 4]
)
SIZES = 10.0 ** RNG.integers(-6, 6, (2, 20_000)) * RNG.normal(size=(2, 20_000))


def units_in_the_last_place(got, expected):
    return float(np.max(np.abs(got - expected) / np.spacing(np.abs(expected))))


@pytest.mark.parametrize(
    ("name", "arguments", "expected", "most"),
    [
        ("sine", (ANGLES,), np.sin(ANGLES), 1),
        ("cosine", (ANGLES,), np.cos(ANGLES), 1),
        ("arctangent2", tuple(SIZES), np.arctan2(*SIZES), 2),
        ("arccosine", (np.linspace(-1, 1, 9999),), np.arccos(np.linspace(-1, 1, 9999)), 4),
        ("exponential", (np.linspace(-700, 700, 9999),), np.exp(np.linspace(-700, 700, 9999)), 1),
        ("logarithm", (np.abs(SIZES[0]),), np.log(np.abs(SIZES[0])), 1),
    ],
)
def test_elementary_functions_agree_with_numpy_within_some_last_bits(name, arguments, expected, most):
    assert units_in_the_last_place(getattr(portable_math, name)(*arguments), expected) <= most


def test_elementary_functions_at_special_values():
    up, along = np.array([0.0, 0.0, 1.0, -1.0, 0.0]), np.array([1.0, -1.0, 0.0, 0.0, 0.0])
    np.testing.assert_array_equal(portable_math.arctangent2(up, along), np.arctan2(up, along))
    np.testing.assert_array_equal(portable_math.exponential([-1e9, 0.0, 1e9]), [0.0, 1.0, np.inf])
    np.testing.assert_array_equal(portable_math.power([0.0, 0.0, 0.0, 2.0], [0.0, 1.0, -1.0, 1.0]), [1, 0, np.inf, 2])
    np.testing.assert_allclose(portable_math.power(np.abs(SIZES[0]), -1.7), np.abs(SIZES[0]) ** -1.7, rtol=1e-14)
    assert portable_math.cube_root(0.0) == 0.0
    assert portable_math.cube_root(27.0) == pytest.approx(3.0, rel=1e-15)


def test_a_compiled_sine_has_the_bits_of_the_array_function():
    from numba import njit

    scalar = njit(portable_math.sine_after)
    expected = portable_math.sine(ANGLES), portable_math.cosine(ANGLES)
    for quarters, values in zip((0.0, 1.0), expected, strict=True):
        got = np.array([scalar(angle, quarters) for angle in ANGLES])
        np.testing.assert_array_equal(got.view(np.uint64), values.view(np.uint64))


def test_linear_algebra_agrees_with_lapack():
    matrices, vectors = RNG.normal(size=(50, 3, 3)) + 3.0 * np.eye(3), RNG.normal(size=(50, 3))
    np.testing.assert_allclose(portable_math.inverses(matrices), np.linalg.inv(matrices), atol=1e-12)
    np.testing.assert_allclose(portable_math.determinants(matrices), np.linalg.det(matrices), rtol=1e-12)
    expected = np.linalg.solve(matrices, vectors[..., None])[..., 0]
    np.testing.assert_allclose(portable_math.solutions(matrices, vectors), expected, atol=1e-12)
    np.testing.assert_allclose(portable_math.products(matrices[0], vectors.T), matrices[0] @ vectors.T, rtol=1e-14)
    np.testing.assert_allclose(portable_math.lengths(vectors), np.linalg.norm(vectors, axis=1), rtol=1e-15)


def test_products_are_rounded_in_the_order_written():
    """Against exact fractions with each operation rounded separately: no fused multiply-add, no reordering."""
    a, b = RNG.normal(size=(2, 200, 3))

    def rounded(p, q):
        total = float(Fraction(p[0]) * Fraction(q[0]))
        for i in (1, 2):
            total = float(Fraction(total) + Fraction(float(Fraction(p[i]) * Fraction(q[i]))))
        return total

    assert portable_math.dots(a, b).tolist() == [rounded(p, q) for p, q in zip(a.tolist(), b.tolist(), strict=True)]


def test_rotations_agree_with_scipy():
    turns = Rotation.random(200, random_state=2)
    np.testing.assert_allclose(portable_math.rotation_vectors(turns.as_quat()), turns.as_rotvec(), atol=1e-14)
    np.testing.assert_array_equal(portable_math.rotation_vectors(np.array([0.0, 0.0, 0.0, 1.0])), np.zeros(3))
    for angles in RNG.uniform(-180.0, 180.0, (20, 3)):
        got, expected = from_euler_angles(DEGREE * angles), Rotation.from_euler("xyz", angles, degrees=True).as_quat()
        assert abs(got @ expected) == pytest.approx(1.0, abs=1e-15)


def test_random_numbers_are_distributed_as_specified():
    numbers = portable_math.normal_numbers(np.random.default_rng(3), (40_000,))
    assert abs(numbers.mean()) < 0.02
    assert numbers.std() == pytest.approx(1.0, abs=0.02)
    assert (np.abs(numbers) > 3.0).mean() == pytest.approx(math.erfc(3.0 / math.sqrt(2.0)), rel=0.3)
    generator = np.random.default_rng(4)
    turned = [Rotation.from_quat(random_quaternion(generator)).apply([0.0, 0.0, 1.0]) for _ in range(2000)]
    np.testing.assert_allclose(np.mean(turned, axis=0), 0.0, atol=0.05)


@pytest.mark.parametrize(
    "line",
    [
        "np.linalg.norm(x)", "x @ y", "x @= y", "x.dot(y)", "np.einsum('i,i', x, y)", "np.sin(x)", "math.cos(x)",
        "math.hypot(x, y)", "x**2", "x ** 0.5", "np.power(x, 3)", "rng.normal(size=3)", "np.argsort(x)", "x.argsort()",
        "np.argpartition(x, 2)", "from scipy.spatial.transform import Rotation", "import scipy.linalg",
        "from math import sin", "from numpy import dot", "np.exp(x)", "pow = math.pow",
    ],
)  # fmt: skip
def test_the_lint_rule_reports_forbidden_arithmetic(line):
    assert list(violations(f"import math\nimport numpy as np\n{line}\n", "core/some.py"))


@pytest.mark.parametrize(
    "line",
    ["math.sqrt(x)", "np.sqrt(x)", "np.argsort(x, kind='stable')", "x * y", "f(**kwargs)", "name.partition(':')",
     "@kernel\ndef f(x):\n    return x**2", "rng.uniform(-1, 1)", "np.floor(x)"],
)  # fmt: skip
def test_the_lint_rule_permits_portable_arithmetic(line):
    assert not list(violations(f"import math\nimport numpy as np\n{line}\n", "core/some.py"))


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
