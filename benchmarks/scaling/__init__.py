"""How our service's time and memory scale: `python -m benchmarks.scaling --help`.

`piles` makes the work; `growth`, `memory`, `updates`, `visits` and `round_trips` measure, a function `measure_*` each;
`report` writes the results.
"""
