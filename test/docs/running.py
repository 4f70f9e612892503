"""Runs the blocks of a page and holds their output against what the page promises."""

from __future__ import annotations

import contextlib
import doctest
import io
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

from pages import ROOT, Block, blocks
from ruamel.yaml import YAML

SAME = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
RUN = '#!/bin/sh\nexec "{python}" -m dfm_stage "$@"\n'


def run_page(page: Path, tmp_path: Path) -> None:
    """Run the blocks of a page in `tmp_path`, which is the current folder."""
    run = tmp_path / "run"
    run.write_text(RUN.format(python=sys.executable))
    run.chmod(0o755)
    (tmp_path / "config").symlink_to(ROOT / "config")
    namespace: dict[str, Any] = {"__name__": page.stem}
    runs = {"python": _python, "console": _console, "yaml": _yaml}
    if any(block.mark == "file" for block in blocks(page)):
        shutil.copytree(ROOT / "dfm_stage", tmp_path / "dfm_stage",
                        ignore=shutil.ignore_patterns("__pycache__"))
        runs["python"] = _python_in_the_copy
    for block in blocks(page):
        if block.mark == "fragment":
            compile(block.code, str(block), "exec")
        elif block.mark == "file":
            path = re.search(r"^# (dfm_stage/\S+\.py)$", block.code, re.MULTILINE)
            assert path, f"{block}: no line that names the file"
            assert not (ROOT / path[1]).exists()
            Path(path[1]).write_text(block.code, encoding="utf-8")
        elif block.language in runs:
            if block.before:
                exec(compile(block.before, f"before {block}", "exec"), namespace)  # noqa: S102
            runs[block.language](block, namespace)
    if "matplotlib.pyplot" in sys.modules:
        sys.modules["matplotlib.pyplot"].close("all")


def _python(block: Block, namespace: dict[str, Any]) -> None:
    out = io.StringIO()
    # line numbers of a traceback are those of the page
    code = compile("\n" * (block.line - 1) + block.code, str(block), "exec")
    with contextlib.redirect_stdout(out):
        exec(code, namespace)  # noqa: S102
    _keeps_its_promises(block, out.getvalue())


def _python_in_the_copy(block: Block, _namespace: dict[str, Any]) -> None:
    """Run with the package and the page's files in it; only what is new is compiled."""
    done = subprocess.run([sys.executable, "-c", block.code], capture_output=True, text=True,
                          timeout=120, check=False, env={
                              **os.environ, "PYTHONPATH": str(Path.cwd()), "PYTHONSAFEPATH": "1"})
    assert done.returncode == 0, f"{block}: {done.stderr}"
    _keeps_its_promises(block, done.stdout)


def _keeps_its_promises(block: Block, out: str) -> None:
    """Each `# ...` line after a print is a line of the output, in this order."""
    rest = out.splitlines()
    for promised in re.findall(r"^print\(.*\n# (.*)$", block.code, re.MULTILINE):
        while rest and not _says(promised, rest[0]):
            rest.pop(0)
        assert rest, f"{block}: {promised!r} is not in the output:\n{out}"


def _console(block: Block, _namespace: dict[str, Any]) -> None:
    for part in re.split(r"^\$ ", block.code, flags=re.MULTILINE)[1:]:
        command, _, promised = part.partition("\n")
        done = subprocess.run(["/bin/sh", "-c", command], capture_output=True, text=True,
                              timeout=120, check=False)
        assert done.returncode == 0, f"{block}: {command}\n{done.stderr}"
        if promised.strip():
            assert _says(promised, done.stdout), f"{block}: {command}\n{done.stdout}"


def _says(promised: str, out: str) -> bool:
    return doctest.OutputChecker().check_output(promised.rstrip() + "\n", out, SAME)


def _yaml(block: Block, _namespace: dict[str, Any]) -> None:
    from dfm_stage.model import load_model
    from dfm_stage.trajectory import load_experiment

    file = Path("shown.yaml")
    file.write_text(block.code, encoding="utf-8")
    content = YAML(typ="safe").load(block.code)
    if "dfm_model" in content:
        load_model(file)
    elif "mode" in content:
        load_experiment(file)
