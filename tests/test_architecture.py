"""The floors of the project: who may import whom, read from every import, and what files may not hold."""

import ast
import re
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
# From the ground up. A room may import itself and the rooms of the floors below it.
FLOORS = (
    {"_version", "interrupts", "row_blocks", "outline"},
    {"scene", "effects", "kernels", "optimize"},
    {"plate"},
    {"quantities"},
    {"result"},
    {"solve", "viz"},
    {"modal"},
    {"accuracy", "cluster", "fitting"},
    {"resolve"},
    {"problem"},
    {"analysis", "focusing", "designing"},
    {"studies"},
    {"explore"},
    {"cli"},
    {"notebook"},
)
ROOMS = set().union(*FLOORS)
# The libraries that only some rooms may import, and the rooms.
OWNERS = {
    "warp": {"kernels", "solve", "modal", "accuracy", "cluster", "analysis", "studies"},
    **{name: {"viz"} for name in ("pyvista", "vtkmodules", "matplotlib", "trame")},
    **{name: {"cluster"} for name in ("dask", "distributed")},
    **{name: {"cli"} for name in ("cyclopts", "rich")},
    "h5py": {"result"},
    "pyuff": {"fitting"},
    **{name: {"outline"} for name in ("ezdxf", "svgelements")},
    "pydantic": {"scene", "effects"},
    "cma": {"optimize"},
    "clarabel": {"optimize"},
    "shapely": {"problem", "outline", "plate", "viz"},
}
# Imported only inside functions, or as parts of ``import scipy``, which loads them when they are used.
LATE = re.compile(r"(scipy\.\w+|matplotlib|pyvista|vtkmodules|trame|dask|distributed)(\.|$)")

# What could make code of data, and modules that could or that leave the process.
FORBIDDEN_NAMES = {"eval", "exec", "compile", "__import__", "globals", "breakpoint", "os.system"}
FORBIDDEN_MODULES = {
    "pickle", "marshal", "shelve", "dill", "joblib", "yaml", "code", "codeop", "runpy", "socket", "ssl",
    "http", "urllib", "ftplib", "smtplib", "xmlrpc", "socketserver", "requests", "webbrowser", "asyncio", "subprocess",
}  # fmt: skip
# The explorer serves a page on 127.0.0.1, reads its key, and opens it; others start fixed commands without a shell.
ALLOWED = {
    "viz/explorer_page.py": {"asyncio", "socket"},
    "viz/explorer_access.py": {"socket", "urllib"},
    "warp_plate/cli/explore.py": {"webbrowser"},
    "viz/availability.py": {"subprocess"},
    "viz/pictures.py": {"subprocess"},
}  # fmt: skip

# Effects that only their own files in effects/ and kernels name, and those that so many files at most name.
HIDDEN_EFFECTS = ("foundation", "tension", "orthotropic", "loss_factor", "material_damping", "variation")
RARE_EFFECTS, MOST_FILES = ("oscillators", "stretching", "moving_load"), 6


@cache
def sources():
    """Return (path, name inside warp_plate, text, imports, nodes of the syntax tree) of every product file."""
    found = []
    for top in ("warp_plate", "kernels", "viz"):
        for path in sorted((ROOT / top).rglob("*.py")):
            parts = path.relative_to(ROOT / "warp_plate" if top == "warp_plate" else ROOT).with_suffix("").parts
            module, text = ".".join(part for part in parts if part != "__init__"), path.read_text("utf-8")
            tree = ast.parse(text)
            found.append((path, module, text, list(imports(tree)), list(ast.walk(tree))))
    return found


