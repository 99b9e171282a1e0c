"""How ours grows, remembers and spends its time: `python -m benchmarks.scaling --help`.

`piles` makes the work; `growth`, `memory`, `updates`, `visits` and `round_trips` measure, a function `measure_*` each;
`report` writes down what came out.
"""
