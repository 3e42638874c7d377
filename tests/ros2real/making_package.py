"""Makes a Python package of messages and services in a folder: `ROS_PYTHON making_package.py PACKAGE FOLDER`.

No wheel has the packages by which a component container is spoken to, and nodes tell topic statistics. They are written
here by their fields; the generators of ROS make C of them, and the system's compiler one extension.
"""

from __future__ import annotations

import json
import subprocess
import sys
import sysconfig
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Package:
    """A package of ROS: its files by path, and the packages that they need."""

    files: Mapping[str, str]
    needed: tuple[str, ...]


PACKAGES = {
    "composition_interfaces": Package(
        {
            "srv/LoadNode.srv": """\
string package_name
string plugin_name
string node_name
string node_namespace
uint8 log_level
string[] remap_rules
rcl_interfaces/Parameter[] parameters
rcl_interfaces/Parameter[] extra_arguments
---
bool success
string error_message
string full_node_name
uint64 unique_id
""",
            "srv/UnloadNode.srv": """\
uint64 unique_id
---
bool success
string error_message
""",
            "srv/ListNodes.srv": """\
---
string[] full_node_names
uint64[] unique_ids
""",
        },
        ("rcl_interfaces", "service_msgs", "builtin_interfaces"),
    ),
    "statistics_msgs": Package(
        {
            "msg/StatisticDataType.msg": """\
uint8 STATISTICS_DATA_TYPE_UNINITIALIZED = 0
uint8 STATISTICS_DATA_TYPE_AVERAGE = 1
uint8 STATISTICS_DATA_TYPE_MINIMUM = 2
uint8 STATISTICS_DATA_TYPE_MAXIMUM = 3
uint8 STATISTICS_DATA_TYPE_STDDEV = 4
uint8 STATISTICS_DATA_TYPE_SAMPLE_COUNT = 5
""",
            "msg/StatisticDataPoint.msg": """\
uint8 data_type
float64 data
""",
            "msg/MetricsMessage.msg": """\
string measurement_source_name
string metrics_source
string unit
builtin_interfaces/Time window_start
builtin_interfaces/Time window_stop
StatisticDataPoint[] statistics
""",
        },
        ("builtin_interfaces",),
    ),
}
"""By name."""
TYPE_SUPPORTS = ("rosidl_typesupport_fastrtps_c", "rosidl_typesupport_introspection_c")
INTROSPECTED = "introspected"
"""The folder of the code of the second type support; it has files of the same names."""
C_PARTS = ("rosidl_generator_c", *TYPE_SUPPORTS, "rosidl_typesupport_c", "rosidl_generator_py")
LIBRARIES = (
    "rosidl_typesupport_introspection_c",
    "rosidl_runtime_c",
    "rosidl_typesupport_c",
    "rosidl_typesupport_fastrtps_c",
    "rmw",
    "rcutils",
    "fastcdr",
)
PREFIX = Path(sys.prefix)


