"""Our service and the libraries people would use instead, measured in one run on the same work.

    python -m benchmarks.peers --help

`worlds` makes the work, `method` defines a method, `ours` and one file per library family implement the methods,
`truth` and `score` judge their answers, `solver_error` computes the effect on a solver, `measure` runs the methods in
turn, `report` writes the results.
"""
