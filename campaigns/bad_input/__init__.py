"""Bad input: every field of every message spoilt in every way that its type and meaning offer, and random bytes.

`clean_scene` is the scene they are fed into, `body_mutations`, `event_mutations` and `states_mutations` say what is
done to which field and what must come of it, `serialized` spoils bytes in place of fields, `doors` are the ways in,
`trial` judges one case, `campaign` runs many, and in `fuzz` a coverage-guided fuzzer decides in place of a random
generator.

What they fit, a small broken world and every rule broken once, is kept with the tests.
"""

from __future__ import annotations

import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
if str(ROOT / "test") not in sys.path:
    sys.path.append(str(ROOT / "test"))
