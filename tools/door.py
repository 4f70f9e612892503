"""./run: the names it knows, the set-up when it is needed, and the hand-over to the program."""

from __future__ import annotations

import os
import runpy
import shlex
import signal
import sys
from pathlib import Path
from types import SimpleNamespace

import environment
import host as host_module
import workspace
from console import SetupError, Steps, locked, say, sweep, write_whole

ROOT = Path(__file__).resolve().parent.parent
PRIVATE = ROOT / ".dfm"
OWN_COMMANDS = {
    "test": "the whole test suite; arguments go to pytest",
    "lint": "ruff, mypy, the rules of prose, the schemas of workflows, issue forms and citation",
    "docs": "the manual as a site, in out/site",
    "shell": "a shell with everything sourced; -c COMMAND runs one command",
    "exec": "one command in the environment: ./run exec CMD ...",
    "setup": "prepare everything and stop",
}
TOOLS_HERE = {"lint": "lint.py", "docs": "manual.py"}
PYTEST = ["-m", "pytest", "-p", "no:launch_testing", "-p", "no:launch_ros"]
MOST_TEST_PROCESSES = 4


USAGE = "usage: ./run NAME [arguments]     (./run NAME --help says more)"
NEEDED = """
The first call prepares everything inside this checkout (.dfm); Python 3.10 to 3.13
and a C++ compiler are needed. DFM_PYTHON names another Python than python3."""


def commands() -> SimpleNamespace:
    """What dfm_stage/commands.py defines, read without importing the package."""
    return SimpleNamespace(**runpy.run_path(str(ROOT / "dfm_stage/commands.py")))


def prepare() -> tuple[Path, dict[str, str]]:
    """Bring environment and build up to date; their folder, and the variables to run with."""
    host = host_module.find_host(os.environ, PRIVATE / "installation.json")
    folder = PRIVATE / host.tag
    if not environment.is_ready(ROOT, host, folder) or workspace.stale(ROOT, folder):
        if host.remark:
            say(f"run: {host.remark}; the private environment is used")
        host_module.check(host)
        write_whole(PRIVATE / "COLCON_IGNORE", "")
        with locked(PRIVATE / "lock") as lock_fd:
            sweep(folder)
            steps = Steps(lock_fd)
            if not environment.is_ready(ROOT, host, folder):
                steps.log_to(folder / "logs/environment.log")
                environment.build(ROOT, host, folder, steps, os.environ)
            if workspace.stale(ROOT, folder):
                steps.log_to(folder / "logs/build.log")
                variables = workspace.variables(host, folder, os.environ)
                compiling = [str(folder / "env/bin/python"), "-m", "dfm_stage.compile_all"]
                with steps.beside(compiling, variables, "simulator compiled", ROOT):
                    workspace.build(ROOT, folder, steps, variables)
    variables = workspace.variables(host, folder, os.environ)
    wanted, used = (v.get("RMW_IMPLEMENTATION") for v in (os.environ, variables))
    if wanted and wanted != used:
        say(
            f"run: RMW_IMPLEMENTATION={wanted} is not in the private environment, {used} is used; "
            f"source a ROS 2 installation to run with {wanted}"
        )
    return folder, variables


def shell_command(arguments: list[str], folder: Path, variables: dict[str, str]) -> list[str]:
    """bash with the environment, kept even if the user's own start-up file changes it."""
    bash = "/bin/bash" if os.path.exists("/bin/bash") else "/bin/sh"
    if arguments or not sys.stdin.isatty():
        return [bash, *arguments]
    changed = {name: value for name, value in variables.items() if os.environ.get(name) != value}
    lines = ["[ -f ~/.bashrc ] && . ~/.bashrc"]
    lines += [f"export {name}={shlex.quote(value)}" for name, value in changed.items()]
    lines.append('PS1="(dfm_stage) ${PS1-\\$ }"')
    start_up = folder / "shellrc"
    write_whole(start_up, "\n".join(lines) + "\n")
    return [bash, "--rcfile", str(start_up), "-i"]


def side_by_side(arguments: list[str]) -> list[str]:
    """The options that spread the tests over the cores, unless single files are asked for."""
    if any(os.path.exists(argument.partition("::")[0]) for argument in arguments):
        return []
    processes = str(min(len(os.sched_getaffinity(0)), MOST_TEST_PROCESSES))
    return ["-n", processes, "--dist", "loadfile", "--no-loadscope-reorder"]


def command_for(name: str, rest: list[str], folder: Path, variables: dict[str, str]) -> list[str]:
    """The program to become for one of the known names."""
    python = str(folder / "env/bin/python")
    if name == "shell":
        return shell_command(rest, folder, variables)
    if name == "exec":
        return rest
    if name == "test":
        os.chdir(ROOT)
        variables["ROS_PYTHON_CHECK_FIELDS"] = "1"
        return [python, *PYTEST, *side_by_side(rest), *rest]
    if name in TOOLS_HERE:
        os.chdir(ROOT)
        return [python, str(ROOT / "tools" / TOOLS_HERE[name]), *rest]
    current_folder_not_first = [] if folder.name.endswith("py3.10") else ["-P"]
    return [python, *current_folder_not_first, "-m", "dfm_stage", name, *rest]


def main(arguments: list[str]) -> int:
    """Exit code, unless the process became the program; 2 for a name that is not known."""
    known = commands()
    if not arguments or arguments[0] in ("-h", "--help", "help"):
        groups = ("tools", known.TOOLS), ("nodes", known.NODES), ("working here", OWN_COMMANDS)
        print("\n".join([*known.listing(USAGE, *groups), NEEDED]))
        return 0
    name, rest = arguments[0], arguments[1:]
    names = [*known.NODES, *known.TOOLS, *OWN_COMMANDS]
    if name not in names:
        say(f"run: {known.unknown(name, names, './run lists the names')}")
        return 2
    if name == "exec" and not rest:
        say("run: exec needs a command: ./run exec CMD ...")
        return 2
    before = signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    try:
        if signal.getsignal(signal.SIGINT) != signal.SIG_IGN:
            signal.signal(signal.SIGINT, signal.default_int_handler)
        folder, variables = prepare()
        command = command_for(name, rest, folder, variables) if name != "setup" else []
        if name not in OWN_COMMANDS:  # dfm_stage unblocks them when it can answer
            signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT, signal.SIGTERM))
    except SetupError as error:
        say(f"run: {error}")
        return error.exit_code
    except KeyboardInterrupt:
        say("\nrun: stopped; the next call goes on with the set-up")
        return 130
    return become(command, variables, before) if command else 0


def become(command: list[str], variables: dict[str, str], on_sigterm: object) -> int:
    """Replace this process by the command, with the signals as they came in."""
    signal.signal(signal.SIGTERM, on_sigterm)  # type: ignore[arg-type]
    signal.signal(signal.SIGPIPE, signal.SIG_DFL)
    sys.stdout.flush()
    try:
        os.execvpe(command[0], command, variables)
    except OSError as error:
        say(f"run: {command[0]}: {error.strerror}")
        return 127
