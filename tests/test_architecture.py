"""Who may import whom, by reading every file's imports, and what a file may not hold."""

import ast
import re
import sys
from pathlib import Path

import pytest

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).parents[1]
PACKAGES = ("warp_plate", "kernels", "viz")
# Beside Python's own library. What is imported only while drawing counts too.
SCIENCE = {"numpy", "scipy"}
# room: (rooms of warp_plate that it may import, libraries); a file's own room, "warp_plate.scene.model" for a
# single module, is found by the longest name that fits.
RULES: dict[str, tuple[set[str], set[str]]] = {
    "kernels": ({"kernels"}, {"warp"}),
    "scene": ({"scene", "viz.html"}, {*SCIENCE, "pydantic", "pydantic_core", "tomli", "tomllib"}),
    "plate": ({"plate", "scene"}, SCIENCE),
    "reference": ({"reference", "plate", "scene"}, SCIENCE),
    "result": ({"result", "plate", "scene", "viz.html"}, {*SCIENCE, "h5py"}),
    "solve": ({"solve", "kernels", "plate", "scene"}, {*SCIENCE, "warp"}),
    "bench": ({"bench", "solve", "kernels", "plate", "scene", ""}, {*SCIENCE, "warp"}),
    "accuracy": ({"accuracy", "solve", "reference", "plate", "scene", ""}, {*SCIENCE, "pydantic", "warp"}),
    "cluster": ({"cluster", "solve", "plate", "scene", ""}, {*SCIENCE, "warp"}),
    "cluster.dask": ({"cluster", "scene"}, {"dask", "distributed"}),
    "search": ({"search", "accuracy", "cluster", "solve", "result", "plate", "scene", ""}, {*SCIENCE, "warp"}),
    "search.cma_es": ({"search", "scene"}, {*SCIENCE, "cma"}),
    "search.pso": ({"search.pso_settings", "search.record", "plate.blocks"}, SCIENCE),
    "search.record": (set(), SCIENCE),
    "search.pso_settings": (set(), SCIENCE),
    "plate.blocks": ({"plate.interrupts"}, SCIENCE),
    "plate.interrupts": (set(), set()),
    "viz": (
        {"viz", "result", "scene"},
        {*SCIENCE, "pyvista", "vtkmodules", "matplotlib", "PIL", "imageio_ffmpeg"},
    ),
    "viz.explorer_page": ({"viz", "result", "scene"}, {"pyvista", "trame", "aiohttp"}),
    # Scenes and results ask it how to show themselves in a notebook, when they are shown.
    "viz.html": ({"viz", "result", "scene"}, set()),
    "cli": (
        {"cli", "accuracy", "bench", "cluster", "search", "solve", "result", "plate", "scene", "viz", ""},
        {*SCIENCE, "cyclopts", "rich"},
    ),
    "notebook": ({"search", "viz", "result", "scene"}, set()),
    "__main__": ({"cli"}, set()),
    "": (set(), set()),
}


