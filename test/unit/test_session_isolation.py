"""What conftest.py promises: a leaked process fails its test, no two sessions share a domain."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from dfm_stage.harness.domain import DOMAINS, claim_domain

CONFTEST = Path(__file__).parents[1] / "conftest.py"
LEAKING = """
import subprocess, sys

def test_leaks_a_child():
    print("PID", subprocess.Popen(["sleep", "600"]).pid)

def test_leaks_an_orphan():
    code = (
        "import subprocess as s;"
        "print('PID', s.Popen(['sleep', '601'], stdout=s.DEVNULL, stderr=s.DEVNULL).pid)"
    )
    print(subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout)

def test_cleans_up():
    subprocess.run(["sleep", "0"], check=True)
"""


def run_session(folder: Path, body: str, *options: str) -> subprocess.CompletedProcess[str]:
    (folder / "conftest.py").write_text(CONFTEST.read_text())
    (folder / "test_inner.py").write_text(body)
    return subprocess.run(
        [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "-s", *options, str(folder)],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        capture_output=True,
        text=True,
        check=False,
    )


def runs(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


@pytest.mark.slow
def test_a_process_left_behind_fails_the_test_and_is_ended(tmp_path: Path) -> None:
    session = run_session(tmp_path, LEAKING)
    assert "3 passed, 2 errors" in session.stdout
    assert "left 1 process(es) running: sleep 600" in session.stdout
    assert "left 1 process(es) running: sleep 601" in session.stdout
    pids = [int(line.split()[-1]) for line in session.stdout.splitlines() if "PID" in line]
    assert len(pids) == 2
    assert not any(runs(pid) for pid in pids)


def test_a_session_inside_another_gets_another_domain_and_other_folders(tmp_path: Path) -> None:
    names = ("ROS_DOMAIN_ID", "ROS_LOG_DIR", "ROS_HOME")
    body = f"""
import os
def test_shows():
    print("SEEN", *(os.environ[name] for name in {names!r}))
"""
    session = run_session(tmp_path, body)
    seen = next(line for line in session.stdout.splitlines() if "SEEN" in line).split("SEEN")[1]
    assert session.returncode == 0
    assert not set(seen.split()) & {os.environ[name] for name in names}
    assert not any(Path(folder).exists() for folder in seen.split()[1:])


def test_a_domain_is_held_until_released() -> None:
    with claim_domain() as held, claim_domain(held.number) as other:
        assert other.number != held.number
    with claim_domain(held.number) as again:
        assert again.number == held.number


def test_a_domain_is_freed_when_its_holder_is_killed() -> None:
    code = (
        "from dfm_stage.harness.domain import claim_domain; import time;"
        "held = claim_domain(); print(held.number, flush=True); time.sleep(600)"
    )
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE) as holder:
        try:
            assert holder.stdout is not None
            number = int(holder.stdout.readline())
            with claim_domain(number) as other:
                assert other.number != number
        finally:
            holder.kill()
    with claim_domain(number) as freed:
        assert freed.number == number


@pytest.mark.parametrize("first", [1, 50, 101])
def test_numbers_stay_in_the_safe_range(first: int) -> None:
    claims = [claim_domain(first) for _ in range(3)]
    assert len({claim.number for claim in claims}) == len(claims)
    assert all(claim.number in DOMAINS for claim in claims)
    for claim in claims:
        claim.release()
