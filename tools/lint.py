"""./run lint: ruff and mypy over the checkout, both always run; exit 1 if either complains."""

from __future__ import annotations

import subprocess
import sys


def main() -> int:
    """Run both checkers with this interpreter."""
    python = sys.executable
    checks = ([python, "-m", "ruff", "check", "."], [python, "-m", "mypy"])
    failed = [command[2] for command in checks if subprocess.run(command, check=False).returncode]
    print(
        f"lint: {' and '.join(failed)} complained" if failed else "lint: ruff and mypy are content"
    )
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
