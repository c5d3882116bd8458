"""Rules about the code itself: who may import whom, what is public, and how fast the package loads."""

import ast
import importlib
import subprocess
import sys
from pathlib import Path

import pytest

import shadowgram as sg

PACKAGE = Path(sg.__file__).parent

# Every part, and the parts of ours that it may import. Data flows one way: scene → imager → measurement → reconstruction → figures.
MAY_IMPORT = {
    "_threads": set(),
    "noise": set(),
    "metrics": set(),
    "scenes": {"_threads"},
    "operators": {"_threads"},
    "testing": {"operators"},
    "codes": {"_threads", "scenes"},  # of scenes, how a file is written whole or not at all
    "spectral": {"_threads", "codes", "operators", "solvers"},  # of solvers, what tests a model by predicting pixels
    "priors": {"_threads"},
    "solvers": {"_threads", "operators", "priors"},
    "xray": {"_threads", "codes", "metrics", "noise", "operators", "priors", "scenes", "solvers"},
    "measurement": {"codes", "noise", "operators", "scenes", "spectral"},
    "figures": {"scenes", "spectral", "codes", "xray"},
    "experiments": {"*"},
    "cli": {"*"},
    "__init__": {"*"},
    "__main__": {"cli"},
}
PACKAGES = (
    "shadowgram",
    "shadowgram.scenes",
    "shadowgram.codes",
    "shadowgram.operators",
    "shadowgram.priors",
    "shadowgram.spectral",
    "shadowgram.xray",
)
# Loaded when used, never by `import shadowgram`.
HEAVY = {
    "numba",
    "scipy",
    "xarray",
    "pandas",
    "matplotlib",
    "h5py",
    "h5netcdf",
    "pydantic",
    "typer",
    "rich",
    "jinja2",
    "onnxruntime",
    "torch",
    "distributed",
    "dask",
    "sqlite3",
    "spekpy",
    "trimesh",
    "xraylib",
}


def modules():
    return sorted(p for p in PACKAGE.rglob("*.py"))


def part_of(path):
    return path.relative_to(PACKAGE).with_suffix("").parts[0]


def imports(path):
    """Parts of our package that a module imports, wherever in it, except for type checking."""
    tree = ast.parse(path.read_text())
    typing_only = {
        id(node)
        for block in ast.walk(tree)
        if isinstance(block, ast.If) and isinstance(block.test, ast.Name) and block.test.id == "TYPE_CHECKING"
        for node in ast.walk(block)
    }
    own = ("shadowgram", *path.relative_to(PACKAGE).parent.parts)
    for node in ast.walk(tree):
        if id(node) in typing_only:
            continue
        if isinstance(node, ast.ImportFrom):
            base = own[: len(own) - node.level + 1] if node.level else ()
            name = ".".join((*base, *(node.module.split(".") if node.module else ())))
            yield from ((f"{name}.{alias.name}", node.lineno) for alias in node.names)
        elif isinstance(node, ast.Import):
            yield from ((alias.name, node.lineno) for alias in node.names)


@pytest.mark.parametrize("path", modules(), ids=lambda p: str(p.relative_to(PACKAGE)))
def test_imports_point_one_way(path):
    allowed = MAY_IMPORT[part_of(path)]
    for name, line in imports(path):
        parts = name.split(".")
        if parts[0] == "shadowgram" and len(parts) > 1 and "*" not in allowed:
            assert parts[1] in allowed | {part_of(path), "__version__"}, f"{path}:{line} imports {name}"
        if parts[0] in {"matplotlib", "PIL"} and part_of(path) != "figures":
            pytest.fail(f"{path}:{line}: only figures imports {parts[0]}")
        if parts[0] in {"numpy"} and parts[1:2] == ["random"]:
            pytest.fail(f"{path}:{line}: use numpy.random.default_rng(seed)")


@pytest.mark.parametrize("package", PACKAGES)
def test_public_names_are_complete_and_sorted(package):
    module = importlib.import_module(package)
    assert list(module.__all__) == sorted(module.__all__)
    for name in module.__all__:
        assert getattr(module, name) is not None
    stub = Path(module.__file__).with_suffix(".pyi").read_text()
    assert {line.split(" as ")[-1] for line in stub.splitlines() if " as " in line} == set(module.__all__)


def test_public_things_say_what_they_do():
    for package in PACKAGES:
        module = importlib.import_module(package)
        for name in module.__all__:
            assert getattr(module, name).__doc__, f"{package}.{name} has no docstring"


def test_import_loads_nothing_heavy():
    code = f"import sys, shadowgram; print(sorted({HEAVY} & set(sys.modules)))"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert out.strip() == "[]"


def test_modules_stay_small():
    for path in modules():
        assert len(path.read_text().splitlines()) <= 450, f"{path} is too long; split it"
