from __future__ import annotations

import sys
from pathlib import Path

from madrob_console.testbeds.ros.definitions import Definition
from madrob_console.testbeds.ros.loading import RosObject, load_module
from madrob_console.testbeds.ros.type_words import TypeWords
from tests.madrob_console.ros_peer import Peer

TYPE, HASH = "hall_msgs/msg/Gripper", "RIHS01_" + "5" * 64
SOURCES = {
    TYPE: "std_msgs/Header header\nhall_msgs/Force force\n",
    "hall_msgs/msg/Force": "float64 newton\n",
}
PREFIXES = (Path(sys.prefix),)


def serve(peer: Peer, *, encoding: str = "msg") -> list[RosObject]:
    """As the nodes of ROS 2 tell what their types are made of."""
    service = load_module("type_description_interfaces.srv").GetTypeDescription
    source = load_module("type_description_interfaces.msg").TypeSource
    asked: list[RosObject] = []

    def answer(request: RosObject, response: RosObject) -> RosObject:
        asked.append(request)
        response.successful = request.type_name == TYPE
        response.type_sources = [
            source(type_name=name, encoding=encoding, raw_file_contents=text)
            for name, text in SOURCES.items()
        ]
        return response

    name = f"{peer.own.get_fully_qualified_name()}/get_type_description"
    peer.own.create_service(service, name, answer)
    return asked


def found(peer: Peer, type_name: str = TYPE, type_hash: str = HASH) -> Definition:
    words = TypeWords(peer.node("asks"), PREFIXES)
    who = peer.own.get_fully_qualified_name()
    told: list[Definition] = []

    def look() -> bool:
        definition = words.find(type_name, type_hash, who)
        if definition is not None:
            told.append(definition)
        return definition is not None

    peer.until(look)
    assert not words.pending
    return told[0]


def test_a_type_that_only_its_publisher_knows_is_told_by_its_node(peer: Peer) -> None:
    asked = serve(peer)
    definition = found(peer)
    assert definition.type_hash == HASH
    assert definition.text.startswith(SOURCES[TYPE])
    assert f"MSG: hall_msgs/Force\n{SOURCES['hall_msgs/msg/Force']}" in definition.text
    assert [(one.type_name, one.type_hash) for one in asked] == [(TYPE, HASH)]


def test_a_type_that_nobody_knows_has_no_words_after_a_while(peer: Peer) -> None:
    assert found(peer) == Definition("", HASH)


def test_who_publishes_a_type_is_asked_as_soon_as_ros_knows_its_name(peer: Peer) -> None:
    serve(peer)
    words = TypeWords(peer.node("asks"), PREFIXES)
    assert words.find(TYPE, HASH, "") is None
    who = peer.own.get_fully_qualified_name()
    peer.until(lambda: words.find(TYPE, HASH, who))
    definition = words.find(TYPE, HASH, who)
    assert definition is not None
    assert definition.text.startswith(SOURCES[TYPE])


def test_a_type_whose_publisher_stays_without_a_name_has_no_words_after_a_while(
    peer: Peer,
) -> None:
    words = TypeWords(peer.node("asks"), PREFIXES)
    peer.until(lambda: words.find(TYPE, HASH, "") == Definition("", HASH))
    assert not words.pending


def test_what_is_no_message_definition_is_not_taken_for_one(peer: Peer) -> None:
    serve(peer, encoding="idl")
    assert found(peer) == Definition("", HASH)


def test_an_installed_type_is_known_at_once_and_another_version_of_it_is_asked_for(
    peer: Peer,
) -> None:
    words = TypeWords(peer.node("asks"), PREFIXES)
    installed = words.find("std_msgs/msg/Bool", "", "/nobody")
    assert installed is not None
    assert "bool data" in installed.text
    assert words.find("std_msgs/msg/Bool", installed.type_hash, "/nobody") == installed
    assert words.find("std_msgs/msg/Bool", HASH, "/nobody") is None
    assert words.pending
