"""Layout of ROS 2 on Zenoh, as rmw_zenoh_cpp has it from Jazzy 0.2.4 on: keys, tokens, attachments and GIDs.

Sources are `liveliness_utils.cpp`, `qos.cpp` and `attachment_helpers.cpp` of rmw_zenoh_cpp, and REP 2016 for
type hashes. The module is pure; it does not load Zenoh.
"""

from __future__ import annotations

import struct
from functools import cache
from typing import TYPE_CHECKING, Any
from urllib.parse import quote, unquote_to_bytes

from sfglab.bus.api import (
    HOST_KEY,
    SHM_KEY,
    EndpointInfo,
    EndpointKind,
    NodeInfo,
    entries,
    ros_topic,
    user_data,
)
from sfglab.messages import (
    TypeNameError,
    UnknownTypeError,
    dds_type_name,
    ros_type_name,
    service_hash,
    type_hash,
)
from sfglab.qos import Durability, History, Liveliness, QoSProfile, Reliability
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from enum import Enum

#: First part of every token; Zenoh's wildcards do not match parts that begin with "@".
TOKENS = "@ros2_lv"
NODE, PUBLISHER, SUBSCRIPTION, SERVER, CLIENT = "NN", "MP", "MS", "SS", "SC"
#: Part of a key in place of the hash of an unknown type; ROS 2 Humble always writes it.
NO_HASH = "TypeHashNotSupported"
#: Key of USER_DATA, as ROS 2 writes it in DDS: here of endpoints whose type has another definition than ours.
HASH_KEY = "typehash"
#: Attachment of a sample, request or reply, in the serialization of zenoh-ext: sequence number from 1, source
#: time (ns), size of the GID, GID of the publisher or client. A reply repeats the request's number and GID.
ATTACHMENT = struct.Struct("<qqB16s")
GID_BYTES = 16

# Numbers of rmw/types.h. Texts leave out rmw_zenoh_cpp's defaults.
_NUMBERS: dict[Enum, str] = {
    Reliability.RELIABLE: "",
    Reliability.BEST_EFFORT: "2",
    Durability.VOLATILE: "",
    Durability.TRANSIENT_LOCAL: "1",
    History.KEEP_LAST: "",
    History.KEEP_ALL: "2",
    Liveliness.AUTOMATIC: "",
    Liveliness.MANUAL_BY_TOPIC: "3",
}
_DEFAULT_DEPTH = 42
# DDS topic, type and kind of the endpoints that a token announces, by its kind.
_ENDS = {
    NODE: (),
    PUBLISHER: (("rt{}", "{}", EndpointKind.PUBLISHER),),
    SUBSCRIPTION: (("rt{}", "{}", EndpointKind.SUBSCRIPTION),),
    SERVER: (
        ("rq{}Request", "{}_Request", EndpointKind.SUBSCRIPTION),
        ("rr{}Reply", "{}_Response", EndpointKind.PUBLISHER),
    ),
    CLIENT: (
        ("rq{}Request", "{}_Request", EndpointKind.PUBLISHER),
        ("rr{}Reply", "{}_Response", EndpointKind.SUBSCRIPTION),
    ),
}


def gid_of(token: str) -> bytes:
    """Return the 16-byte GID of a token: the XXH3-128 of its text, the low 64 bits first, little endian."""
    import xxhash

    number: int = xxhash.xxh3_128_intdigest(token.encode())
    return number.to_bytes(GID_BYTES, "little")


def end_gid(gid: bytes, dds_topic: str) -> bytes:
    """Return the GID of an endpoint by its token's GID and its topic.

    The token of a server or client has one GID for two endpoints. That of the reply endpoint differs in the last
    byte, so that both have the same prefix.
    """
    return gid[:-1] + bytes([gid[-1] ^ 1]) if dds_topic.startswith("rr/") else gid


def participant_guid(session: str) -> bytes:
    """Return the 16-byte GUID of a participant, which is a Zenoh session, by the session's id."""
    return bytes.fromhex(session.zfill(2 * GID_BYTES))


def qos_text(qos: QoSProfile) -> str:
    """Return the text of a QoS profile in a token."""
    is_default = qos.history is History.KEEP_ALL or qos.depth == _DEFAULT_DEPTH
    depth = "" if is_default else qos.depth
    times = (qos.deadline_ns, qos.lifespan_ns, qos.lease_ns)
    deadline, lifespan, lease = (
        "," if t is None else "{},{}".format(*divmod(t, NS_PER_S)) for t in times
    )
    kinds = (qos.reliability, qos.durability, qos.history, qos.liveliness)
    reliability, durability, history, liveliness = (_NUMBERS[kind] for kind in kinds)
    return (
        f"{reliability}:{durability}:{history},{depth}:{deadline}:{lifespan}:{liveliness},{lease}"
    )


