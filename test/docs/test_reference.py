"""docs/reference.md is what the code says, and what a running graph offers."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest
from pages import ROOT
from reference_page import FURTHER_TOPICS, SERVICES, reference_page

from dfm_stage.harness import StageGraph
from dfm_stage.nodes.wiring import LINKS

OF_ROS = ("describe_parameters", "get_parameter_types", "get_parameters", "list_parameters",
          "set_parameters", "set_parameters_atomically", "get_type_description")
LIFE_CYCLE = ("get_available_states", "get_available_transitions", "get_transition_graph")


def test_the_page_is_written_from_the_code() -> None:
    assert (ROOT / "docs/reference.md").read_text(encoding="utf-8") == reference_page(), (
        "run ./run exec python tools/reference_page.py > docs/reference.md")


@pytest.fixture(scope="module")
def offered(tmp_path_factory: pytest.TempPathFactory) -> Iterable[tuple[dict[str, str], set[str]]]:
    """Topics with their types, and services with theirs, of a whole graph."""
    bag = tmp_path_factory.mktemp("reference") / "bag"
    with StageGraph(lockstep=True, composed=True, bag=bag, model="current_stage") as graph:
        topics, services = {}, set()
        for launched in graph.launched:
            node: Any = launched.node
            where = (launched.kind, launched.namespace)
            for name, types in node.get_publisher_names_and_types_by_node(*where):
                topics[_short(name, launched)] = types[0].replace("/msg/", "/")
            for name, types in node.get_service_names_and_types_by_node(*where):
                if name.rpartition("/")[2] not in OF_ROS and "/_action/" not in name:
                    services.add((_short(name, launched), types[0].replace("/srv/", "/")))
        yield topics, services


def _short(name: str, launched: Any) -> str:
    name = name.removeprefix("/stage/x/")
    for generic in ("ready", "config"):
        if name.rpartition("/")[2] == generic:
            return f"<node>/{generic}"
    if name.partition("/")[0] in ("encoder_driver", "amplifier_driver"):
        last = name.rpartition("/")[2]
        if last in ("change_state", "get_state", "transition_event", *LIFE_CYCLE):
            return f"<driver>/{last}"
    return name


def test_every_topic_of_the_graph_is_listed(offered: tuple[dict[str, str], set[Any]]) -> None:
    listed = {name: f"dfm_interfaces/{link.type.__name__}" for name, link in LINKS.items()}
    listed |= {name: said[0] for name, said in FURTHER_TOPICS.items()}
    seen = {name: kind for name, kind in offered[0].items()
            if name not in ("/rosout", "/parameter_events") and "/_action/" not in name}
    assert seen == listed


def test_every_service_of_the_graph_is_listed(offered: tuple[dict[str, str], set[Any]]) -> None:
    listed = {(name, said[0]) for name, said in SERVICES.items() if "(action)" not in said[0]}
    seen = {each for each in offered[1] if each[0].rpartition("/")[2] not in LIFE_CYCLE}
    assert seen == listed
