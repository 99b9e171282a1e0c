"""Writes records as a rosbag2 folder with mcap alone, to test the bag readers independently of the bag writer."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from mcap_ros2.writer import Writer

MESSAGES = Path(__file__).parents[2] / "msg"
DEPENDENCIES = {
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec",
    "shape_msgs/Plane": "float64[4] coef",
    "shape_msgs/SolidPrimitive": "uint8 type\nfloat64[<=3] dimensions\ngeometry_msgs/Polygon polygon",
    "geometry_msgs/Polygon": "geometry_msgs/Point32[] points",
    "geometry_msgs/Point32": "float32 x\nfloat32 y\nfloat32 z",
}
TOPICS = {
    "CollisionBody": "bodies",
    "FractureEvent": "fracture_events",
    "FragmentStates": "fragment_states",
    "ContactConstraintArray": "contact_constraints",
    "FragmentRegistry": "fragments",
    "FragmentMesh": "fragment_meshes",
}


def write_bag(
    folder: Path, records: Iterable[tuple[float, Any]], namespace: str = "", run_id: int = 1,
    lacking: frozenset[str] = frozenset(),
) -> None:  # fmt: skip
    """`records`: (simulated time [s], record) in order; `folder` is created, or the records are appended to it.

    `lacking`: fields that the messages' definitions do not have, as those of an earlier version.
    """
    folder.mkdir(parents=True, exist_ok=True)
    name = f"{folder.name}_{len(list(folder.glob('*.mcap')))}.mcap"
    with (folder / name).open("wb") as stream:
        writer = Writer(stream)
        schemas = {
            kind: writer.register_msgdef(f"fracture_collision/msg/{kind}", _definition(kind, lacking))
            for kind in TOPICS
        }
        for time, record in records:
            kind = type(record).__name__
            stamp = {"sec": int(time), "nanosec": round((time - int(time)) * 1e9)}
            message = {"header": {"stamp": stamp, "frame_id": "world"}, "run_id": run_id, **_fields(record)}
            message = {name: value for name, value in message.items() if name not in lacking or kind == "FractureEvent"}
            writer.write_message(f"{namespace}/{TOPICS[kind]}", schemas[kind], message, log_time=round(time * 1e9))
        writer.finish()
    files = sorted(path.name for path in folder.glob("*.mcap"))
    (folder / "metadata.yaml").write_text(
        yaml.safe_dump({"rosbag2_bagfile_information": {"relative_file_paths": files, "storage_identifier": "mcap"}})
    )


def _definition(kind: str, lacking: frozenset[str]) -> str:
    lines = (MESSAGES / f"{kind}.msg").read_text().splitlines()
    if kind != "FractureEvent":  # its sequence was always there
        lines = [line for line in lines if lacking.isdisjoint(line.split()[1:2])]
    parts = ["\n".join(lines)]
    parts += [f"MSG: {name}\n{text}" for name, text in DEPENDENCIES.items()]
    return ("\n" + "=" * 80 + "\n").join(parts)


def _fields(record: Any) -> dict[str, Any]:
    fields = {k: v.ravel().tolist() if isinstance(v, np.ndarray) else v for k, v in record._asdict().items()}
    if "plane" in fields:
        fields["plane"] = {"coef": fields["plane"]}
        fields["primitive"] = {
            "type": record.primitive.type,
            "dimensions": list(record.primitive.dimensions),
            "polygon": {"points": []},
        }
    return fields
