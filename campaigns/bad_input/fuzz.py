"""`python -m campaigns.bad_input.fuzz`: a coverage-guided fuzzer (atheris, on libFuzzer) looks for bad input.

It decides which mutation is done to what, and it writes messages byte by byte; what leads to lines of world/ and of the
readers in ros/ that it has not seen it keeps and varies. A case that does not come to what must come of it ends the
search with the case's words, and libFuzzer writes the input that led there, which may be given as an argument again.
Numba's kernels are not instrumented: that would change what is compiled.
"""

from __future__ import annotations

import sys
from pathlib import Path

import atheris
import click

from campaigns import bad_input

PACKAGE = bad_input.ROOT / "fracture_collision"
INSTRUMENTED = ("world", "ros")
KERNELS = ("world.gates.fracture_match", "world.contact_ids")
RAW = 255  # as an input's first byte: a topic and a message follow


def _left_alone() -> list[str]:
    """All modules of the package except those of the gates and the readers."""
    names = [".".join(file.relative_to(PACKAGE).with_suffix("").parts) for file in PACKAGE.rglob("*.py")]
    names = [name for name in names if name in KERNELS or name.split(".")[0] not in INSTRUMENTED]
    return [f"{PACKAGE.name}.{name.removesuffix('.__init__')}" for name in names]


with atheris.instrument_imports(include=[PACKAGE.name], exclude=_left_alone()):
    from campaigns.bad_input.campaign import DOORS, TOPICS
    from campaigns.bad_input.clean_scene import SETTINGS
    from campaigns.bad_input.mutations import Pick
    from campaigns.bad_input.serialized import valid_messages
    from campaigns.bad_input.trial import Bench, Case, given_bytes, several, single, spoilt


@click.command(help=__doc__)
@click.option("--seconds", default=300, show_default=True, type=click.IntRange(1))
@click.option("--corpus", type=click.Path(file_okay=False, path_type=Path), default=bad_input.ROOT / "out" / "fuzz",
              help="Kept there for the next time; what was found stands beside it.")  # fmt: skip
@click.argument("inputs", nargs=-1, type=click.Path(exists=True))
def main(seconds: int, corpus: Path, inputs: tuple[str, ...]) -> None:
    benches = {door: Bench(door, SETTINGS) for door in DOORS}

    def try_input(data: bytes) -> None:
        door, case = case_of(data)
        problem = benches[door].judge(case)
        if problem:
            raise AssertionError(f"{door}, {case.topic}, {case.name}: {problem}")

    if not inputs:
        write_seeds(corpus)
        inputs = (
            str(corpus), f"-artifact_prefix={corpus}_found_", f"-max_total_time={seconds}", "-max_len=4096",
            "-print_final_stats=1", "-timeout=60",
        )  # fmt: skip
    atheris.Setup([sys.argv[0], *inputs], try_input)
    atheris.Fuzz()


def case_of(data: bytes) -> tuple[str, Case]:
    """Door and case encoded by an input."""
    if data[:1] == bytes([RAW]) and len(data) > 1:
        return "messages", given_bytes(TOPICS[data[1] % len(TOPICS)], data[2:])
    pick = picking_from(data)
    topic, door, form, entry = TOPICS[pick(len(TOPICS))], DOORS[pick(len(DOORS))], pick(3), pick(2**16)
    if form == 2:
        return "messages", spoilt(topic, pick)
    case = single(topic, entry, pick) if form == 0 else several(topic, entry, pick, 2 + entry % 3)
    return (door if case.on_the_wire else "records"), case


def picking_from(data: bytes) -> Pick:
    decisions = atheris.FuzzedDataProvider(data)

    def pick(below: int) -> int:
        if below < 1:
            raise ValueError("nothing to pick from")
        return decisions.ConsumeUInt(8) % below if below > 2**31 else decisions.ConsumeIntInRange(0, below - 1)

    return pick


def write_seeds(corpus: Path) -> None:
    """Writes every valid message as the initial corpus."""
    corpus.mkdir(parents=True, exist_ok=True)
    for number, topic in enumerate(TOPICS):
        for i, data in enumerate(valid_messages(topic)):
            (corpus / f"valid_{topic}_{i}").write_bytes(bytes([RAW, number]) + data)


if __name__ == "__main__":
    main()