def imports(tree):
    """Yield (module imported, names taken from it, whether inside a function), but for type checkers' imports."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            continue
        if isinstance(node, ast.Import):
            yield from ((alias.name, [], False) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "relative import: write from warp_plate. ..."
            yield node.module, [alias.name for alias in node.names], False
        else:
            inner = isinstance(node, ast.FunctionDef)
            yield from ((name, names, late or inner) for name, names, late in imports(node))


def strays(allowed):
    """Return the imports for which ``allowed(room, module imported, whether inside a function)`` is false."""
    return [
        f"{path.relative_to(ROOT)}: {name}"
        for path, module, _, found, _ in sources()
        for name, _, late in found
        if not allowed(room_of(module), name, late)
    ]


def room_of(module):
    return module.split(".")[0]


def test_rooms_import_only_floors_below():
    floor = {room: height for height, rooms in enumerate(FLOORS) for room in rooms}

    def allowed(here, name, late):
        there = room_of(name.removeprefix("warp_plate."))
        inside = name.startswith("warp_plate.") and {here, there} <= ROOMS
        # The tables of the effects are part of the scene.
        return not inside or here == there or {here, there} == {"scene", "effects"} or floor[there] < floor[here]

    assert not strays(allowed)


def test_every_room_has_a_floor():
    assert {room_of(module) for _, module, *_ in sources()} - {"", "__main__"} == ROOMS


def test_no_circle_of_imports():
    """Imports inside functions and for type checkers count, and so do the names that the package's root lends."""
    modules = {module for _, module, *_ in sources()}
    stub = ast.parse((ROOT / "warp_plate" / "__init__.pyi").read_text("utf-8"))
    graph = {"": {node.module for node in stub.body if isinstance(node, ast.ImportFrom)}}
    for _, module, _, _, nodes in sources():
        targets = graph.setdefault(module, set())
        for node in nodes:
            taken = [alias.name for alias in getattr(node, "names", ()) if isinstance(alias, ast.alias)]
            for name in [node.module] if isinstance(node, ast.ImportFrom) else taken:
                if name.split(".")[0] == "warp_plate":
                    inside = name.removeprefix("warp_plate").removeprefix(".")
                    targets |= {f"{inside}.{each}".strip(".") for each in taken} & modules or {inside}
        targets &= modules - {module}
    TopologicalSorter(graph).prepare()  # raises CycleError, which names the circle


def test_libraries_stay_in_their_rooms():
    assert not strays(lambda room, name, late: room in OWNERS.get(room_of(name), {room}))


def test_heavy_libraries_are_imported_when_needed():
    assert not strays(lambda room, name, late: late or not LATE.match(name))


def test_no_public_class_name_is_used_twice():
    classes = [node.name for *_, nodes in sources() for node in nodes if isinstance(node, ast.ClassDef)]
    names = [name for name in classes if not name.startswith("_")]
    assert sorted(names) == sorted(set(names))


def test_files_are_short_and_folders_small():
    long = [str(path) for path, _, text, *_ in sources() if len(text.splitlines()) > 400]
    assert not long
    folders = [path.parent for path, *_ in sources() if path.name != "__init__.py"]
    full = {str(folder) for folder in folders if folders.count(folder) > 20}
    assert full <= {str(ROOT / "kernels"), str(ROOT / "warp_plate" / "cli")}


def files_naming(word):
    """Return the product files, but for effects/, that hold a word."""
    outside = [(path, text) for path, module, text, *_ in sources() if room_of(module) != "effects"]
    return {str(path.relative_to(ROOT)) for path, text in outside if re.search(rf"\b{word}\b", text)}


@pytest.mark.parametrize("word", HIDDEN_EFFECTS)
def test_an_effect_is_named_by_its_own_file_alone(word):
    assert not {name for name in files_naming(word) if not name.startswith("kernels")}


@pytest.mark.parametrize("word", RARE_EFFECTS)
def test_an_effect_with_functions_of_its_own_is_named_by_few_files(word):
    assert len(files_naming(word)) <= MOST_FILES


def test_no_file_names_a_place_of_one_machine():
    place = re.compile(rb"(?<![\w.])/(home|root|work|Users|mnt|tmp)/[\w.]|[A-Z]:\\\\?Users")
    folders = ("warp_plate", "kernels", "viz", "tests", "benchmarks", "docs", ".ci")
    inside = [path for folder in folders for path in (ROOT / folder).rglob("*") if path.is_file()]
    beside = [path for path in ROOT.iterdir() if path.suffix in (".md", ".toml", ".cff")]
    files = [path for path in inside + beside if "__pycache__" not in path.parts]
    assert not [str(path.relative_to(ROOT)) for path in files if place.search(path.read_bytes())]


def test_no_file_makes_code_of_data():
    for path, _, _, _, nodes in sources():
        name = path.relative_to(ROOT).as_posix()
        for node in nodes:
            if isinstance(node, ast.Call):
                options = {keyword.arg for keyword in node.keywords if getattr(keyword.value, "value", None)}
                called = ast.unparse(node.func)
                bad = called in FORBIDDEN_NAMES or called.endswith((".popen", ".fromstring"))
                assert not bad | bool(options & {"shell", "allow_pickle"}), f"{name}:{node.lineno}"
            modules = [alias.name for alias in getattr(node, "names", ())] if isinstance(node, ast.Import) else []
            heads = {module.split(".")[0] for module in [*modules, getattr(node, "module", None) or ""]}
            assert not heads & FORBIDDEN_MODULES - ALLOWED.get(name, set()), f"{name}:{node.lineno}: {heads}"