def parse_qos(text: str) -> QoSProfile:
    """Return the QoS profile of a text.

    Raises:
        ValueError: The text is not a QoS profile.
    """
    reliability, durability, kept, deadline, lifespan, life = text.split(":")
    history, depth = kept.split(",")
    liveliness, lease = life.split(",", 1)
    return QoSProfile(
        reliability=_kind(Reliability, reliability),
        durability=_kind(Durability, durability),
        history=_kind(History, history),
        depth=int(depth or _DEFAULT_DEPTH),
        deadline_ns=_ns(deadline),
        lifespan_ns=_ns(lifespan),
        liveliness=_kind(Liveliness, liveliness),
        lease_ns=_ns(lease),
    )


def _kind(kinds: type[Enum], number: str) -> Any:
    """Return the value with a number; others, such as that of "best available", give the default."""
    numbers = {_NUMBERS[kind]: kind for kind in kinds}
    return numbers.get(number, numbers[""])


def _ns(text: str) -> int | None:
    seconds, rest_ns = text.split(",")
    return int(seconds or 0) * NS_PER_S + int(rest_ns or 0) or None


def wire_type(name: str) -> tuple[str, str]:
    """Return the DDS type and the hash in a key by a ROS type; requests and responses have those of their service."""
    service, _, half = name.rpartition("_")
    is_half = half in ("Request", "Response") and "/msg/" not in name
    name = service if is_half else name
    try:
        return dds_type_name(name), _hash(name, is_service=is_half)
    except UnknownTypeError:
        return dds_type_name(name), NO_HASH
    except TypeNameError:
        return name, NO_HASH


@cache
def _hash(name: str, *, is_service: bool) -> str:
    """Return the hash of a known type; types may become known later, so that their lack is not cached."""
    return service_hash(name) if is_service else type_hash(name)


def data_key(domain_id: int, name: str, type_: tuple[str, str]) -> str:
    """Return the key of a topic's samples, or of a service's calls, by its ROS name; see `wire_type`."""
    return "/".join((str(domain_id), name.strip("/"), *type_))


def mangled(name: str) -> str:
    """Return a name as one part of a token."""
    return name.replace("/", "%")


def token_text(  # noqa: PLR0913 - the parts of a token
    domain_id: int, session: str, number: int, kind: str, node: str, *, enclave: str = "%"
) -> str:
    """Return the token of a node, or the beginning of an endpoint's token; its node has the number 0."""
    namespace, _, name = node.rpartition("/")
    parts = (TOKENS, domain_id, session, 0, number, kind, enclave, mangled(namespace or "/"), name)
    return "/".join(map(str, parts))


def enclave_text(host: str, data: bytes) -> str:
    """Return the enclave of our endpoints: host id and USER_DATA, which Zenoh does not have.

    rmw_zenoh_cpp only shows enclaves.
    """
    return quote(user_data({HOST_KEY: host}) + data, safe="=;")


def token_kind(dds_topic: str, kind: EndpointKind) -> str:
    """Return the kind of the token that announces an endpoint."""
    wanted = dds_topic[:2], kind
    found = (
        token for token, ends in _ENDS.items() if wanted in [(end[0][:2], end[2]) for end in ends]
    )
    return next(found)


def node_info(token: str) -> NodeInfo:
    """Return the node of a token."""
    parts = token.split("/")
    namespace = parts[7].replace("%", "/")
    return NodeInfo(namespace=namespace, name=parts[8], participant=participant_guid(parts[2]))


def endpoint_infos(token: str) -> tuple[EndpointInfo, ...]:
    """Return the endpoints that a token announces: two for a server or client, none for a node.

    Raises:
        ValueError: The text is not a token.
    """
    _, _, session, _, _, kind, enclave, _, _, *rest = token.split("/")
    if kind == NODE:
        return ()
    if kind not in _ENDS:
        raise ValueError(f"token: given the kind {kind!r}, allowed: {', '.join(_ENDS)}")
    name, dds_type, hash_, qos = rest
    host, data = "", b""
    if enclave.startswith(f"{HOST_KEY}="):
        first, _, data = unquote_to_bytes(enclave).partition(b";")
        host = first.decode(errors="replace").partition("=")[2]
    try:
        type_ = ros_type_name(dds_type)
    except TypeNameError:
        type_ = dds_type
    infos = []
    for topic_form, type_form, end in _ENDS[kind]:
        topic = topic_form.format(name.replace("%", "/"))
        end_type = type_form.format(type_)
        is_ours = wire_type(end_type)[1] in (hash_, NO_HASH)
        info = EndpointInfo(
            kind=end,
            topic=ros_topic(topic),
            type=end_type,
            gid=end_gid(gid_of(token), topic),
            qos=parse_qos(qos),
            transport="shm" if SHM_KEY in entries(data) else "dds",
            participant=participant_guid(session),
            host=host,
            node=node_info(token).full_name,
            dds_topic=topic,
            user_data=data if is_ours else data + user_data({HASH_KEY: hash_}),
        )
        infos.append(info)
    return tuple(infos)
