"""The ports that source files of a node name, and the search for these files in its package. No file is run."""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial
from pathlib import Path

from cfgplan.ros.code.code_ports import CodeReading, Place, ports_of_code
from cfgplan.ros.code.cpp_ports import cpp_ports
from cfgplan.ros.code.cpp_tokens import CppFile, cpp_file
from cfgplan.ros.code.python_ports import imported_modules, python_ports
from cfgplan.ros.graph import RosNode, RosPort
from cfgplan.ros.substitutions import package_folder

_CPP = frozenset((".cpp", ".cc", ".cxx", ".c", ".cu"))
_HEADERS = frozenset((".h", ".hpp", ".hh", ".hxx", ".cuh"))
_OTHERS = frozenset((".py", ".txt", ".xml", ".cmake", ""))
_LEFT_OUT = frozenset(("test", "tests", "build", "install", "devel", "log", "node_modules"))
LARGEST_FILE = 1_000_000
"""Bytes of the largest source file that is read."""
MOST_FILES = 2000
"""The most files of a package that are read."""
MOST_OF_A_NODE = 60
"""Source files that are read for one node."""
_CMAKE_COMMAND = re.compile(r"([A-Za-z_]\w*)\s*\(((?:[^()\"]|\"(?:[^\"\\]|\\.)*\"|\([^()]*\))*)\)")
_WORD = re.compile(r'"((?:[^"\\]|\\.)*)"|([^\s";]+)')
_VARIABLE = re.compile(r"\$\{([\w.-]+)\}")
_REGISTERED = re.compile(
    r"\b(?:PLUGINLIB_EXPORT_CLASS|RCLCPP_COMPONENTS_REGISTER_NODE|CLASS_LOADER_REGISTER_CLASS)\s*\(\s*([\w:]+)"
    r"|\bPLUGINLIB_DECLARE_CLASS\s*\(\s*\w+\s*,\s*\w+\s*,\s*([\w:]+)"
)
_PLUGIN = re.compile(r"<class\b([^>]*)>")
_ATTRIBUTE = re.compile(r"\b(name|type)\s*=\s*[\"']([^\"']*)[\"']")
_ENTRY = re.compile(r"[\"']\s*([\w.-]+)\s*=\s*([\w.]+)\s*:\s*[\w.]+\s*[\"']")


@dataclass(frozen=True)
class SourcePorts:
    """The ports of a node with the place of each, and the calls whose names are computed.

    `is_whole_package` is True where the package does not say which files its executables have, so that all were read.
    """

    places: Mapping[RosPort, Place]
    unclear: tuple[str, ...]
    is_whole_package: bool


def ports_of_sources(node: RosNode, shared: Mapping[str, object]) -> SourcePorts:
    """The ports that the sources of a node's package name; none if the package is not here.

    The package is looked for near the node's launch file and where the environment says that packages are. `shared` are
    the parameters that were set outside of nodes, by full name.
    """
    folder = package_folder(node.package, node.file) if node.package and node.file else None
    if folder is None:
        return SourcePorts({}, (), is_whole_package=False)
    package = _package(folder)
    files = tuple(package.files_of(node))
    is_whole_package = not files and not package.tells_files
    places, unclear = ports_of_code(package.reading(package.all_sources if is_whole_package else files), node, shared)
    return SourcePorts(places, tuple(dict.fromkeys(unclear)), is_whole_package=is_whole_package)


