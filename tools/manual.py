"""./run docs: the site of the manual in out/site, built strictly; the path of its first page.

Sphinx is fetched at the first call, pinned by requirements/docs.txt, into a folder beside the
environment. It runs in the environment, because the API reference imports the package.
"""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from pathlib import Path

from console import SetupError, read_stamp, remove_tree, say, write_stamp

ROOT = Path(__file__).resolve().parent.parent
PINS = ROOT / "requirements" / "docs.txt"
SITE = ROOT / "out" / "site"


def packages() -> Path:
    """Bring Sphinx and its theme into a folder of their own, unless they are there."""
    folder = ROOT / ".dfm" / f"docs-py{sys.version_info[0]}.{sys.version_info[1]}"
    key = hashlib.sha256(PINS.read_bytes()).hexdigest()
    if read_stamp(folder / "stamp.json").get("key") == key:
        return folder
    say("docs: fetching Sphinx ...")
    remove_tree(folder)
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    done = subprocess.run([*pip, "--no-deps", "--target", folder, "-r", PINS],
                          capture_output=True, text=True, check=False)
    if done.returncode:
        reason = (done.stderr.strip().splitlines() or ["no reason given"])[-1]
        raise SetupError(f"Sphinx cannot be fetched: {reason}", exit_code=1)
    write_stamp(folder / "stamp.json", {"key": key})
    return folder


def main(argv: list[str]) -> int:
    """Build the site into the folder given, by default out/site; 1 where Sphinx warns."""
    site = Path(argv[0]) if argv else SITE
    try:
        found = packages()
    except SetupError as error:
        say(f"docs: {error}")
        return error.exit_code
    path = os.pathsep.join([str(ROOT), str(found), os.environ.get("PYTHONPATH", "")])
    build = [sys.executable, "-m", "sphinx", "--quiet", "--fail-on-warning", "--keep-going",
             "--builder", "html", "--doctree-dir", str(found / "doctrees"), str(ROOT / "docs"),
             str(site)]
    if subprocess.run(build, env={**os.environ, "PYTHONPATH": path}, check=False).returncode:
        return 1
    print(site / "index.html")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
