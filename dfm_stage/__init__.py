"""dfm_stage: simulation, identification, control and diagnosis of a flexure scanning stage."""

import os

__version__ = "0.1.0"

# numba keeps compiled code by the path of its source: one path for a checkout and for the links
# that `colcon build --symlink-install` makes to it
__path__ = [os.path.realpath(folder) for folder in __path__]
