"""Speed against error, one picture: `python -m benchmarks.speed_error --help`.

On top of `benchmarks.peers`, whose worlds, methods, truth and CSV these are: `measure` runs ours in many settings
beside the libraries people would use instead, `points` reads the CSV, `picture` draws from that alone.
"""
