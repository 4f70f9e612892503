"""./run lint: ruff, mypy and the rules of prose; all always run; exit 1 if any complains."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

CHECKS = {
    "ruff": ["-m", "ruff", "check", "."],
    "mypy": ["-m", "mypy"],
    "prose": [str(Path(__file__).with_name("prose.py"))],
}


def main() -> int:
    """Run every check with this interpreter."""
    failed = [
        name
        for name, command in CHECKS.items()
        if subprocess.run([sys.executable, *command], check=False).returncode
    ]
    print(
        f"lint: {' and '.join(failed)} complained"
        if failed
        else "lint: ruff, mypy and prose are content"
    )
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
