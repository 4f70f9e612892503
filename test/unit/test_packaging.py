"""What the two builds of the package put where: the wheel for pip, and colcon's."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import venv
import zipfile
from pathlib import Path
from typing import Any

import pytest

from dfm_stage import __version__
from dfm_stage.commands import NODES, TOOLS

ROOT = Path(__file__).parents[2]
DESCRIBE = """
import json, sys
from distutils.core import run_setup
if sys.argv[1] == "pip":
    import setuptools.build_meta
import setuptools
found = run_setup("setup.py", stop_after="init")
print(json.dumps({"scripts": [line.partition(" ")[0] for line in
                              found.entry_points["console_scripts"]],
                  "plugins": found.entry_points["pytest11"], "modules": found.py_modules,
                  "urls": list(found.metadata.project_urls.items()),
                  "data": [name for _, names in found.data_files or [] for name in names],
                  "inside": found.package_data["dfm_stage"]}))
"""
BARE = {name: value for name, value in os.environ.items() if not name.startswith(
    ("PYTHON", "AMENT", "ROS", "RMW", "COLCON", "CMAKE", "LD_LIBRARY", "NUMBA", "PIP_TARGET"))}


def described(build: str) -> dict[str, list[Any]]:
    """What setup.py says to colcon or to pip."""
    done = subprocess.run([sys.executable, "-c", "import setuptools\n" + DESCRIBE, build],
                          cwd=ROOT, capture_output=True, text=True, check=True)
    return dict(json.loads(done.stdout))


def test_colcon_keeps_every_name_and_what_ros_looks_for_in_share() -> None:
    found = described("colcon")
    assert sorted(found["scripts"]) == sorted([*NODES, *TOOLS])
    assert {"package.xml", "resource/dfm_stage", "launch/one_axis.launch.py",
            "dfm_stage/config/one_axis.yaml"} <= set(found["data"])


def test_the_wheel_has_one_command_and_no_data_outside_the_package() -> None:
    found = described("pip")
    assert found["scripts"] == ["dfm-stage"]
    assert found["data"] == []


@pytest.mark.parametrize("build", ["colcon", "pip"])
def test_both_tell_pytest_of_the_plugin_beside_the_package(build: str) -> None:
    found = described(build)
    assert found["plugins"] == ["pytest_dfm_stage = pytest_dfm_stage"]
    assert found["modules"] == ["pytest_dfm_stage"]
    assert (ROOT / "pytest_dfm_stage.py").is_file()


@pytest.mark.parametrize("build", ["colcon", "pip"])
def test_both_have_the_configuration_inside(build: str) -> None:
    inside = set(described(build)["inside"])
    assert {"config/models/paper_stage.yaml", "config/experiments/example_signals.csv",
            "config/fastdds.xml", "live/page/index.html", "py.typed"} <= inside


def test_metadata_and_citation_name_one_repository_or_none() -> None:
    cited = re.search(r"^repository-code: (\S+)$", (ROOT / "CITATION.cff").read_text("utf-8"),
                      re.MULTILINE)
    urls = dict(described("pip")["urls"])
    assert urls.get("Source") == (cited and cited[1])


def test_one_version_everywhere() -> None:
    for package in ("package.xml", "dfm_interfaces/package.xml"):
        assert f"<version>{__version__}</version>" in (ROOT / package).read_text("utf-8")
    assert f"\nversion: {__version__}\n" in (ROOT / "CITATION.cff").read_text("utf-8")


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel, built in an environment that needs a package index."""
    folder = tmp_path_factory.mktemp("wheel")
    source = folder / "source"
    subprocess.run(["git", "clone", "-q", ROOT, source], check=True)
    for name in _changed():
        (source / name).parent.mkdir(parents=True, exist_ok=True)
        (source / name).write_bytes((ROOT / name).read_bytes())
    _pip(sys.executable, "wheel", "--no-deps", "--wheel-dir", folder, source)
    return next(folder.glob("*.whl"))


