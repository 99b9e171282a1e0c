"""Bad input: every field of every message corrupted in every way that its type and meaning allow, and random bytes.

`clean_scene` is the scene that receives them; `body_mutations`, `event_mutations` and `states_mutations` define what is
done to which field and the expected result; `serialized` corrupts bytes instead of fields; `doors` are the entry
points; `trial` judges one case, `campaign` runs many; in `fuzz` a coverage-guided fuzzer replaces the random generator.

Their fixtures, a small broken world and every rule violated once, live with the tests.
"""

from __future__ import annotations

import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
if str(ROOT / "test") not in sys.path:
    sys.path.append(str(ROOT / "test"))
