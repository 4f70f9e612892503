"""./run: its names, what it says about the machine, when it rebuilds, and what it lets through."""

from __future__ import annotations

import importlib
import json
import os
import signal
import subprocess
import sys
import sysconfig
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[3]
sys.path.insert(0, str(ROOT / "tools"))
console, door, environment, host, workspace = (
    importlib.import_module(name)
    for name in ("console", "door", "environment", "host", "workspace")
)
VERSION = f"{sys.version_info[0]}.{sys.version_info[1]}"
BARE = host.Host(sys.executable, VERSION, None)
INSTALLED = host.Host(sys.executable, VERSION, "/opt/ros/jazzy")


def call(*words: str, **changes: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [*words],
        cwd=ROOT,
        env={**os.environ, **changes},
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.parametrize("asked", [[], ["--help"]])
def test_the_list_has_every_name_with_a_line(asked: list[str]) -> None:
    listed = call("./run", *asked)
    assert listed.returncode == 0
    known = door.commands()
    for name in (*known.NODES, *known.TOOLS, "test", "shell"):
        assert any(
            line.split()[:1] == [name] and len(line.split()) > 2
            for line in listed.stdout.splitlines()
        ), name


@pytest.mark.parametrize("front", [["./run"], [sys.executable, "-m", "dfm_stage"]])
def test_an_unknown_name_is_one_line_with_the_nearest(front: list[str]) -> None:
    refused = call(*front, "controler", "--ros-args")
    assert (refused.returncode, refused.stdout) == (2, "")
    assert len(refused.stderr.splitlines()) == 1
    assert "did you mean controller?" in refused.stderr


def test_a_reader_that_leaves_the_list_is_no_error() -> None:
    reading, writing = os.pipe()
    os.close(reading)
    front = subprocess.run(
        ["./run"], cwd=ROOT, stdout=writing, stderr=subprocess.PIPE, check=False
    )
    os.close(writing)
    assert (front.returncode, front.stderr) == (-signal.SIGPIPE, b"")


def test_signals_wait_for_a_node_or_tool_that_can_answer_them(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    blocked = {}
    monkeypatch.setattr(door, "prepare", lambda: (tmp_path, {}))

    def become(command: list[str], *_: object) -> int:
        blocked[command[-1]] = signal.pthread_sigmask(signal.SIG_BLOCK, ())
        signal.pthread_sigmask(signal.SIG_UNBLOCK, (signal.SIGINT, signal.SIGTERM))
        return 0

    monkeypatch.setattr(door, "become", become)
    assert door.main(["controller"]) == door.main(["exec", "true"]) == 0
    assert {signal.SIGINT, signal.SIGTERM} <= blocked["controller"]
    assert not {signal.SIGINT, signal.SIGTERM} & blocked["true"]


def test_a_missing_python_package_is_one_line() -> None:
    code = (
        "import sys; sys.modules['rclpy'] = sys.modules['dfm_interfaces'] = None;"
        "from dfm_stage.__main__ import main; sys.exit(main(['sim_plant']))"
    )
    refused = call(sys.executable, "-c", code)
    assert refused.returncode == 2
    assert len(refused.stderr.splitlines()) == 1
    assert "./run sim_plant" in refused.stderr


class TestHost:
    def test_names_the_compiler_to_install(self, monkeypatch, tmp_path: Path) -> None:
        monkeypatch.setenv("PATH", str(tmp_path))
        monkeypatch.delenv("CC", raising=False)
        monkeypatch.delenv("CXX", raising=False)
        with pytest.raises(console.SetupError, match=r"no C compiler .*: install g\+\+ .*apt-get"):
            host.check(BARE)
        (tmp_path / "cc").symlink_to("/bin/true")
        with pytest.raises(console.SetupError, match=r"no C\+\+ compiler.*install g\+\+"):
            host.check(BARE)

    @pytest.mark.parametrize(
        ("header", "has_venv", "package"),
        [("/nowhere/Python.h", True, "-dev"), (__file__, False, "-venv")],
    )
    def test_names_the_python_package_to_install(
        self, monkeypatch, header: str, has_venv: bool, package: str
    ) -> None:
        monkeypatch.setattr(host, "_python_offers", lambda _: (header, has_venv))
        monkeypatch.setattr(host.shutil, "which", lambda name: f"/usr/bin/{name}")
        with pytest.raises(console.SetupError, match=f"install python3[.0-9]*{package} "):
            host.check(BARE)

    def test_private_without_a_sourced_installation(self, tmp_path: Path) -> None:
        (tmp_path / f"lib/python{VERSION}/site-packages/rclpy").mkdir(parents=True)
        for changed in (
            {"ROS_DISTRO": "humble", "AMENT_PREFIX_PATH": str(tmp_path)},
            {"ROS_DISTRO": "jazzy", "AMENT_PREFIX_PATH": str(tmp_path / "elsewhere")},
            {"ROS_DISTRO": "jazzy"},
        ):
            assert host.find_host(changed, tmp_path / "cache").ros_prefix is None

    def test_own_private_environment_is_no_installation(self, tmp_path: Path) -> None:
        (tmp_path / f"lib/python{VERSION}/site-packages/rclpy").mkdir(parents=True)
        (tmp_path / host.PRIVATE_MARK).touch()
        sourced = {"ROS_DISTRO": "jazzy", "AMENT_PREFIX_PATH": str(tmp_path)}
        found = host.find_host(sourced, tmp_path / "cache")
        assert (found.ros_prefix, found.remark) == (None, "")

    @pytest.mark.parametrize("imports", [True, False])
    def test_an_installation_counts_if_rclpy_imports(self, tmp_path: Path, imports: bool) -> None:
        site = tmp_path / f"lib/python{VERSION}/site-packages"
        for name in ("rclpy", "rosidl_adapter"):
            (site / name).mkdir(parents=True)
            (site / name / "__init__.py").write_text("" if imports else "import no_such_thing")
        sourced = {
            **os.environ, "ROS_DISTRO": "jazzy", "AMENT_PREFIX_PATH": str(tmp_path),
            "PYTHONPATH": str(site),
        }  # fmt: skip
        for _ in range(2):  # the second answer is the remembered one
            found = host.find_host(sourced, tmp_path / "cache")
            assert found.ros_prefix == (str(tmp_path) if imports else None)
            assert bool(found.remark) is not imports


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """A small checkout with everything that decides a build."""
    for name in ("msg/A.msg", "package.xml", "CMakeLists.txt"):
        path = tmp_path / "dfm_interfaces" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(name)
    for name in ("package.xml", "setup.py", "setup.cfg", "dfm_stage/__init__.py",
                 "dfm_stage/commands.py", "dfm_stage/model/core.py", "dfm_stage/config/a.yaml",
                 "launch/a.launch.py", "resource/dfm_stage"):  # fmt: skip
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(name)
    return tmp_path


def mark_built(root: Path, folder: Path) -> None:
    for package, wanted in workspace.stale(root, folder).items():
        console.write_stamp(folder / f"{package}.json", wanted)
        installed = folder / "install" / package / "share" / package
        installed.mkdir(parents=True, exist_ok=True)
        (installed / "package.xml").touch()


class TestRebuild:
    @pytest.mark.parametrize(
        ("changed", "rebuilt"),
        [
            ("dfm_interfaces/msg/A.msg", ["dfm_interfaces"]),
            ("dfm_interfaces/msg/B.msg", ["dfm_interfaces"]),
            ("dfm_interfaces/action/Run.action", ["dfm_interfaces"]),
            ("dfm_interfaces/CMakeLists.txt", ["dfm_interfaces"]),
            ("setup.py", ["dfm_stage"]),
            ("dfm_stage/commands.py", ["dfm_stage"]),
            ("dfm_stage/config/models/new.yaml", ["dfm_stage"]),
            ("launch/new.launch.py", ["dfm_stage"]),
            ("dfm_stage/config/a.yaml", []),
            ("dfm_stage/model/core.py", []),
            ("dfm_stage/model/new.py", []),
            ("dfm_interfaces/__pycache__/x.pyc", []),
        ],
    )
    def test_what_changed_and_nothing_else(
        self, checkout: Path, changed: str, rebuilt: list[str]
    ) -> None:
        folder = checkout / ".dfm/private"
        assert list(workspace.stale(checkout, folder)) == ["dfm_interfaces", "dfm_stage"]
        mark_built(checkout, folder)
        assert not workspace.stale(checkout, folder)
        (checkout / changed).parent.mkdir(parents=True, exist_ok=True)
        (checkout / changed).write_text("changed")
        assert list(workspace.stale(checkout, folder)) == rebuilt

    def test_a_removed_file_or_build_is_noticed(self, checkout: Path) -> None:
        folder = checkout / ".dfm/private"
        mark_built(checkout, folder)
        (checkout / "dfm_stage/config/a.yaml").unlink()
        assert list(workspace.stale(checkout, folder)) == ["dfm_stage"]
        mark_built(checkout, folder)
        console.remove_tree(folder / "install/dfm_interfaces")
        assert list(workspace.stale(checkout, folder)) == ["dfm_interfaces"]

    def test_another_environment_rebuilds_all(self, checkout: Path) -> None:
        folder = checkout / ".dfm/private"
        mark_built(checkout, folder)
        console.write_stamp(folder / "environment.json", {"key": "another"})
        assert list(workspace.stale(checkout, folder)) == ["dfm_interfaces", "dfm_stage"]

    def test_the_environment_is_ready_only_with_its_own_stamp(self, tmp_path: Path) -> None:
        folder = tmp_path / "private"
        (folder / "env/bin").mkdir(parents=True)
        (folder / "env/bin/python").symlink_to(sys.executable)
        assert not environment.is_ready(ROOT, BARE, folder)
        (folder / "environment.json").write_text('{"key": "torn')
        assert not environment.is_ready(ROOT, BARE, folder)
        key = environment.key(ROOT, BARE, folder)
        console.write_stamp(folder / "environment.json", {"key": key})
        assert environment.is_ready(ROOT, BARE, folder)
        assert not environment.is_ready(ROOT, INSTALLED, folder)
        folder.rename(tmp_path / "moved")
        assert not environment.is_ready(ROOT, BARE, tmp_path / "moved")


def test_the_pinned_lists_name_one_version_each_and_no_host() -> None:
    for name in ("private.txt", "installed.txt"):
        lines = (ROOT / "requirements" / name).read_text().splitlines()
        assert all("==" in line.partition(";")[0] for line in lines)
        assert not any(word in line for line in lines for word in ("://", "--index", "--find"))
    assert "numpy==1.26.4" in (ROOT / "requirements/installed.txt").read_text().splitlines()


def test_exports_are_repaired_once(tmp_path: Path) -> None:
    site = f"lib/python{VERSION}/site-packages"
    exports = tmp_path / "share/some_msgs/cmake/export.cmake"
    exports.parent.mkdir(parents=True)
    exports.write_text(
        'set(A "/opt/python/cp312-cp312/include/python3.12;${_PREFIX}/include;'
        '/opt/python/cp312-cp312/lib/python3.12/site-packages/numpy/_core/include")'
    )
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin/python").symlink_to(sys.executable)
    assert environment.repair_exports(tmp_path, VERSION) == 1
    assert exports.read_text() == (
        f'set(A "{sysconfig.get_path("include")};${{_PREFIX}}/include;'
        f'{tmp_path}/{site}/numpy/_core/include")'
    )
    assert environment.repair_exports(tmp_path, VERSION) == 0
    exports.write_text("/opt/python/cp312-cp312/lib/libsomething.so")
    with pytest.raises(console.SetupError, match=str(exports)):
        environment.repair_exports(tmp_path, VERSION)


FOREIGN = {
    "AMENT_PREFIX_PATH": "/opt/ros/humble",
    "CMAKE_PREFIX_PATH": "/opt/ros/humble",
    "LD_LIBRARY_PATH": "/opt/ros/humble/lib:/opt/mine/lib",
    "PATH": "/home/me/venv/bin:/opt/ros/humble/bin:/usr/bin",
    "PYTHONHOME": "/usr",
    "PYTHONPATH": "/opt/ros/humble/lib/python3.10/site-packages",
    "RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp",
    "ROS_DISTRO": "humble",
    "VIRTUAL_ENV": "/home/me/venv",
}


@pytest.mark.parametrize("folder", ["plain", "with space", "long" * 40])
def test_scripts_start_whatever_the_path(tmp_path: Path, folder: str) -> None:
    python, scripts = tmp_path / folder / "python", tmp_path / folder / "lib"
    scripts.mkdir(parents=True)
    python.symlink_to(sys.executable)
    script = scripts / "node"
    script.write_text(f"#!{python}\nimport sys\nprint(sys.argv[1:])\n")
    script.chmod(0o755)
    for _ in range(2):
        workspace.make_startable(scripts, python)
        assert call(str(script), "a b", "c").stdout == "['a b', 'c']\n"


class TestVariables:
    def test_nothing_foreign_reaches_the_private_environment(self, tmp_path: Path) -> None:
        seen = workspace.variables(BARE, tmp_path, FOREIGN)
        assert not [name for name, value in seen.items() if "humble" in value or "venv" in value]
        assert seen["RMW_IMPLEMENTATION"] == "rmw_fastrtps_cpp"
        assert seen["PATH"].split(":") == [str(tmp_path / "env/bin"), "/usr/bin"]
        assert seen["LD_LIBRARY_PATH"].endswith(":/opt/mine/lib")
        assert "PYTHONHOME" not in seen

    def test_an_installation_keeps_what_it_set(self, tmp_path: Path) -> None:
        sourced = {
            "AMENT_PREFIX_PATH": "/opt/ros/jazzy", "PYTHONPATH": "/opt/ros/jazzy/lib/python",
            "RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp",
        }  # fmt: skip
        seen = workspace.variables(INSTALLED, tmp_path, sourced)
        assert seen["RMW_IMPLEMENTATION"] == "rmw_cyclonedds_cpp"
        assert seen["AMENT_PREFIX_PATH"].endswith(":/opt/ros/jazzy")
        assert seen["PYTHONPATH"].endswith(":/opt/ros/jazzy/lib/python")
        assert "_ROS_WHEELS_BOOTSTRAP_COMPLETE" not in seen

    def test_the_users_own_choices_stay(self, tmp_path: Path) -> None:
        chosen = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET", "NUMBA_CACHE_DIR": "/mine"}
        seen = workspace.variables(BARE, tmp_path, chosen)
        assert {name: seen[name] for name in chosen} == chosen
        default = workspace.variables(BARE, tmp_path, {})
        assert default["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST"

    def test_modules_are_compiled_once_and_not_in_the_checkout(self, tmp_path: Path) -> None:
        """A shell that writes no bytecode had every node compile all that it imports."""
        chosen = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1"}
        (tmp_path / "some.py").write_text("")
        subprocess.run([sys.executable, "-c", "import some"], check=True, cwd=tmp_path,
                       env=workspace.variables(BARE, tmp_path / "own", chosen))
        assert [path.name.partition(".")[0] for path in (tmp_path / "own").rglob("some*.pyc")]
        assert not list(tmp_path.glob("__pycache__"))

    def test_twice_is_once(self, tmp_path: Path) -> None:
        once = workspace.variables(BARE, tmp_path, FOREIGN)
        assert workspace.variables(BARE, tmp_path, once) == once


class TestConsole:
    def failing(self, folder: Path, text: str) -> str:
        with console.locked(folder / "lock") as lock_fd:
            steps = console.Steps(lock_fd)
            steps.log_to(folder / "step.log")
            with pytest.raises(console.SetupError) as caught, steps.step("a step"):
                steps.call(["sh", "-c", f"echo '{text}'; exit 3"], env=os.environ, what="the step")
        return str(caught.value)

    def test_a_failing_step_names_reason_and_log(self, tmp_path: Path) -> None:
        message = self.failing(tmp_path, "fine\nERROR: it broke\nmore")
        assert "ERROR: it broke" in message
        assert str(tmp_path / "step.log") in message
        assert "\n" not in message

    def test_of_steps_beside_each_other_any_may_fail(self, tmp_path: Path) -> None:
        commands = [["sh", "-c", "echo done >first"], ["sh", "-c", "echo ERROR: no; exit 3"]]
        with console.locked(tmp_path / "lock") as lock_fd:
            steps = console.Steps(lock_fd)
            steps.log_to(tmp_path / "step.log")
            with pytest.raises(console.SetupError, match="ERROR: no"):
                steps.call(*commands, env=os.environ, what="the steps", cwd=tmp_path)
        assert (tmp_path / "first").read_text() == "done\n"

    def test_a_missing_network_is_said(self, tmp_path: Path) -> None:
        assert "network" in self.failing(tmp_path, "Temporary failure in name resolution")

    def test_the_lock_keeps_a_second_one_waiting(self, tmp_path: Path) -> None:
        second = (
            "import sys, console; from pathlib import Path\n"
            f"with console.locked(Path({str(tmp_path / 'lock')!r})): print('in', flush=True)"
        )
        with console.locked(tmp_path / "lock"):
            waiting = subprocess.Popen(
                [sys.executable, "-c", second], cwd=ROOT / "tools", text=True,
                stdout=subprocess.PIPE, stderr=subprocess.PIPE,
            )  # fmt: skip
            assert waiting.stderr is not None
            assert "waiting" in waiting.stderr.readline()
            assert waiting.poll() is None
        assert waiting.communicate()[0] == "in\n"

    def test_a_torn_or_odd_stamp_is_no_stamp(self, tmp_path: Path) -> None:
        for text in ("", "{", "[1]"):
            (tmp_path / "stamp").write_text(text)
            assert console.read_stamp(tmp_path / "stamp") == {}
        console.write_stamp(tmp_path / "stamp", {"a": 1})
        assert json.loads((tmp_path / "stamp").read_text()) == {"a": 1}
        assert [path.name for path in tmp_path.iterdir()] == ["stamp"]


def test_modules_under_test_are_those_of_this_checkout() -> None:
    def file_of(module: ModuleType) -> Path:
        return Path(str(module.__file__)).parent

    assert {file_of(m) for m in (console, door, environment, host, workspace)} == {ROOT / "tools"}
