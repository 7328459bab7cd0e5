"""Computation graph from liveliness tokens; tokens of a topic are received from its first use on."""

from __future__ import annotations

import logging
from functools import partial
from typing import TYPE_CHECKING, Any

from sfglab.bus.graph import Graph
from sfglab.bus.zenoh.layout import (
    NO_HASH,
    TOKENS,
    endpoint_infos,
    gid_of,
    mangled,
    node_info,
    token_kind,
    wire_type,
)
from sfglab.bus.zenoh.session import direct
from sfglab.names import ros_name_from_dds

if TYPE_CHECKING:
    from sfglab.bus.api import EndpointKind
    from sfglab.bus.loop import LoopBridge
    from sfglab.bus.zenoh.session import Session

_log = logging.getLogger("sfglab.bus")
_ALL = "**"


class ZenohGraph(Graph):
    """Graph of a node's own endpoints and of those that were asked for.

    Each session that receives a token costs its router time. Tokens of one topic are therefore received when the
    topic is watched or asked for, and all when `listen`, `endpoints`, `topics` or `nodes` is called.
    """

    def __init__(self, bridge: LoopBridge, session: Session, domain_id: int) -> None:
        super().__init__(bridge.loop, read_nodes=self._ask)
        self._bridge = bridge
        self._session = session
        self._domain = f"{TOKENS}/{domain_id}"
        self._asked: set[str] = set()
        self._hashes: dict[str, str] = {}

    def wire_type(self, name: str) -> tuple[str, str]:
        """Return the DDS type and hash of a type; an unknown type has the hash of other endpoints with it."""
        type_, hash_ = wire_type(name)
        return type_, self._hashes.get(type_, NO_HASH) if hash_ == NO_HASH else hash_

    def receive(self, token: str, *, alive: bool) -> None:
        """Take note of a token that was declared or has gone; callable from any thread."""
        self._bridge.post(partial(self._note, token, alive=alive))
        self._bridge.flush()

    def _note(self, token: str, *, alive: bool) -> None:
        try:
            infos, node = endpoint_infos(token), node_info(token)
        except ValueError:
            _log.debug("no token of ROS 2: %s", token)
            return
        if not infos:
            self.learn_nodes(gid_of(token), (node,) if alive else ())
            return
        dds_type, hash_ = token.split("/")[10:12]
        self._hashes[dds_type] = hash_
        self.apply([(info.gid, info if alive else None) for info in infos])

    def _ask(self, dds_topic: str = "", kind: EndpointKind | None = None) -> None:
        tokens = _ALL
        if kind and (wire := ros_name_from_dds(dds_topic)):
            tokens = f"*/*/*/{token_kind(dds_topic, kind)}/*/*/*/{mangled(wire.name)}/**"
        if self._asked.isdisjoint((tokens, _ALL)):
            self._asked.add(tokens)
            self._session.order(partial(self._subscribe, tokens))

    def _subscribe(self, tokens: str, session: Any) -> None:
        session.liveliness().declare_subscriber(
            f"{self._domain}/{tokens}", direct(self._take), history=True
        )

    def _take(self, sample: Any) -> None:
        token = str(sample.key_expr)
        # The node announces its own tokens: whether they come back depends on the routers.
        if f"/{self._session.id}/" not in token:
            self.receive(token, alive=str(sample.kind) == "SampleKind.PUT")
