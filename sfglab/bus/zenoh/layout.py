"""Layout of ROS 2 on Zenoh, as rmw_zenoh_cpp has it from Jazzy 0.2.4 on: keys, tokens, attachments and GIDs.

Sources are `liveliness_utils.cpp`, `qos.cpp` and `attachment_helpers.cpp` of rmw_zenoh_cpp, and REP 2016 for
type hashes. The module is pure; it does not load Zenoh.
"""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING
from urllib.parse import quote, unquote_to_bytes

from sfglab.bus.api import EndpointInfo, EndpointKind, NodeInfo, ros_topic
from sfglab.messages import TypeNameError, UnknownTypeError, ros_type_name, service_hash, type_hash
from sfglab.messages.type_names import announced_type_name
from sfglab.qos import Durability, History, Liveliness, QoSProfile, Reliability
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from enum import Enum

#: First part of every token; Zenoh's wildcards do not match parts that begin with "@".
TOKENS = "@ros2_lv"
NODE, PUBLISHER, SUBSCRIPTION, SERVER, CLIENT = "NN", "MP", "MS", "SS", "SC"
#: Part of a key in place of the hash of an unknown type; ROS 2 Humble always writes it.
NO_HASH = "TypeHashNotSupported"
#: Attachment of a sample, request or reply, in the serialization of zenoh-ext: sequence number from 1, source
#: time (ns), size of the GID, GID of the publisher or client. A reply repeats the request's number and GID.
ATTACHMENT = struct.Struct("<qqB16s")
GID_BYTES = 16

# Numbers of rmw/types.h; rmw_zenoh_cpp leaves out its defaults, which are the other values.
_NUMBERS: dict[Enum, str] = {
    Reliability.BEST_EFFORT: "2",
    Durability.TRANSIENT_LOCAL: "1",
    History.KEEP_ALL: "2",
    Liveliness.MANUAL_BY_TOPIC: "3",
}
_DEFAULT_DEPTH = 42
# Kinds of the tokens that announce endpoints, by the beginning of the DDS topic and by direction.
_TOKEN_KINDS = {
    ("rt", EndpointKind.PUBLISHER): PUBLISHER,
    ("rt", EndpointKind.SUBSCRIPTION): SUBSCRIPTION,
    ("rq", EndpointKind.SUBSCRIPTION): SERVER,
    ("rr", EndpointKind.PUBLISHER): SERVER,
    ("rq", EndpointKind.PUBLISHER): CLIENT,
    ("rr", EndpointKind.SUBSCRIPTION): CLIENT,
}
# Ends of DDS topics and of types, by the beginning of the DDS topic.
_TAILS = {"rt": ("", ""), "rq": ("Request", "_Request"), "rr": ("Reply", "_Response")}


def gid_of(token: str) -> bytes:
    """Return the 16-byte GID of a token: the XXH3-128 of its text, the low 64 bits first, little endian."""
    import xxhash

    number: int = xxhash.xxh3_128_intdigest(token.encode())
    return number.to_bytes(GID_BYTES, "little")


def end_gid(gid: bytes, dds_topic: str) -> bytes:
    """Return the GID of an endpoint by its token's GID and its topic.

    The token of a server or client has one GID for two endpoints. That of the reply endpoint differs in the last
    byte.
    """
    return gid[:-1] + bytes([gid[-1] ^ 1]) if dds_topic.startswith("rr/") else gid


def participant_guid(session: str) -> bytes:
    """Return the 16-byte GUID of a participant, which is a Zenoh session, by the session's id."""
    return bytes.fromhex(session.zfill(2 * GID_BYTES))


def qos_text(qos: QoSProfile) -> str:
    """Return the text of a QoS profile in a token."""
    kinds = (qos.reliability, qos.durability, qos.history, qos.liveliness)
    reliability, durability, history, liveliness = (_NUMBERS.get(kind, "") for kind in kinds)
    times = (qos.deadline_ns, qos.lifespan_ns, qos.lease_ns)
    deadline, lifespan, lease = (
        "," if t is None else "{},{}".format(*divmod(t, NS_PER_S)) for t in times
    )
    depth = "" if history or qos.depth == _DEFAULT_DEPTH else qos.depth
    life = f"{liveliness},{lease}"
    return f"{reliability}:{durability}:{history},{depth}:{deadline}:{lifespan}:{life}"