def _changed() -> list[str]:
    """Files that the last commit does not have as they are."""
    listed = subprocess.run(["git", "ls-files", "-mo", "--exclude-standard"], cwd=ROOT,
                            capture_output=True, text=True, check=True).stdout.splitlines()
    return [name for name in listed if (ROOT / name).is_file()]


def _pip(python: str | Path, *arguments: object) -> None:
    """Run pip; skip where no package index answers."""
    done = subprocess.run([python, "-m", "pip", "--disable-pip-version-check", *map(
        str, arguments)], env=BARE, capture_output=True, text=True, check=False)
    if done.returncode and any(word in done.stderr for word in (
            "NewConnectionError", "ConnectTimeout", "Could not find a version", "ProxyError")):
        pytest.skip("no package index can be reached from here")
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
def test_the_wheel_holds_the_whole_package(wheel: Path) -> None:
    assert wheel.name == f"dfm_stage-{__version__}-py3-none-any.whl"
    names = set(zipfile.ZipFile(wheel).namelist())
    tracked = subprocess.run(["git", "ls-files", "dfm_stage"], cwd=ROOT, capture_output=True,
                             text=True, check=True).stdout.splitlines()
    assert {name for name in tracked if (ROOT / name).is_file()} <= names
    assert {name.partition("/")[0] for name in names} == {
        "dfm_stage", "pytest_dfm_stage.py", f"dfm_stage-{__version__}.dist-info"}


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_bare_environment_names_the_effect_of_the_example(wheel: Path, tmp_path: Path) -> None:
    venv.create(tmp_path / "venv", with_pip=True)
    programs = tmp_path / "venv" / ("Scripts" if os.name == "nt" else "bin")
    before = {each.stem for each in programs.iterdir()}
    _pip(programs / "python", "install", "--no-compile", wheel)  # what is imported compiles itself
    assert "dfm-stage" in {each.stem for each in programs.iterdir()} - before
    assert not {*NODES, *TOOLS} & {each.stem for each in programs.iterdir()}
    own = {**BARE, "XDG_CACHE_HOME": str(tmp_path / "cache")}     # as on a new machine

    def run(*words: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run([programs / "dfm-stage", *words], cwd=tmp_path, env=own,
                              capture_output=True, text=True, check=False)

    made = run("example")
    assert made.returncode == 0, made.stderr
    assert "compil" in made.stderr
    found = run("diagnose", "example/multisine.csv", "--holdout", "example/sweep.csv", "--model",
                "example/model.yaml", "--out", "found")
    assert found.returncode == 0, found.stderr
    assert found.stdout.startswith("named: The model lacks cubic stiffness")
    answer = json.loads((tmp_path / "found" / "diagnosis.json").read_text("utf-8"))
    assert (answer["verdict"], [each["name"] for each in answer["effects"]]) == (
        "named", ["cubic_stiffness"])
    assert "compil" not in run("example", "again").stderr
    assert "complete -o default" in run("completion", "bash").stdout
    for words in (["demo"], ["sim_plant"], ["paper"]):
        refused = run(*words)
        assert refused.returncode == 2
        assert len(refused.stderr.splitlines()) == 1
        assert "needs ROS 2 Jazzy" in refused.stderr


def test_colcons_scripts_answer_signals_from_their_first_lines(tmp_path: Path) -> None:
    code = ("import sys, setuptools\nfrom distutils.core import run_setup\n"
            "run_setup('setup.py', stop_after='init')\n"
            "from setuptools.command.easy_install import ScriptWriter\n"
            "print(ScriptWriter.template % {'name': 'controller', 'group': '', 'spec': ''})")
    text = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True,
                          check=True).stdout
    lines = [line for line in text.splitlines() if line]
    assert lines.index("end_at_once()") <= 2
    script = tmp_path / "controller"
    script.write_text(text, encoding="utf-8")
    done = subprocess.run([sys.executable, script, "--version"], cwd=ROOT, text=True, check=True,
                          capture_output=True,
                          env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)})
    assert done.stdout == f"controller {__version__} (dfm_stage)\n"
