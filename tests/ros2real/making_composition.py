"""Makes the Python package `composition_interfaces` in a folder: `ROS_PYTHON making_composition.py FOLDER`.

No wheel has the package by which a component container is spoken to. Its three services are written here by their
fields; the generators of ROS make C of them, and the system's compiler one extension.
"""

from __future__ import annotations

import json
import subprocess
import sys
import sysconfig
from pathlib import Path

PACKAGE = "composition_interfaces"
SERVICES = {
    "LoadNode": """\
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
    "UnloadNode": """\
uint64 unique_id
---
bool success
string error_message
""",
    "ListNodes": """\
---
string[] full_node_names
uint64[] unique_ids
""",
}
NEEDED = ("rcl_interfaces", "service_msgs", "builtin_interfaces")
C_PARTS = ("rosidl_generator_c", "rosidl_typesupport_fastrtps_c", "rosidl_typesupport_c", "rosidl_generator_py")
LIBRARIES = ("rosidl_runtime_c", "rosidl_typesupport_c", "rosidl_typesupport_fastrtps_c", "rmw", "rcutils", "fastcdr")
PREFIX = Path(sys.prefix)


def write_code(made: Path) -> None:
    """Write the C and Python of all services."""
    import rosidl_generator_c
    import rosidl_generator_py
    import rosidl_typesupport_c
    import rosidl_typesupport_fastrtps_c
    from rosidl_adapter.srv import convert_srv_to_idl
    from rosidl_generator_type_description import generate_type_hash

    for name, text in SERVICES.items():
        Path(made, "srv", f"{name}.srv").write_text(text)
        convert_srv_to_idl(made, PACKAGE, Path("srv", f"{name}.srv"), made / "srv")
    share = PREFIX / "share"
    others = [f"{name}:{share / name}" for name in NEEDED]

    def arguments(generator: str) -> str:
        path = made / f"{generator}.json"
        said = {
            "package_name": PACKAGE,
            "output_dir": str(made),
            "template_dir": str(share / generator / "resource"),
            "idl_tuples": [f"{made}:srv/{name}.idl" for name in SERVICES],
            "include_paths": others,
            "ros_interface_dependencies": others,
            "target_dependencies": [],
            "type_description_tuples": [f"srv/{name}.idl:{made}/srv/{name}.json" for name in SERVICES],
        }
        path.write_text(json.dumps(said))
        return str(path)

    generate_type_hash(arguments("rosidl_generator_type_description"))
    rosidl_generator_c.generate_c(arguments("rosidl_generator_c"))
    rosidl_typesupport_fastrtps_c.generate_typesupport_fastrtps_c(arguments("rosidl_typesupport_fastrtps_c"))
    rosidl_typesupport_c.generate_c(arguments("rosidl_typesupport_c"), ["rosidl_typesupport_fastrtps_c"])
    rosidl_generator_py.generate_py(arguments("rosidl_generator_py"), ["rosidl_typesupport_c"])
    for kind in ("rosidl_generator_c", "rosidl_typesupport_fastrtps_c"):
        words = "".join(f"#define {kind.upper()}_{what}_{PACKAGE}\n" for what in ("EXPORT", "IMPORT", "PUBLIC"))
        Path(made, "msg", f"{kind}__visibility_control.h").write_text(words)


def compile_code(made: Path) -> None:
    """Compile all C into the one extension that Python loads."""
    import numpy

    include = PREFIX / "include"
    folders = [include, *filter(Path.is_dir, include.iterdir()), sysconfig.get_paths()["include"], numpy.get_include()]
    flags = ["-O0", "-fPIC", "-w", f"-I{made.parent}", *(f"-I{folder}" for folder in folders)]
    objects = []
    for number, source in enumerate([*made.rglob("*.c"), *made.rglob("*.cpp")]):
        objects.append(str(made / f"{number}.o"))
        compiler = "g++" if source.suffix == ".cpp" else "gcc"
        subprocess.run([compiler, *flags, "-c", str(source), "-o", objects[-1]], check=True)
    libraries = [f"-l{name}" for name in (*(f"{name}__{part}" for name in NEEDED for part in C_PARTS), *LIBRARIES)]
    extension = str(made / f"{PACKAGE}_s__rosidl_typesupport_c.so")
    subprocess.run(["g++", "-shared", *objects, "-o", extension, f"-L{PREFIX / 'lib'}", *libraries], check=True)


def main(folder: str) -> None:
    """Make the package."""
    made = Path(folder).resolve() / PACKAGE
    for part in ("srv", "msg"):
        Path(made, part).mkdir(parents=True)
    Path(made, "__init__.py").touch()
    write_code(made)
    compile_code(made)


if __name__ == "__main__":
    main(*sys.argv[1:])
