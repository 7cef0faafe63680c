"""The structure of the code: what may import what, and what other packages may import."""

import ast
import graphlib
import re
from functools import cache
from importlib import import_module
from pathlib import Path

import pytest

import cablebot_gym

ROOT = Path(__file__).parents[1]
PUBLIC_MODULES = (ROOT / "docs" / "public_modules.txt").read_text(encoding="utf-8").split()

ORDER = (
    *(
        "utils",
        "env_ids",
        "kinematics",
        "robots",
        "exporters",
        "measurement",
        "motions",
        "uncertainty",
        "task",
        "physics",
        "planning",
    ),
    *(
        "rendering",
        "envs",
        "policies",
        "isolation",
        "evaluation",
        "bounds",
        "plotting",
        "video",
        "benchmark",
        "report",
        "cli",
    ),
)
"""Packages and modules of cablebot_gym; each may import itself and those before it."""


PACKAGES = {
    "cablebot_gym": ROOT,
    "cablebot_baselines": ROOT / "baselines",
    "cablebot_reproduction": ROOT / "reproduction",
    "cablebot_winches": ROOT / "winches",
}
"""Folder of each package."""


def source_files():
    """Files of all packages by module."""
    files = {}
    for package, root in PACKAGES.items():
        for path in (root / package).rglob("*.py"):
            name = ".".join(path.relative_to(root).with_suffix("").parts)
            files[name.removesuffix(".__init__")] = path
    return files


FILES = source_files()


@cache
def tree(module):
    """Syntax tree of a module."""
    return ast.parse(FILES[module].read_text(encoding="utf-8"))


@cache
def imports(module):
    """Modules of all packages that a module imports anywhere in its code, with the name that it
    takes from each."""
    imported = []
    for node in ast.walk(tree(module)):
        if isinstance(node, ast.Import):
            imported += [(alias.name, "") for alias in node.names if alias.name in FILES]
        elif isinstance(node, ast.ImportFrom):
            for alias in node.names:
                submodule = f"{node.module}.{alias.name}"
                if submodule in FILES:
                    imported.append((submodule, ""))
                elif node.module in FILES:
                    imported.append((node.module, alias.name))
    return tuple(imported)


@pytest.fixture(autouse=True, scope="module")
def _imports_are_known():
    for module in FILES:
        imports(module)


def test_imports_form_no_cycle():
    """Lazy imports and those for types alone count too; a module's own packages do not."""
    graph = {}
    for module in FILES:
        graph[module] = set()
        for imported, _ in imports(module):
            if not f"{module}.".startswith(f"{imported}."):
                graph[module].add(imported)
    graphlib.TopologicalSorter(graph).prepare()  # raises CycleError with the cycle


def test_rooms_of_the_baselines_have_an_order():
    """A law may use an estimator, so no estimator may use a law."""
    graph = {}
    for module in FILES:
        room = module.split(".")[:2]
        for imported, _ in imports(module):
            target = imported.split(".")[:2]
            if room[0] == target[0] == "cablebot_baselines" and room != target:
                graph.setdefault(".".join(room), set()).add(".".join(target))
    graphlib.TopologicalSorter(graph).prepare()


@pytest.mark.parametrize("package", ORDER)
def test_package_imports_only_those_before_it(package):
    allowed = {"", *ORDER[: ORDER.index(package) + 1]}
    for module in FILES:
        if module.split(".")[:2] != ["cablebot_gym", package]:
            continue
        for imported, _ in imports(module):
            root, _, path = imported.partition(".")
            assert root == "cablebot_gym", f"{module} imports {imported}"
            assert path.split(".")[0] in allowed, f"{module} imports {imported}"


def test_only_these_rooms_know_the_isolation():
    """The evaluator takes a loaded policy, in whatever process it runs."""
    importers = {
        name
        for name in FILES
        if any(imported.startswith("cablebot_gym.isolation") for imported, _ in imports(name))
    }
    rooms = {"isolation", "benchmark", "cli"}
    assert {name.split(".")[1] for name in importers} == rooms


def test_every_package_is_in_the_order():
    assert {name.split(".")[1] for name in FILES if name.startswith("cablebot_gym.")} == set(ORDER)


def test_other_packages_import_only_public_names():
    """They are written as those of other people would be."""
    public = {"cablebot_gym", *PUBLIC_MODULES}
    for module in FILES:
        package = module.split(".")[0]
        for imported, name in imports(module):
            if package == "cablebot_gym" or imported.startswith(package):
                continue
            assert not name.startswith("_"), f"{module} imports {name} from {imported}"
            if imported.startswith("cablebot_gym"):
                assert imported in public, f"{module} imports {imported}"


@pytest.mark.parametrize("package", ["cablebot_reproduction", "cablebot_winches"])
def test_only_a_distribution_itself_imports_its_package(package):
    """It is installed by those who need it."""
    for module in FILES:
        if not module.startswith(package):
            for imported, _ in imports(module):
                assert not imported.startswith(package), module


def test_names_of_the_package_are_those_of_their_modules():
    """Programs import them from here and pages link to the modules; a move must change both
    lists."""
    names = set(cablebot_gym.__all__) - {"ENV_IDS", "__version__"}
    assert len(names) == 16
    page = (ROOT / "docs" / "reference.md").read_text(encoding="utf-8")
    linked = re.findall(r"^\* \{py:\w+\}`~([\w.]+)\.(\w+)`$", page, re.MULTILINE)
    assert {name for _, name in linked} == names
    for module, name in linked:
        assert module in PUBLIC_MODULES
        assert getattr(cablebot_gym, name) is getattr(import_module(module), name)


CLOCKS = {"time", "timeit", "sched"}
REAL_TIME = {
    "clock.py": "a test that waits for another process or thread",
    "processor_time.py": "processor time, which other processes do not use",
}
"""Files of the tests that use real time, with the reason."""


def test_tests_do_not_depend_on_real_time():
    """They set the time of tests/clock.py: a sleep or a measured time is another one on a busy
    machine."""
    folder = ROOT / "tests"
    for path in (*folder.rglob("*.py"), *(ROOT / "winches" / "tests").rglob("*.py")):
        if path.is_relative_to(folder) and path.relative_to(folder).as_posix() in REAL_TIME:
            continue
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            modules = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            modules += [node.module] if isinstance(node, ast.ImportFrom) else []
            assert CLOCKS.isdisjoint(modules), f"{path}:{node.lineno}"
            assert getattr(node, "attr", "") not in ("Timer", "wait_for_timeout"), (
                f"{path}:{node.lineno}"
            )
