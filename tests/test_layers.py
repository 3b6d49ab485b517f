"""Folders import in one order, heavy libraries have one folder each, and files stay short."""

import ast
import re
from collections.abc import Iterator
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

SOURCE = Path(__file__).resolve().parents[1] / "src" / "motorprior"
WORDS = {
    *("__version__", "compiled", "exceptions", "rotations", "signals", "artifacts", "results"),
    *("schema", "bounds", "delay_line", "jax_device", "progress", "stage", "texts"),
}
ORDER = [
    "words",
    "robots",
    "locomotion",
    "logs",
    "excitation",
    "actuator",
    "bench",
    "identification",
    "evaluation",
    "priors",
    "simulation",
    "studies",
    "report",
    "exports",
    "environments",
    "hardware",
    "commands",
    "public",
    "cli",
]
"""Layers; each may import itself and the layers before it."""
FORBIDDEN = {
    # what the robot's computer does not install
    "hardware": {
        "simulation",
        "actuator",
        "excitation",  # gets targets handed in
        "bench",
        "identification",
        "evaluation",
        "priors",
    },
}
FOLDERS = {
    **dict.fromkeys(
        ["jax", "optax"], ("identification/networks/", "excitation/train_generator", "jax_device")
    ),
    **dict.fromkeys(["warp", "torch", "mjlab", "mujoco_warp", "newton"], "exports/"),
    "mujoco": (
        *("simulation/", "exports/", "logs/loads"),
        *("robots/user_model", "robots/user_urdf", "robots/build_model"),
    ),
    "pybullet": "simulation/",
    "ray": "locomotion/executor",
    **dict.fromkeys(["serial", "msgpack", "rustypot"], "hardware/"),
    **dict.fromkeys(["pyarrow", "mcap", "mcap_ros2"], "logs/"),
    **dict.fromkeys(["matplotlib", "jinja2"], "report/"),
    **dict.fromkeys(["tyro", "rich"], "cli/"),
    "filelock": "stage",
}


MODULE_NAME = re.compile(r"motorprior(\.\w+)+")


def imported(tree: ast.AST, package: list[str]) -> Iterator[tuple[int, str]]:
    """Line and absolute dotted name of all imports, and of modules of ours that texts name."""
    for node in ast.walk(tree):
        for name in imported_by(node, package):
            yield getattr(node, "lineno", 0), name


def imported_by(node: ast.AST, package: list[str]) -> list[str]:
    """Absolute dotted names that one node of a syntax tree imports."""
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]

    if isinstance(node, ast.ImportFrom):
        module = package[: len(package) - node.level + 1] if node.level else []
        if node.module:
            module = [*module, node.module]
        return [".".join([*module, alias.name]) for alias in node.names]

    if isinstance(node, ast.Call) and getattr(node.func, "attr", "") == "import_module":
        first = node.args[0] if node.args else None
        return [str(first.value)] if isinstance(first, ast.Constant) else []

    # a module of ours by name, which `import_module` gets from a variable or ``python -m`` runs
    if isinstance(node, ast.Constant) and MODULE_NAME.fullmatch(str(node.value)):
        return [str(node.value)]

    return []


def layer(name: str, source: Path) -> str:
    """Layer of `motorprior.<name>`; the names of __init__.py ("") and no modules are public."""
    if name in WORDS:
        return "words"
    if not name or not ((source / name).is_dir() or (source / f"{name}.py").is_file()):
        return "public"
    return "cli" if name == "__main__" else name


def violations(source: Path) -> list[str]:
    """Every breach of the import rules below `source`, as "file:line: what is wrong"."""
    breaches = []
    for file in sorted(source.rglob("*.py")):
        inside = file.relative_to(source)
        place = inside.as_posix()
        here = layer(inside.parts[0].removesuffix(".py").replace("__init__", ""), source)
        if here not in ORDER:
            breaches.append(f"{place}:1: {here} has no layer")
            continue

        allowed = set(ORDER[: ORDER.index(here) + 1]) - FORBIDDEN.get(here, set())
        tree = ast.parse(file.read_text("utf-8"))
        for line, name in imported(tree, ["motorprior", *inside.parent.parts]):
            library, _, rest = name.partition(".")
            if library == "motorprior":
                target = layer(rest.partition(".")[0], source)
                if target not in allowed:
                    breaches.append(f"{place}:{line}: {here} imports {target}")
            elif not place.startswith(FOLDERS.get(library, "")):
                folders = FOLDERS[library]
                home = folders if isinstance(folders, str) else " and ".join(folders)
                breaches.append(f"{place}:{line}: {library} is imported outside {home}")

    return breaches


def test_imports_go_one_way_and_heavy_libraries_have_one_folder():
    assert SOURCE.is_dir()
    assert violations(SOURCE) == []