def sources():
    """(file, its module's name inside warp_plate) of every Python file of the three top folders."""
    files = [path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py"))]
    parts = [path.relative_to(ROOT).with_suffix("").parts for path in files]
    inside = [names[1:] if names[0] == "warp_plate" else names for names in parts]
    return [
        (path, ".".join(name for name in names if name != "__init__"))
        for path, names in zip(files, inside, strict=True)
    ]


def imports(path):
    """(module, whether late: in a function, or for type checkers only) of every import of a file."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    inner = {
        id(node)
        for outer in ast.walk(tree)
        if isinstance(outer, ast.FunctionDef)
        or (isinstance(outer, ast.If) and ast.unparse(outer.test) == "TYPE_CHECKING")
        for node in ast.walk(outer)
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield alias.name, id(node) in inner
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import; write from warp_plate. ..."
            yield node.module, id(node) in inner


def room_of(module):
    """The rule that a module of warp_plate falls under: the longest that is a head of its name."""
    heads = [rule for rule in RULES if rule and (module == rule or module.startswith(rule + "."))]
    return max(heads, key=len, default="" if module == "" else None)


@pytest.mark.parametrize(
    ("path", "module"), sources(), ids=lambda part: part if isinstance(part, str) else ""
)
def test_imports_keep_to_the_rules(path, module):
    room = room_of(module)
    assert room is not None, f"{path}: a new room; say in RULES what it may import"
    rooms, libraries = RULES[room]
    for name, _ in imports(path):
        head, _, inside = name.partition(".")
        if head == "warp_plate":
            target = room_of(inside)
            assert target is not None, f"{path}: imports {name}, which is in no room"
            allowed = target in rooms or target.split(".")[0] in rooms
            assert allowed, f"{path}: {room or 'warp_plate'} may not import {name}"
        else:
            standard = head in sys.stdlib_module_names
            assert standard or head in libraries, f"{path}: {room or 'warp_plate'} may not import {name}"


def test_top_folders_are_no_top_imports():
    """``kernels`` and ``viz`` are folders; as imports they are warp_plate.kernels and warp_plate.viz."""
    for folder in (*PACKAGES, "tests", "benchmarks"):
        for path in (ROOT / folder).rglob("*.py"):
            heads = {name.split(".")[0] for name, _ in imports(path)}
            assert not heads & {"kernels", "viz"}, path


def test_pictures_are_imported_only_when_drawn():
    """Commands start quickly and run where no graphics library is: viz, PyVista and Warp come inside
    functions."""
    rooms = "viz|solve|cluster|search|accuracy|bench|kernels"
    late = re.compile(rf"(warp|pyvista|matplotlib|vtkmodules|warp_plate\.({rooms}))(\.|$)")
    for path, module in sources():
        if room_of(module) in ("cli", "notebook", "__main__", ""):
            assert not [name for name, inner in imports(path) if not inner and late.match(name)], path


def test_scenes_and_results_ask_for_pictures_only_when_shown():
    late = {
        module: inner
        for path, module in sources()
        if room_of(module) in ("scene", "result")
        for name, inner in imports(path)
        if name == "warp_plate.viz.html"
    }
    assert late == {"scene.model": True, "result.model": True}


def test_the_rules_are_checked():
    """The walk finds the files, and its rules say no: a kernel may not import NumPy, nor a solver the
    search."""
    modules = {module for _, module in sources()}
    assert {"kernels.update", "solve.solver", "viz.figures", "search.pso", "scene.model", ""} <= modules
    assert "numpy" not in RULES["kernels"][1]
    assert not RULES["solve"][0] & {"search", "viz", "cli", "result"}
    assert not RULES["viz"][0] & {"solve", "search", "kernels", "cli"}
    for room in ("scene", "plate", "reference", "result", "search.pso"):
        assert not RULES[room][1] & {"warp", "pyvista"}
        assert not RULES[room][0] & {"kernels", "solve", "viz", "cli"}


def test_every_package_folder_is_packaged():
    """pyproject.toml lists them by name: an installed copy holds what the checkout holds."""
    listed = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"][
        "packages"
    ]
    found = {
        ".".join(("warp_plate", *module.split("."))).rstrip(".")
        for path, module in sources()
        if path.name == "__init__.py"
    }
    assert set(listed) == found
    folders = {path.parent for path, _ in sources()}
    assert all((folder / "__init__.py").is_file() for folder in folders)


def written_files():
    """Every text file that is the project's own: named folders, and what lies beside them."""
    folders = (*PACKAGES, "tests", "benchmarks", "docs", ".ci")
    inside = [path for folder in folders for path in (ROOT / folder).rglob("*") if path.is_file()]
    beside = [path for path in ROOT.iterdir() if path.suffix in (".md", ".toml", ".cff")]
    return [path for path in inside + beside if "__pycache__" not in path.parts]


def test_no_file_over_400_lines():
    """A file has one subject; 300 lines are many."""
    long = {
        str(path.relative_to(ROOT)): lines
        for path in written_files()
        if path.suffix in (".py", ".c", ".cu", ".sh") and (lines := len(path.read_bytes().splitlines())) > 400
    }
    assert not long


def test_no_file_names_a_place_of_one_machine():
    """Paths of a home or a working folder belong to whoever wrote them."""
    place = re.compile(rb"(?<![\w.])/(home|root|work|Users|mnt|tmp)/[\w.]|[A-Z]:\\\\?Users")
    found = [str(path.relative_to(ROOT)) for path in written_files() if place.search(path.read_bytes())]
    assert not found
