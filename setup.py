"""The package dfm_stage, for colcon (ament_python) and as the wheel dfm-stage.

Everything about it stands here and not in pyproject.toml, because the setuptools of older ROS
installations does not read the table [project]. The builds differ in what they put on the path.
"""

import contextlib
import os
import sys
from glob import glob

from setuptools import find_packages, setup

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))

from dfm_stage import __version__
from dfm_stage.commands import NODES, TOOLS

SCRIPT = """\
import sys

from dfm_stage.interruption import end_at_once

end_at_once()

from dfm_stage.__main__ import entry

sys.exit(entry())
"""
"""What colcon puts into lib/dfm_stage. setuptools' own script looks its entry point up first: that
takes time at every start, and a signal meanwhile ends in a traceback."""
HERE = os.path.dirname(os.path.abspath(__file__))
PACKAGE = "dfm_stage"
PYTEST_PLUGIN = "pytest_dfm_stage"
REPOSITORY = ""
"""Address of the public repository. None is known yet: RELEASING.md says when to write it here."""
FOR_PIP = "setuptools.build_meta" in sys.modules
"""pip and other front ends build through this module, colcon runs this file."""
DEPENDENCIES = [
    "control>=0.10",
    "filterpy>=1.4.5",
    "lz4>=4.3.2",
    "matplotlib>=3.8",
    "mcap>=1.1",
    "numba>=0.59",
    "numpy>=1.26",
    'numpy>=2; sys_platform == "win32"',    # whole numbers of 64 bits, as elsewhere
    "ruamel.yaml>=0.18",
    "scipy>=1.14",
    "zstandard>=0.22",
]
EXTRAS = {
    "cluster": ["distributed>=2024.1"],
    "docs": ["furo>=2024.8", "latex2mathml>=3.77", "myst-parser>=4", "sphinx>=8"],
    "frames": ["pandas>=2.0", "xarray>=2023.6"],
    "test": [
        "hypothesis>=6.90",
        "mcap-ros2-support>=0.6",
        "pytest>=7.4,<9",
        "pytest-rerunfailures>=13",
        "pytest-timeout>=2.2",
        "rosbags>=0.9.20",
    ],
}
CLASSIFIERS = [
    "Development Status :: 4 - Beta",
    "Intended Audience :: Manufacturing",
    "Intended Audience :: Science/Research",
    "Operating System :: OS Independent",
    "Programming Language :: Python :: 3",
    *(f"Programming Language :: Python :: 3.{minor}" for minor in (10, 11, 12, 13)),
    "Topic :: Scientific/Engineering",
    "Typing :: Typed",
]


def addresses():
    """Where package indexes send a reader."""
    found = {"ROS 2 Jazzy": "https://docs.ros.org/en/jazzy/"}
    if REPOSITORY:
        found |= {"Source": REPOSITORY, "Issues": f"{REPOSITORY}/issues",
                  "Documentation": f"{REPOSITORY}/blob/main/docs/index.md",
                  "Changelog": f"{REPOSITORY}/blob/main/CHANGELOG.md"}
    return found


def files(folder):
    """Every file below a folder, by its path from here."""
    return [path for path in sorted(glob(f"{folder}/**", recursive=True))
            if os.path.isfile(path) and "__pycache__" not in path]


def share(folder, where):
    """data_files entries that put every file below `folder` under share/dfm_stage/<where>."""
    by_folder = {}
    for path in files(folder):
        inside = os.path.relpath(os.path.dirname(path), folder)
        by_folder.setdefault(os.path.normpath(os.path.join(where, inside)), []).append(path)
    return [(f"share/{PACKAGE}/{name}", paths) for name, paths in by_folder.items()]


def readme():
    """The text that package indexes show."""
    with open(os.path.join(HERE, "README.md"), encoding="utf-8") as file:
        return file.read()


if not FOR_PIP:
    with contextlib.suppress(ImportError):  # a setuptools that has no such class writes its own
        from setuptools.command.easy_install import ScriptWriter

        ScriptWriter.template = SCRIPT

setup(
    name="dfm-stage",
    version=__version__,
    description="Simulation, identification, control and diagnosis of a flexure scanning stage.",
    long_description=readme() if FOR_PIP else None,
    long_description_content_type="text/markdown",
    maintainer="dfm_stage maintainers",
    maintainer_email="maintainers@users.noreply.github.com",
    license="Apache-2.0",
    keywords=["system identification", "model diagnosis", "flexure", "nanopositioning", "ROS 2"],
    classifiers=CLASSIFIERS,
    project_urls=addresses(),
    python_requires=">=3.10,<3.14",
    packages=find_packages(include=[PACKAGE, f"{PACKAGE}.*"]),
    py_modules=[PYTEST_PLUGIN],
    package_data={PACKAGE: [os.path.relpath(path, PACKAGE) for path in files(PACKAGE)
                            if not path.endswith((".py", ".pyc"))]},
    # ROS looks for packages, parameters and launch files in share/
    data_files=[] if FOR_PIP else [
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
        *share(f"{PACKAGE}/config", "config"),
        *share("launch", "launch"),
    ],
    install_requires=DEPENDENCIES,
    extras_require=EXTRAS,
    zip_safe=False,
    entry_points={"console_scripts": [
        f"{name} = dfm_stage.__main__:entry"
        for name in (("dfm-stage",) if FOR_PIP else (*NODES, *TOOLS))],
                  "pytest11": [f"{PYTEST_PLUGIN} = {PYTEST_PLUGIN}"]},
)
