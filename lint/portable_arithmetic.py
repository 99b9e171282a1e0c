"""Forbids arithmetic that may round differently from processor to processor in what affects a trajectory or an answer.

In core, world, geometry, fracture, meshing and simulation this forbids BLAS and LAPACK (`numpy.linalg`, `dot`, `@`,
...), elementary functions of numpy, of `math` and of numba (which calls libm for both), powers (except integer ones in
kernels), normally distributed numbers, sorts that leave the order of equal keys open, scipy and engines. Replacements
are in fracture_collision/portable_math.py. EXCEPTIONS lists permitted cases, with the reason.

    python -m lint.portable_arithmetic
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator
from pathlib import Path

PACKAGE = Path(__file__).parents[1] / "fracture_collision"
ROOMS = ("core", "world", "geometry", "fracture", "meshing", "simulation")
FILES = (PACKAGE / "portable_math.py", PACKAGE / "lockstep.py", PACKAGE / "records.py")

# (file, what): why it is allowed
EXCEPTIONS = {
    ("core/bodies/body_validator.py", "*"): "checks structures for tests and influences nothing",
    ("geometry/surface_files.py", "scipy"): "connected components of triangles: combinatorics",
    ("geometry/sampled_bodies.py", "scipy"): "Qhull's Delaunay: compiled once, + - * / and square roots",
    ("geometry/vase.py", "scipy"): "monotone cubics (PCHIP): compiled once, + - * /",
    ("simulation/mujoco_dynamics.py", "*"): "MuJoCo's own differs between processors; its docstring says so",
    ("simulation/mujoco_model.py", "*"): "likewise",
    ("simulation/actors/bullet_robot.py", "pybullet"): "Bullet's own differs between processors; its docstring says so",
}

FOREIGN = {"scipy", "mujoco", "pybullet"}
MATH = {"sqrt", "floor", "ceil", "fabs", "copysign", "isfinite", "isinf", "isnan", "isclose", "inf", "nan", "pi"}
NUMPY = {
    "linalg", "fft", "dot", "vdot", "inner", "matmul", "vecdot", "matvec", "vecmat", "tensordot", "einsum",
    "einsum_path", "kron", "cov", "corrcoef", "polyfit", "convolve", "correlate", "exp", "exp2", "expm1", "log", "log2",
    "log10", "log1p", "logaddexp", "logaddexp2", "sin", "cos", "tan", "arcsin", "arccos", "arctan", "arctan2", "asin",
    "acos", "atan", "atan2", "sinh", "cosh", "tanh", "arcsinh", "arccosh", "arctanh", "asinh", "acosh", "atanh",
    "power", "pow", "float_power", "hypot", "cbrt", "angle", "sinc", "i0", "partition", "argpartition",
}  # fmt: skip
METHODS = {"dot", "argpartition", "partition"}  # of arrays; str.partition is recognised by its argument
# Methods of a random generator: their rejection sampling calls exp, log1p or pow.
GENERATOR = {
    "normal", "standard_normal", "lognormal", "exponential", "standard_exponential", "gamma", "standard_gamma", "beta",
    "chisquare", "multivariate_normal", "poisson", "binomial", "laplace", "logistic", "gumbel", "weibull", "pareto",
    "rayleigh", "wald", "vonmises", "triangular", "power", "dirichlet",
}  # fmt: skip
KERNELS = {"kernel", "query_kernel", "threaded_kernel", "uncounted", "njit"}


def violations(source: str, file: str) -> Iterator[tuple[int, str, str]]:
    """(line, what is forbidden, message) of each violation, in the order of the tree."""
    tree = ast.parse(source, file)
    modules = _modules(tree)
    in_kernels = {
        node for function in ast.walk(tree) if isinstance(function, ast.FunctionDef) and _is_kernel(function)
        for node in ast.walk(function)
    }  # fmt: skip
    for node in ast.walk(tree):
        found = _violation(node, modules, node in in_kernels)
        if found is not None:
            yield node.lineno, *found


def _violation(node: ast.AST, modules: dict[str, str], in_kernel: bool) -> tuple[str, str] | None:
    if isinstance(node, ast.Import | ast.ImportFrom):
        names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else [node.module or ""]
        for name in names:
            if (package := name.split(".")[0]) in FOREIGN:
                return package, f"{name}: {package}'s rounding is not known to be the same everywhere"
        if isinstance(node, ast.ImportFrom) and node.module in ("math", "numpy"):
            allowed = MATH if node.module == "math" else None
            for alias in node.names:
                if alias.name not in allowed if allowed is not None else alias.name in NUMPY:
                    return alias.name, f"{node.module}.{alias.name} rounds by the processor; see portable_math"
    if isinstance(node, ast.BinOp | ast.AugAssign):
        if isinstance(node.op, ast.MatMult):
            return "@", "@ is BLAS: portable_math.products, images or dots"
        if isinstance(node.op, ast.Pow):
            exponent = node.right if isinstance(node, ast.BinOp) else node.value
            whole = isinstance(exponent, ast.Constant) and isinstance(exponent.value, int)
            if not (whole and in_kernel):
                return "**", "** is pow of libm or of numpy: multiply, or portable_math.power"
    if isinstance(node, ast.Attribute):
        module = modules.get(node.value.id) if isinstance(node.value, ast.Name) else None
        if module == "math" and node.attr not in MATH:
            return node.attr, f"math.{node.attr} is libm: see portable_math"
        if module == "numpy" and node.attr in NUMPY:
            return node.attr, f"np.{node.attr} rounds or orders by the processor; see portable_math"
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
        name, keywords = node.func.attr, {keyword.arg: keyword.value for keyword in node.keywords}
        receiver = modules.get(node.func.value.id) if isinstance(node.func.value, ast.Name) else None
        if receiver is None and name in METHODS and not (node.args and _is_text(node.args[0])):
            return name, f".{name}() rounds or orders by the processor; see portable_math"
        if receiver is None and name in GENERATOR:
            return name, f".{name}() of a generator takes exp or log of libm: portable_math.normal_numbers"
        if name == "argsort" and not _is_stable(keywords.get("kind")):
            return name, 'argsort leaves the order of equal keys to the processor: kind="stable"'
    return None


def _is_text(node: ast.AST) -> bool:
    return isinstance(node, ast.Constant) and isinstance(node.value, str)


def _is_stable(kind: ast.AST | None) -> bool:
    return isinstance(kind, ast.Constant) and kind.value in ("stable", "mergesort")


def _is_kernel(function: ast.FunctionDef) -> bool:
    names = set()
    for decorator in function.decorator_list:
        called = decorator.func if isinstance(decorator, ast.Call) else decorator
        names.add(called.id if isinstance(called, ast.Name) else getattr(called, "attr", ""))
    return bool(names & KERNELS)


def _modules(tree: ast.AST) -> dict[str, str]:
    """Names under which modules are imported."""
    found = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.asname or alias.name: alias.name for alias in node.names}
    return found


def main() -> int:
    """Prints violations and exceptions that nothing needs; returns the exit status."""
    count, needed = 0, set()
    for file in [*FILES, *sorted(path for room in ROOMS for path in (PACKAGE / room).rglob("*.py"))]:
        name = file.relative_to(PACKAGE).as_posix()
        for line, what, message in violations(file.read_text(), name):
            excused = {(name, what), (name, "*")} & EXCEPTIONS.keys()
            needed |= excused
            if not excused:
                print(f"fracture_collision/{name}:{line}: {message}")
                count += 1
    for name, what in EXCEPTIONS.keys() - needed:
        print(f"lint/portable_arithmetic.py: nothing in {name} needs the exception for {what}")
        count += 1
    print(f"Portable arithmetic: {count} found" if count else "Portable arithmetic: kept")
    return 1 if count else 0


if __name__ == "__main__":
    sys.exit(main())
