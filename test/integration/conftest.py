"""What several integration tests need of the machine."""

from __future__ import annotations

import pytest

from benchmarks.hosts import Hosts, NoHostsError


@pytest.fixture(scope="session")
def hosts_permitted() -> None:
    """Skip where network namespaces are not permitted."""
    try:
        with Hosts(("one",)):
            return
    except NoHostsError as error:
        pytest.skip(str(error))
