"""The workflows: jobs that run here, pinned actions, no rights but to read."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import lint
import pytest
import yaml

ROOT = Path(__file__).parents[3]
WORKFLOWS = sorted((ROOT / ".github/workflows").glob("*.yml"))


def loaded(path: Path) -> dict[Any, Any]:
    return dict(yaml.safe_load(path.read_text("utf-8")))


def jobs() -> list[tuple[str, dict[str, Any]]]:
    return [(f"{path.stem}.{name}", job) for path in WORKFLOWS
            for name, job in loaded(path)["jobs"].items()]


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.stem)
def test_a_workflow_may_read_and_nothing_else(path: Path) -> None:
    workflow = loaded(path)
    assert workflow["permissions"] == {"contents": "read"}
    assert not any("permissions" in job for job in workflow["jobs"].values())


@pytest.mark.parametrize(("name", "job"), jobs())
def test_a_job_is_a_call_of_a_script_that_runs_here(name: str, job: dict[str, Any]) -> None:
    calls = [step["run"] for step in job["steps"] if "run" in step]
    assert calls == [f".ci/job {name.partition('.')[2]}"]
    script = (ROOT / ".ci/job").read_text("utf-8")
    assert re.search(rf"^{calls[0].split()[1]}\(\) {{", script, re.MULTILINE)


@pytest.mark.parametrize(("name", "job"), jobs())
def test_actions_are_pinned_and_keep_no_credentials(name: str, job: dict[str, Any]) -> None:
    text = WORKFLOWS[0].read_text("utf-8")
    for step in job["steps"]:
        if "uses" in step:
            assert re.fullmatch(r"[\w-]+/[\w-]+@[0-9a-f]{40}", step["uses"]), step["uses"]
            assert re.search(rf"{step['uses']} # v\d+\.\d+\.\d+$", text, re.MULTILINE)
        if step.get("uses", "").startswith("actions/checkout@"):
            assert step["with"]["persist-credentials"] is False


def test_every_python_that_is_promised_is_tested() -> None:
    tested = loaded(ROOT / ".github/workflows/ci.yml")["jobs"]["tests"]["strategy"]["matrix"]
    promised = re.search(r"for minor in \(([\d, ]+)\)", (ROOT / "setup.py").read_text("utf-8"))
    assert promised
    assert tested["python"] == [f"3.{minor.strip()}" for minor in promised[1].split(",")]


def test_an_unknown_job_is_refused_in_one_line() -> None:
    done = subprocess.run([ROOT / ".ci/job", "nonsense"], capture_output=True, text=True,
                          check=False)
    assert done.returncode == 2
    assert done.stderr.splitlines() == ["usage: .ci/job lint|tests|docs|wheel|ros"]


def test_the_form_for_a_diagnosis_asks_for_its_file() -> None:
    form = loaded(ROOT / ".github/ISSUE_TEMPLATE/wrong_diagnosis.yml")
    asked = {each["attributes"]["label"]: each for each in form["body"]}
    assert asked["diagnosis.json"]["validations"]["required"] is True


def test_hooks_before_a_commit_call_what_there_is() -> None:
    for repository in loaded(ROOT / ".pre-commit-config.yaml")["repos"]:
        assert repository["repo"] == "local"
        for hook in repository["hooks"]:
            assert (ROOT / hook["entry"].split()[0]).is_file()


def complaints(checks: list[list[str]]) -> list[str]:
    """The schemas that are not kept; each check is a process of its own."""
    pytest.importorskip("check_jsonschema")
    return [check[4] for check in checks if subprocess.run(
        [sys.executable, *check], capture_output=True, check=False).returncode]


def test_what_is_there_is_accepted_by_lint() -> None:
    checks = lint.schema_checks(ROOT)
    assert {check[4] for check in checks} == set(lint.SCHEMAS)
    assert complaints(checks) == []


@pytest.mark.parametrize(("file", "found", "wrong"), [
    (".github/workflows/ci.yml", "runs-on:", "run-on:"),
    (".github/workflows/ci.yml", "timeout-minutes: 20", "continue-on-error: false"),
    (".github/ISSUE_TEMPLATE/bug.yml", "type: textarea", "type: textbox"),
    (".github/ISSUE_TEMPLATE/config.yml", "true", "perhaps"),
    (".github/dependabot.yml", "interval: monthly", "interval: hourly"),
    ("CITATION.cff", "type: software", "type: machine"),
])
def test_what_is_wrong_is_seen_by_lint(file: str, found: str, wrong: str, tmp_path: Path) -> None:
    """By a schema that the file is held against; the checks of other files do not read it."""
    shutil.copytree(ROOT / ".github", tmp_path / ".github")
    shutil.copy(ROOT / "CITATION.cff", tmp_path)
    path = tmp_path / file
    text = path.read_text("utf-8")
    assert found in text
    path.write_text(text.replace(found, wrong, 1))
    checks = [check for check in lint.schema_checks(tmp_path) if str(path) in check]
    assert complaints(checks)
