"""docs/benchmarks.md from the CSV files beside it: a head, and one function a section.

A section is a function of the folder: it reads its CSV files there and returns markdown, or "" where there are none.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from textwrap import fill

from benchmarks.studies.ahead import flights, throws
from benchmarks.studies.as_a_whole import scaling_section
from benchmarks.studies.beside_others import limits_section, peers_section, speed_error_section
from benchmarks.studies.paper import fig5, fig12, fig15, fig16, fig17, resolution, tables
from benchmarks.studies.study import Study
from benchmarks.studies.table import Table, read_table

PAGE = "benchmarks.md"
WIDTH = 120
STUDIES: dict[str, Study] = {
    module.STUDY.name: module.STUDY
    for module in (tables, fig5, fig12, resolution, fig15, fig16, fig17, flights, throws)
}
HEAD = """\
# Benchmarks

Made by `fracture-collision bench`; every figure below comes from a CSV file beside this page. The paper is Glondu,
Schvartzman, Marchal, Dumont, Otaduy, *Fast Collision Detection for Fracturing Rigid Bodies*, IEEE TVCG 20(1), 2014; its
figures are repeated with scenes of our own (`config/scenes/`), alike in kind and size. Times are wall times of one
thread, each timed run alone among the benchmark's processes; other programs may have run beside it (load).

**What to decide from this page.**

- *Convex hulls or this package?* With flat cracks, or where an error of a few per cent of R does not matter, hulls: in
  our scenes rapier's answers take a third to a sixth of our time (Frames of scenes). With curved cracks hulls push
  fragments apart that fit into each other, and report about one in ten of the pairs that have nothing in common.
- *Which settings?* The default. A larger `penetration_tolerance` costs depth and saves time; `visit_budget` bounds the
  time of a step, and each answer bounds what it missed (Speed against error; What people would use instead).
- *How large a scene?* A query's time grows with the pairs whose boxes overlap; the table of piles goes to 2,000
  fragments (The service as a whole).
- *Thin bodies at high speed?* `lookahead`; what gets through what at up to 200 m/s stands under "What goes through what
  between steps", its cost in [numerics.md](numerics.md), "Looking ahead".
"""


def study_files(folder: Path, study: Study, name: str, ending: str) -> Path:
    """Where a table (csv) or a picture (png) of a study lies."""
    return folder / f"bench_{study.name}{'_' if name else ''}{name}.{ending}"


def read_tables(folder: Path, study: Study) -> dict[str, Table]:
    """Those of its tables that are there."""
    stem = f"bench_{study.name}"
    files = [folder / f"{stem}.csv", *sorted(folder.glob(f"{stem}_*.csv"))]
    return {file.stem[len(stem) + 1 :]: read_table(file) for file in files if file.is_file()}


def _section_of(study: Study) -> Callable[[Path], str]:
    def section(folder: Path) -> str:
        found = read_tables(folder, study)
        if "" not in found:
            return ""
        about = found[""].about
        pictures = "\n".join(
            f"![{study.title}]({study_files(folder, study, name, 'png').name})" for name in study.pictures
        )
        files = ", ".join(f"[{name}]({name})" for name in (study_files(folder, study, n, "csv").name for n in found))
        try:
            text = study.section(found)
        except KeyError as column:
            again = f"Run `fracture-collision bench {study.name}` again."
            text = f"Made by other sources: column {column} is missing. {again}\n"
        made = f"{files}; {about.get('effort', '')}, load {about.get('load', '?')}, {about.get('cpu', '?')}"
        return f"## {study.title}\n\n{text}\n{pictures}\n\n<sub>{made}</sub>\n"

    return section


SECTIONS: tuple[Callable[[Path], str], ...] = (
    speed_error_section,
    peers_section,
    limits_section,
    scaling_section,
    *(_section_of(study) for study in STUDIES.values()),
)


def wrapped(markdown: str) -> str:
    """Paragraphs filled to the width of this page; what is a table, a picture or a heading stays."""
    blocks = [
        block if block.startswith(("|", "#", "!", "<", "- ")) else fill(block, WIDTH, break_on_hyphens=False)
        for block in markdown.strip("\n").split("\n\n")
    ]
    return "\n\n".join(blocks) + "\n"


def write_page(folder: Path) -> Path:
    """The page of all that lies in the folder."""
    parts = [part for part in (section(folder) for section in SECTIONS) if part]
    page = folder / PAGE
    page.write_text("\n".join(wrapped(part) for part in (HEAD, *parts, _machines(folder))), encoding="utf-8")
    return page


def _machines(folder: Path) -> str:
    """Which sections were made with what."""
    made: dict[tuple[str, ...], list[str]] = {}
    for study in STUDIES.values():
        about = read_tables(folder, study).get("", Table({}, [])).about
        if about:
            key = tuple(about.get(name, "?") for name in ("cpu", "system", "versions", "sources"))
            made.setdefault(key, []).append(study.name)
    lines = [
        f"- {', '.join(names)}: {cpu}; {system}; {versions}; sources {sources}"
        for (cpu, system, versions, sources), names in made.items()
    ]
    return "\n".join(("## Made with\n", *lines, ""))
