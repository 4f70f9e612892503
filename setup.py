"""Installs the ament_python package dfm_stage (colcon build, or pip)."""

import os
import sys
from glob import glob

from setuptools import find_packages, setup

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))

from dfm_stage import __version__
from dfm_stage.commands import NODES, TOOLS, module_of

PACKAGE = "dfm_stage"


def share(folder):
    """data_files entries that put every file below `folder` under share/dfm_stage/<folder>."""
    by_folder = {}
    for path in sorted(glob(f"{folder}/**", recursive=True)):
        if os.path.isfile(path) and "__pycache__" not in path:
            by_folder.setdefault(os.path.dirname(path), []).append(path)
    return [(f"share/{PACKAGE}/{where}", files) for where, files in by_folder.items()]


setup(
    name=PACKAGE,
    version=__version__,
    description="Simulation, identification, control and diagnosis of a flexure scanning stage.",
    maintainer="dfm_stage maintainers",
    maintainer_email="maintainers@users.noreply.github.com",
    license="Apache-2.0",
    python_requires=">=3.10",
    packages=find_packages(include=[PACKAGE, f"{PACKAGE}.*"]),
    package_data={"": ["py.typed", "*.css", "*.html", "*.js", "*.json", "*.svg", "*.txt",
                       "*.yaml"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
        *share("config"),
        *share("launch"),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"], "cluster": ["distributed>=2024.1"]},
    zip_safe=False,
    entry_points={
        "console_scripts": [f"{name} = {module_of(name)}:main" for name in (*NODES, *TOOLS)]
    },
)