def parse_qos(text: str) -> QoSProfile:
    """Return the QoS profile of a text; numbers of others, such as that of "best available", are the default.

    Raises:
        ValueError: The text is not a QoS profile.
    """
    reliability, durability, kept, deadline, lifespan, life = text.split(":")
    history, depth = kept.split(",")
    liveliness, lease = life.split(",", 1)
    return QoSProfile(
        reliability=Reliability.BEST_EFFORT if reliability == "2" else Reliability.RELIABLE,
        durability=Durability.TRANSIENT_LOCAL if durability == "1" else Durability.VOLATILE,
        history=History.KEEP_ALL if history == "2" else History.KEEP_LAST,
        depth=int(depth or _DEFAULT_DEPTH),
        deadline_ns=_ns(deadline),
        lifespan_ns=_ns(lifespan),
        liveliness=Liveliness.MANUAL_BY_TOPIC if liveliness == "3" else Liveliness.AUTOMATIC,
        lease_ns=_ns(lease),
    )


def _ns(text: str) -> int | None:
    seconds, rest_ns = text.split(",")
    return int(seconds or 0) * NS_PER_S + int(rest_ns or 0) or None


def wire_type(name: str) -> tuple[str, str]:
    """Return the DDS type and the hash in a key by a ROS type; requests and responses have those of their service."""
    service, _, half = name.rpartition("_")
    is_half = half in ("Request", "Response") and "/msg/" not in name
    name = service if is_half else name
    try:
        hash_ = service_hash(name) if is_half else type_hash(name)
    except UnknownTypeError:
        hash_ = NO_HASH
    return announced_type_name(name), hash_


def data_key(domain_id: int, name: str, type_: tuple[str, str]) -> str:
    """Return the key of a topic's samples, or of a service's calls, by its ROS name; see `wire_type`."""
    return "/".join((str(domain_id), name.strip("/"), *type_))


def mangled(name: str) -> str:
    """Return a name as one part of a token."""
    return name.replace("/", "%")


def token_text(  # noqa: PLR0913 - the parts of a token
    domain_id: int, session: str, number: int, kind: str, node: str, *, data: bytes = b""
) -> str:
    """Return the token of a node, or the beginning of an endpoint's token; its node has the number 0.

    Zenoh has no USER_DATA; it takes the place of the enclave, which rmw_zenoh_cpp only shows.
    """
    namespace, _, name = node.rpartition("/")
    enclave = quote(data, safe="=;") or "%"
    parts = (TOKENS, domain_id, session, 0, number, kind, enclave, mangled(namespace or "/"), name)
    return "/".join(map(str, parts))


def token_kind(dds_topic: str, kind: EndpointKind) -> str:
    """Return the kind of the token that announces an endpoint."""
    return _TOKEN_KINDS[dds_topic[:2], kind]


def node_info(token: str) -> NodeInfo:
    """Return the node of a token."""
    parts = token.split("/")
    namespace = parts[7].replace("%", "/")
    return NodeInfo(namespace=namespace, name=parts[8], participant=participant_guid(parts[2]))


def endpoint_infos(token: str) -> tuple[EndpointInfo, ...]:
    """Return the endpoints that a token announces: two for a server or client, none for a node.

    A type that has another definition here is named with its hash.

    Raises:
        ValueError: The text is not a token.
    """
    _, _, session, _, _, kind, enclave, _, _, *rest = token.split("/")
    if kind == NODE:
        return ()
    name, dds_type, hash_, qos = rest
    # The enclaves of others begin with a slash, our USER_DATA with a key.
    data = b"" if enclave.startswith("%") else unquote_to_bytes(enclave)
    try:
        type_ = ros_type_name(dds_type)
    except TypeNameError:
        type_ = dds_type
    infos = []
    for start, end in (key for key, found in _TOKEN_KINDS.items() if found == kind):
        topic_tail, type_tail = _TAILS[start]
        topic = start + name.replace("%", "/") + topic_tail
        is_ours = wire_type(type_ + type_tail)[1] in (hash_, NO_HASH)
        info = EndpointInfo(
            kind=end,
            topic=ros_topic(topic),
            type=type_ + type_tail + ("" if is_ours else f" ({hash_})"),
            gid=end_gid(gid_of(token), topic),
            qos=parse_qos(qos),
            participant=participant_guid(session),
            node=node_info(token).full_name,
            dds_topic=topic,
            user_data=data,
        )
        infos.append(info)
    return tuple(infos)
