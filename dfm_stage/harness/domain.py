"""A ROS domain of one's own, so that two node graphs on one machine do not see each other."""

from __future__ import annotations

import contextlib
import os
import socket

from dfm_stage.errors import DfmError
from dfm_stage.middleware.shared_memory import DOMAIN_GAIN, PORT_BASE

DOMAINS = range(1, 102)  # 0 is everybody's default; above 101 DDS ports meet the ephemeral ones
# DDSI-RTPS 2.5, 9.6.2.4: offset and step of a participant's own port in its domain
UNICAST_OFFSET, PARTICIPANT_GAIN = 10, 2
PARTICIPANTS_LOOKED_FOR = 4


class NoFreeDomainError(DfmError):
    """Every ROS domain of this machine is taken."""


class Domain(contextlib.AbstractContextManager["Domain"]):
    """A domain id that this process holds until `release` or its end; a context manager.

    Held by an abstract socket's name: the kernel frees it with the process, however that ends, and
    it reaches as far as discovery on localhost does, which is one network namespace.
    """

    def __init__(self, number: int, claim: socket.socket) -> None:
        self.number = number
        self._claim = claim

    def release(self) -> None:
        """Let others have the domain; again is harmless."""
        self._claim.close()

    def __exit__(self, *_: object) -> None:
        self.release()


def claim_domain(first: int | None = None) -> Domain:
    """Claim a domain that no other claimer holds and in which nobody is heard.

    `first` is tried first (by default one that depends on the process id), then the others in
    turn. The domain is held as long as the returned object lives. Raises NoFreeDomainError.
    """
    start = (os.getpid() if first is None else first - DOMAINS.start) % len(DOMAINS)
    for step in range(len(DOMAINS)):
        number = DOMAINS[(start + step) % len(DOMAINS)]
        claim = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        with contextlib.suppress(OSError):  # another claimer has it
            claim.bind(f"\0dfm_stage_domain_{number}")
            if not _has_participants(number):
                return Domain(number, claim)
        claim.close()
    raise NoFreeDomainError(
        f"all ROS domains {DOMAINS[0]} to {DOMAINS[-1]} of this machine are in use: "
        "end some of the node graphs that run here"
    )


def _has_participants(number: int) -> bool:
    """Whether one of the first participants' ports of the domain is bound on this machine."""
    first = PORT_BASE + DOMAIN_GAIN * number + UNICAST_OFFSET
    for participant in range(PARTICIPANTS_LOOKED_FOR):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.bind(("", first + PARTICIPANT_GAIN * participant))
            except OSError:
                return True
    return False
