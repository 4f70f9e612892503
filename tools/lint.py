"""./run lint: ruff, mypy, the rules of prose and the schemas of GitHub's files, all always; exit 1
if one complains.

check-jsonschema brings the schemas along, so that this needs no network.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

SCHEMAS = {
    "vendor.github-workflows": ".github/workflows/*.yml",
    "custom.github-workflows-require-timeout": ".github/workflows/*.yml",
    "vendor.github-issue-forms": ".github/ISSUE_TEMPLATE/[!c]*.yml",
    "vendor.github-issue-config": ".github/ISSUE_TEMPLATE/config.yml",
    "vendor.dependabot": ".github/dependabot.yml",
    "vendor.citation-file-format": "CITATION.cff",
}


def schema_checks(root: Path) -> list[list[str]]:
    """The command that holds each kind of file below `root` against its schema."""
    return [
        ["-m", "check_jsonschema", "--quiet", "--builtin-schema", schema, *map(str, files)]
        for schema, pattern in SCHEMAS.items()
        if (files := sorted(root.glob(pattern)))
    ]


def main(root: Path = Path()) -> int:
    """Run the checkers with this interpreter."""
    checks = [
        ("ruff", ["-m", "ruff", "check", "."]),
        ("mypy", ["-m", "mypy"]),
        ("prose", [str(Path(__file__).with_name("prose.py"))]),
        *(("the schemas", check) for check in schema_checks(root)),
    ]
    failed = dict.fromkeys(
        name
        for name, command in checks
        if subprocess.run([sys.executable, *command], check=False).returncode
    )
    print(
        f"lint: {' and '.join(failed)} complained"
        if failed
        else "lint: ruff, mypy, prose and the schemas are content"
    )
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
