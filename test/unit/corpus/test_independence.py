"""The corpus shares no code with what it tests."""

import ast
from pathlib import Path

import pytest

CORPUS = Path(__file__).resolve().parents[3] / "benchmarks" / "corpus"


def imported(source: str) -> set[str]:
    names = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            names.add(node.module or "")
    return names


@pytest.mark.parametrize("path", sorted(CORPUS.rglob("*.py")),
                         ids=lambda path: path.relative_to(CORPUS).as_posix())
def test_the_corpus_imports_only_itself_and_public_libraries(path: Path) -> None:
    source = path.read_text("utf-8")
    known = ("benchmarks.corpus", "numpy", "numba", "scipy")
    for name in imported(source):
        assert name.startswith(known) or name in (
            "__future__", "collections.abc", "dataclasses", "functools", "json", "math", "os",
            "pathlib", "typing"), name
    assert "dfm_stage" not in source
    assert "import_module" not in source
