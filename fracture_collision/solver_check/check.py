"""Runs cases and judges them."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from fracture_collision.extras import MissingExtra
from fracture_collision.solver_check.cases import Case, Figure, Part
from fracture_collision.solver_check.recorded import Recorded
from fracture_collision.solver_check.solver_runs import LeftOut, UnknownSolver


class Outcome(NamedTuple):
    """A case's figures."""

    case: Case
    figures: list[Figure]
    error: str = ""  # why it could not be judged
    left_out: str = ""  # why it does not apply

    @property
    def passes(self) -> bool:
        """Whether all figures are within their bounds."""
        return not self.error and all(figure.passes for figure in self.figures)


class CouldNotRun(RuntimeError):
    """A run that did not end as it should; the text has the reason."""


def check_case(case: Case, run: Callable[[str, Part], Recorded]) -> Outcome:
    """The outcome of a case. `run` gets a name and a part, and returns what was published.

    An exception of a solver, and CouldNotRun, are outcomes: such a case fails.
    """
    recorded: dict[str, Recorded] = {}
    figures: list[Figure] = []
    for name, part in case.parts.items():
        try:
            recorded[name] = run(f"{case.name} {name}", part)
        except (KeyboardInterrupt, UnknownSolver, MissingExtra):
            raise
        except LeftOut as error:
            return Outcome(case, [], left_out=str(error))
        except Exception as error:
            words = str(error) if isinstance(error, CouldNotRun) else f"{type(error).__name__}: {error}"
            return Outcome(case, [], f"the run {name!r} ended early: {words}")
    try:
        figures.extend(case.judge(recorded))
    except (ValueError, KeyError, IndexError) as error:
        return Outcome(case, figures, f"what was published cannot be judged: {error}")
    return Outcome(case, figures)