def write_code(name: str, made: Path) -> None:
    """Write the C and Python of all messages and services."""
    import rosidl_generator_c
    import rosidl_generator_py
    import rosidl_typesupport_c
    import rosidl_typesupport_fastrtps_c
    import rosidl_typesupport_introspection_c
    from rosidl_adapter.msg import convert_msg_to_idl
    from rosidl_adapter.srv import convert_srv_to_idl
    from rosidl_generator_type_description import generate_type_hash

    package, share = PACKAGES[name], PREFIX / "share"
    for file, text in package.files.items():
        path = Path(file)
        Path(made, path).write_text(text)
        convert = convert_srv_to_idl if path.suffix == ".srv" else convert_msg_to_idl
        convert(made, name, path, made / path.parent)
    idls = [str(Path(file).with_suffix(".idl")) for file in package.files]
    others = [f"{other}:{share / other}" for other in package.needed]

    def arguments(generator: str, folder: Path = made) -> str:
        path = made / f"{generator}.json"
        said = {
            "package_name": name,
            "output_dir": str(folder),
            "template_dir": str(share / generator / "resource"),
            "idl_tuples": [f"{made}:{idl}" for idl in idls],
            "include_paths": others,
            "ros_interface_dependencies": others,
            "target_dependencies": [],
            "type_description_tuples": [f"{idl}:{made / idl.removesuffix('.idl')}.json" for idl in idls],
        }
        path.write_text(json.dumps(said))
        return str(path)

    generate_type_hash(arguments("rosidl_generator_type_description"))
    rosidl_generator_c.generate_c(arguments("rosidl_generator_c"))
    rosidl_typesupport_fastrtps_c.generate_typesupport_fastrtps_c(arguments("rosidl_typesupport_fastrtps_c"))
    (introspected := made / INTROSPECTED / name).mkdir(parents=True)
    rosidl_typesupport_introspection_c.generate_c(arguments("rosidl_typesupport_introspection_c", introspected))
    rosidl_typesupport_c.generate_c(arguments("rosidl_typesupport_c"), [*TYPE_SUPPORTS])
    rosidl_generator_py.generate_py(arguments("rosidl_generator_py"), ["rosidl_typesupport_c"])
    for kind in ("rosidl_generator_c", *TYPE_SUPPORTS):
        words = "".join(f"#define {kind.upper()}_{what}_{name}\n" for what in ("EXPORT", "IMPORT", "PUBLIC"))
        Path(made, "msg", f"{kind}__visibility_control.h").write_text(words)


def compile_code(name: str, made: Path) -> None:
    """Compile the C into a library for each type support, by whose name ROS looks it up, and Python's extension."""
    import numpy

    include = PREFIX / "include"
    folders = [include, *filter(Path.is_dir, include.iterdir()), sysconfig.get_paths()["include"], numpy.get_include()]
    folders = [made.parent, made / INTROSPECTED, *folders]
    flags = ["-O0", "-fPIC", "-w", *(f"-I{folder}" for folder in folders)]
    of_python: list[str] = []
    of_support: dict[str, list[str]] = {support: [] for support in TYPE_SUPPORTS}
    for number, source in enumerate([*made.rglob("*.c"), *made.rglob("*.cpp")]):
        compiled = str(made / f"{number}.o")
        compiler = "g++" if source.suffix == ".cpp" else "gcc"
        subprocess.run([compiler, *flags, "-c", str(source), "-o", compiled], check=True)
        if source.name.endswith("_s.c") or ".ep." in source.name:
            of_python.append(compiled)
        else:
            of_support[TYPE_SUPPORTS[INTROSPECTED in source.parts]].append(compiled)
    parts = (f"{other}__{part}" for other in PACKAGES[name].needed for part in C_PARTS)
    libraries = [f"-l{library}" for library in (*parts, *LIBRARIES)]
    linked = ["-shared", f"-L{PREFIX / 'lib'}", f"-L{made}", "-Wl,--no-as-needed", "-Wl,-rpath,$ORIGIN"]
    own: list[str] = []
    for support, objects in of_support.items():
        file = f"lib{name}__{support}.so"
        named = [f"-Wl,-soname,{file}", "-o", str(made / file)]
        subprocess.run(["g++", *linked, *objects, *named, *own, *libraries], check=True)
        own.append(f"-l{name}__{support}")
    extension = str(made / f"{name}_s__rosidl_typesupport_c.so")
    subprocess.run(["g++", *linked, *of_python, "-o", extension, *own, *libraries], check=True)


def main(name: str, folder: str) -> None:
    """Make the package of this name."""
    made = Path(folder).resolve() / name
    for part in ("srv", "msg"):
        Path(made, part).mkdir(parents=True)
    Path(made, "__init__.py").touch()
    write_code(name, made)
    compile_code(name, made)


if __name__ == "__main__":
    main(*sys.argv[1:])