class _Package:
    """The sources in a folder."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder.resolve()
        self._read: dict[tuple[Path, ...], CodeReading] = {}

    @cached_property
    def _files(self) -> tuple[Path, ...]:
        """The files that may have ports, nearest to the folder first; hidden folders and tests are left out."""
        found, folders = list[Path](), deque([self._folder])
        while folders and len(found) < MOST_FILES:
            try:
                inside = sorted(folders.popleft().iterdir())
            except OSError:
                continue
            for each in inside:
                if each.name.startswith(".") or each.is_symlink():
                    continue
                if each.is_dir():
                    is_other = each.name in _LEFT_OUT or (each / "package.xml").is_file()
                    folders.extend([] if is_other else [each])
                elif each.suffix in _CPP | _HEADERS | _OTHERS:
                    found.append(each)
        return tuple(found[:MOST_FILES])

    @property
    def tells_files(self) -> bool:
        """Whether the package names the files of any executable or plugin."""
        return bool(self._executables or self._entry_points or self._registered)

    @property
    def all_sources(self) -> tuple[Path, ...]:
        """All source files, for nodes whose own files are not known."""
        named = {"setup.py", "conf.py", "__init__.py"}
        scripts = [each for each in self._files if self._is_python(each) and each.name not in named]
        launch = [each for each in scripts if each.name.endswith(".launch.py")]
        return tuple([each for each in self._files if each.suffix in _CPP | _HEADERS] + sorted({*scripts} - {*launch}))

    def files_of(self, node: RosNode) -> Iterator[Path]:
        """Return the source files of a node's program and the package's files that they use; empty if unknown."""
        begin = self._of_plugin(node.plugin) if node.plugin else self._of_executable(node.executable or "")
        waiting, found = deque(begin), dict[Path, None]()
        while waiting and len(found) < MOST_OF_A_NODE:
            path = waiting.popleft()
            if path not in found:
                found[path] = None
                waiting.extend(self._used_by(path))
        yield from found

    def reading(self, files: Sequence[Path]) -> CodeReading:
        """The ports that files name."""
        key = tuple(files[:MOST_OF_A_NODE])
        if key not in self._read:
            parts = [python_ports(_text(path), self._shown(path)) for path in key if self._is_python(path)]
            if cpp := [self._cpp(path) for path in key if path.suffix in _CPP | _HEADERS]:
                parts.append(cpp_ports(cpp))
            self._read[key] = CodeReading(
                tuple(port for part in parts for port in part.ports),
                tuple(each for part in parts for each in part.unclear),
            )
        return self._read[key]

    def _shown(self, path: Path) -> str:
        return path.relative_to(self._folder.parent).as_posix()

    def _cpp(self, path: Path) -> CppFile:
        return _cpp(path, self._shown(path))

    @staticmethod
    def _is_python(path: Path) -> bool:
        return path.suffix == ".py" or (not path.suffix and re.match(r"#!.*python", _text(path)) is not None)

    # Executables

    def _of_executable(self, name: str) -> list[Path]:
        script = [path for path in self._files if path.name == name and self._is_python(path)]
        if script:
            return script[:1]
        if name in self._entry_points:
            return self._modules(self._entry_points[name])
        if name in self._executables:
            return self._executables[name]
        if name in self._component_of:
            return self._of_plugin(self._component_of[name])
        return []

    @cached_property
    def _entry_points(self) -> Mapping[str, str]:
        """The modules of executables that a setup.py or setup.cfg names."""
        texts = [_text(self._folder / name) for name in ("setup.py", "setup.cfg")]
        return {found[1]: found[2] for text in texts for found in _ENTRY.finditer(text)}

    @cached_property
    def _commands(self) -> list[tuple[Path, str, list[str]]]:
        """The commands of all CMake files with their words, variables filled in as far as they are known."""
        found, values = list[tuple[Path, str, list[str]]](), {"PROJECT_NAME": self._folder.name}
        for path in self._files:
            if path.name != "CMakeLists.txt" and path.suffix != ".cmake":
                continue
            values |= {"CMAKE_CURRENT_SOURCE_DIR": str(path.parent), "PROJECT_SOURCE_DIR": str(self._folder)}
            text = re.sub(r"#[^\n]*", "", _text(path))
            for command in _CMAKE_COMMAND.finditer(text):
                said = _VARIABLE.sub(partial(_known_value, values), command[2])
                words = [quoted or plain for quoted, plain in _WORD.findall(said)]
                match command[1].lower(), words:
                    case "set", [name, *rest]:
                        values[name] = " ".join(rest)
                    case "project", [name, *_]:
                        values["PROJECT_NAME"] = name
                    case "file", ["GLOB" | "GLOB_RECURSE", name, *patterns]:
                        values[name] = " ".join(
                            str(each)
                            for each in self._files
                            for pattern in patterns
                            if _fits(each, path.parent, pattern)
                        )
                found.append((path.parent, command[1].lower(), words))
        return found

    @cached_property
    def _executables(self) -> Mapping[str, list[Path]]:
        """The source files of each executable that CMake makes."""
        found: dict[str, list[Path]] = {}
        for folder, command, words in self._commands:
            if words and (command.endswith("add_executable") or command == "google_binary"):
                found[words[0]] = [path for word in words[1:] if (path := self._source(folder, word))]
            if command == "set_target_properties" and "OUTPUT_NAME" in words[:-1] and words[0] in found:
                found[words[words.index("OUTPUT_NAME") + 1]] = found[words[0]]
        return {name: files for name, files in found.items() if files}

    @cached_property
    def _component_of(self) -> Mapping[str, str]:
        """The plugins of the executables that CMake makes of components."""
        found = {}
        for _, command, words in self._commands:
            if command == "rclcpp_components_register_node" and {"PLUGIN", "EXECUTABLE"} <= {*words[:-1]}:
                found[words[words.index("EXECUTABLE") + 1]] = words[words.index("PLUGIN") + 1]
        return found

    def _source(self, folder: Path, word: str) -> Path | None:
        path = Path(word) if word.startswith("/") else folder / word
        return path if path.suffix in _CPP and path in self._known else None

    @cached_property
    def _known(self) -> frozenset[Path]:
        return frozenset(self._files)

    # Plugins

    def _of_plugin(self, name: str) -> list[Path]:
        """The files that register the class of a nodelet or component, by its name or its class."""
        meant = self._classes.get(name, name)
        last = meant.replace("/", "::").rpartition("::")[2]
        fits = [path for registered, path in self._registered if registered == meant]
        return fits or [path for registered, path in self._registered if registered.rpartition("::")[2] == last]

    @cached_property
    def _classes(self) -> Mapping[str, str]:
        """The classes of plugins by the names that manifests give them."""
        found = {}
        for path in self._files:
            if path.suffix == ".xml" and path.name != "package.xml":
                for element in _PLUGIN.finditer(_text(path)):
                    said = dict(_ATTRIBUTE.findall(element[1]))
                    if {"name", "type"} <= said.keys():
                        found[said["name"]] = said["type"]
        return found

    @cached_property
    def _registered(self) -> list[tuple[str, Path]]:
        sources = [path for path in self._files if path.suffix in _CPP]
        return [(one or other, path) for path in sources for one, other in _REGISTERED.findall(_text(path))]

    # Parts of a package that its files use.

    def _used_by(self, path: Path) -> Iterator[Path]:
        """The files of the package that a file uses: its headers and their sources, or its modules."""
        if self._is_python(path):
            for module in sorted(imported_modules(_text(path))):
                yield from self._modules(module)
            return
        for include in self._cpp(path).includes:
            for header in self._ending_with(include):
                yield header
                if header.suffix in _HEADERS:
                    yield from (each for each in self._files if each.suffix in _CPP and each.stem == header.stem)

    def _ending_with(self, name: str) -> list[Path]:
        end = "/" + re.sub(r"^(\.\.?/)+", "", name)
        fits = [path for path in self._files if path.as_posix().endswith(end)]
        return fits if len(fits) == 1 or "/" in name else fits[:1]

    def _modules(self, module: str) -> list[Path]:
        end = "/" + module.replace(".", "/") + ".py"
        return [path for path in self._files if path.as_posix().endswith(end)][:1]


@lru_cache(maxsize=64)
def _package(folder: Path) -> _Package:
    return _Package(folder)


@lru_cache(maxsize=512)
def _cpp(path: Path, shown: str) -> CppFile:
    return cpp_file(_text(path), shown)


@lru_cache(maxsize=512)
def _text(path: Path) -> str:
    """The text of a file; "" if it can't be read or is too large."""
    try:
        if path.stat().st_size > LARGEST_FILE:
            return ""
        return path.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""


def _known_value(values: Mapping[str, str], name: re.Match[str]) -> str:
    return values.get(name[1], name[0])


def _fits(path: Path, folder: Path, pattern: str) -> bool:
    return path.match(pattern if pattern.startswith("/") else f"{folder}/{pattern}")
