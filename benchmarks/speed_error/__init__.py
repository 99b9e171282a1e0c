"""Speed against error in one picture: `python -m benchmarks.speed_error --help`.

Built on `benchmarks.peers` with its worlds, methods, truth and CSV: `measure` runs ours in many settings and the
libraries people would use instead, `points` reads the CSV, `picture` draws from the CSV alone.
"""
