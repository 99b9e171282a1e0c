"""Ours and what people would use instead, measured in one run on the same work: `python -m benchmarks.peers --help`.

`worlds` makes the work, `method` says what a method is, `ours` and a file a family hold the methods, `truth` and
`score` judge their answers, `solver_error` what a solver would make of them, `measure` runs them in turn, `report`
writes down what came out.
"""