@pytest.mark.parametrize(
    ("place", "code", "breach"),
    [
        ("robots/pupper/spec.py", "from ...bench import fleet", "robots imports bench"),
        (
            "hardware/safety.py",
            "from motorprior.actuator import latent",
            "hardware imports actuator",
        ),
        (
            "bench/load.py",
            "importlib.import_module('ray')",
            "ray is imported outside locomotion/executor",
        ),
        (
            "robots/spec.py",
            "c = ['python', '-m', 'motorprior.simulation.render', '-h']",
            "robots imports simulation",
        ),
        (
            "actuator/picture.py",
            "PLOTS = 'motorprior.report.plots'\nplots = import_module(PLOTS)",
            "actuator imports report",
        ),
        ("misc/thing.py", "", "misc has no layer"),
        (
            "robots/spec.py",
            "from motorprior import __version__\nfrom ..signals import lowpass",
            None,
        ),
        ("cli/main.py", "import tyro\nfrom motorprior.commands import walk", None),
    ],
)
def test_a_violation_is_caught(tmp_path: Path, place: str, code: str, breach: str | None):
    for folder in ORDER[1:]:
        (tmp_path / folder).mkdir()

    (tmp_path / "signals.py").touch()
    (tmp_path / place).parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / place).write_text(code)
    breaches = [line.split(": ", 1)[1] for line in violations(tmp_path)]

    assert breaches == ([breach] if breach else [])


def command_imports(folder: Path) -> list[str]:
    """Imports of `motorprior.commands` in the files of a folder, as "file:line: name"."""
    imports = []
    for file in sorted(folder.rglob("*.py")):
        place = file.relative_to(folder).as_posix()
        for line, name in imported(ast.parse(file.read_text("utf-8")), []):
            if f"{name}.".startswith("motorprior.commands."):
                imports.append(f"{place}:{line}: {name}")

    return imports


@pytest.mark.parametrize("name", ["benchmarks", "examples"])
def test_benchmarks_and_examples_import_the_library_not_commands(name: str):
    folder = SOURCE.parents[1] / name

    assert any(folder.rglob("*.py"))
    assert command_imports(folder) == []


@pytest.mark.parametrize(
    ("code", "imports"),
    [
        (
            "from motorprior.commands.validate import Validate",
            ["a.py:1: motorprior.commands.validate.Validate"],
        ),
        ("def main():\n    from motorprior import commands", ["a.py:2: motorprior.commands"]),
        ("import motorprior.commands.walk", ["a.py:1: motorprior.commands.walk"]),
        ("from motorprior.hardware import runs\nimport motorprior as mp", []),
    ],
)
def test_an_import_of_commands_is_caught(tmp_path: Path, code: str, imports: list[str]):
    (tmp_path / "a.py").write_text(code)

    assert command_imports(tmp_path) == imports


@pytest.mark.parametrize(
    ("name", "min_modules"), [("commands", 5), ("identification", 6), ("priors", 3), ("logs", 2)]
)
def test_modules_of_a_folder_import_one_way(name: str, min_modules: int):
    """A module or folder directly below the folder counts as one; a cycle raises CycleError."""
    folder = SOURCE / name
    needs: dict[str, set[str]] = {}

    for file in folder.rglob("*.py"):
        inside = file.relative_to(folder)
        module = inside.parts[0].removesuffix(".py")
        tree = ast.parse(file.read_text("utf-8"))
        for _, dotted in imported(tree, ["motorprior", name, *inside.parent.parts]):
            if dotted.startswith(f"motorprior.{name}."):
                needs.setdefault(module, set()).add(dotted.split(".")[2])

    for module, imports in needs.items():
        imports.discard(module)

    order = list(TopologicalSorter(needs).static_order())

    assert len(order) > min_modules


def test_the_host_never_imports_the_virtual_robot():
    files = set((SOURCE / "hardware").glob("*.py"))
    files.remove(SOURCE / "hardware" / "virtual_robot.py")
    for file in files:
        tree = ast.parse(file.read_text("utf-8"))
        for _, dotted in imported(tree, ["motorprior", "hardware"]):
            assert "virtual_robot" not in dotted.split("."), file.name


def test_no_file_has_more_than_600_lines():
    lengths = {file: len(file.read_text("utf-8").splitlines()) for file in SOURCE.rglob("*.py")}
    assert {str(file): lines for file, lines in lengths.items() if lines > 600} == {}


ROBOT_NAMES = re.compile(r"\b(pupper|go2|so-?101)(_?v\d)?s?\b", re.IGNORECASE)
TWELVES = {
    "excitation/hand_made.py": "sines of a multisine",
    "excitation/generator.py": "numbers of a window's code",
}
"""Where the number 12 is not the joints of some robot."""


def robots_named(source: Path) -> list[str]:
    """Lines outside robots/ that name a robot, or contain a 12, its possible number of joints."""
    lines = []
    for file in sorted(source.rglob("*.py")):
        place = file.relative_to(source).as_posix()
        text = file.read_text("utf-8")
        if place.startswith("robots/"):
            continue

        for number, line in enumerate(text.splitlines(), 1):
            if ROBOT_NAMES.search(line):
                lines.append(f"{place}:{number}")

        if place in TWELVES:
            continue
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.Constant) and type(node.value) is int and node.value == 12:
                lines.append(f"{place}:{node.lineno}")

    return lines


def test_nothing_outside_robots_names_a_robot_or_counts_its_joints():
    assert robots_named(SOURCE) == []


def test_a_named_robot_and_a_count_of_its_joints_are_caught(tmp_path: Path):
    (tmp_path / "robots").mkdir()
    (tmp_path / "robots" / "one.py").write_text('NAME = "pupper_v2"\njoints = 12\n')
    (tmp_path / "two.py").write_text(
        '"""Of the Pupper."""\nx = range(12)\n"""A Go2."""\n# puppersim\ny = 0.12\n'
    )

    assert robots_named(tmp_path) == ["two.py:1", "two.py:3", "two.py:2"]
