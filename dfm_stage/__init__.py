"""dfm_stage: simulation, identification, control and diagnosis of a flexure scanning stage."""

import os

__version__ = "0.2.0"

# Matrices here are small: threads of the linear algebra that wait for each other cost more than
# they give, on a busy machine thirty times more. Whoever has set these keeps them.
for _name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
