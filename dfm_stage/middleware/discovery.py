"""Who may find the nodes of this process: this machine, unless the user says otherwise.

With ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST alone the sockets still stand on every interface, and
a stranger who names this machine's address (ROS_STATIC_PEERS) finds the nodes. The Fast DDS
profile `fastdds_local.xml` leaves nothing but loopback.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from dfm_stage.share import config_folder

RANGE, PEERS = "ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_STATIC_PEERS"
PROFILES = "FASTRTPS_DEFAULT_PROFILES_FILE"
LOCAL, OPEN = "fastdds_local.xml", "fastdds.xml"


def keep_to_this_machine() -> None:
    """Set what the middleware reads when the first node is made; what the user set stays.

    A profile of ours that a parent process chose is chosen anew.
    """
    os.environ.setdefault(RANGE, "LOCALHOST")
    given = os.environ.get(PROFILES)
    if given and Path(given).name not in (LOCAL, OPEN):
        return
    local = os.environ[RANGE].upper() == "LOCALHOST" and not os.environ.get(PEERS)
    os.environ[PROFILES] = str(config_folder() / (LOCAL if local else OPEN))


@contextlib.contextmanager
def loopback_alone() -> Iterator[None]:
    """To be held while a ROS context is initialised.

    For LOCALHOST the middleware adds shared memory to the transports of any profile, and then
    everybody on this machine writes there. `fastdds_local.xml` limits the range by itself.
    """
    profile, asked = os.environ.get(PROFILES, ""), os.environ.get(RANGE, "")
    if Path(profile).name != LOCAL or asked.upper() != "LOCALHOST":
        yield
        return
    os.environ[RANGE] = "SYSTEM_DEFAULT"
    try:
        yield
    finally:
        os.environ[RANGE] = asked
