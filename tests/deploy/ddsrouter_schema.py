"""The schema of a DDS Router's configuration v5.0, written down a second time to compare our checker with.

Facts from eProsima DDS-Router, resources/configurations/ddsrouter_config_schema.json at commit 7958efa5.
"""

from __future__ import annotations

NEVER = {"not": {}}
STRING, BOOLEAN = {"type": "string"}, {"type": "boolean"}
DOMAIN = {"type": "integer", "minimum": 0, "maximum": 232}
PORT = {"type": "integer", "minimum": 0, "maximum": 65535}


def closed(properties, required=(), **more):
    return {
        "type": "object",
        "additionalProperties": False,
        "properties": properties,
        "required": list(required),
        **more,
    }


def array(items, least=0):
    return {"type": "array", "items": items, "minItems": least}


def enum(*values):
    return {"type": "string", "enum": list(values)}


def any_letters(*words):
    cases = "|".join("".join(f"[{c.upper()}{c}]" for c in word) for word in words)
    return {"type": "string", "pattern": f"^({cases})$"}


QOS = closed(
    {
        "durability": BOOLEAN,
        "reliability": BOOLEAN,
        "ownership": BOOLEAN,
        "partitions": BOOLEAN,
        "keyed": BOOLEAN,
        "history-depth": {"type": "integer", "minimum": 0},
        "max-tx-rate": {"type": "number", "minimum": 0},
        "max-rx-rate": {"type": "number", "minimum": 0},
        "downsampling": {"type": "integer", "minimum": 1},
        "endpoint-profile-name": STRING,
    }
)
PRODUCER = closed(
    {
        "enable": BOOLEAN,
        "domain": DOMAIN,
        "period": {"type": "number", "exclusiveMinimum": 0},
        "topic-name": STRING,
    },
    ["enable"],
)
SPECS = closed(
    {
        "threads": {"type": "integer", "minimum": 0},
        "remove-unused-entities": BOOLEAN,
        "qos": QOS,
        "discovery-trigger": any_letters("reader", "writer", "any", "none"),
        "logging": closed(
            {
                "publish": closed({"enable": BOOLEAN, "domain": DOMAIN, "topic-name": STRING}, ["enable"]),
                "stdout": BOOLEAN,
                "verbosity": enum("info", "warning", "error"),
                "filter": closed({"info": STRING, "warning": STRING, "error": STRING}),
            }
        ),
        "monitor": closed({"domain": DOMAIN, "status": PRODUCER, "topics": PRODUCER}),
    }
)
FILTER = closed({"name": STRING, "type": STRING, "qos": QOS, "filter": STRING}, ["name"])
ROUTE = closed({"src": STRING, "dst": array(STRING)}, ["src"])
TLS = closed(
    {
        "ca": STRING,
        "password": STRING,
        "private_key": STRING,
        "cert": STRING,
        "dh_params": STRING,
        "peer_verification": BOOLEAN,
        "sni_host": STRING,
    },
    ["ca"],
    dependencies={
        "password": ["private_key", "cert"],
        "cert": ["password", "private_key"],
        "private_key": ["password", "cert"],
    },
)
ADDRESS = closed(
    {
        "ip": STRING,
        "domain": STRING,
        "port": PORT,
        "external-port": PORT,
        "transport": enum("tcp", "udp"),
        "ip-version": enum("v4", "v6"),
    },
    ["port"],
    anyOf=[{"required": ["domain"]}, {"required": ["ip"]}],
)
PARTICIPANT = {
    "name": STRING,
    "kind": STRING,
    "domain": DOMAIN,
    "repeater": BOOLEAN,
    "discovery-server-guid": closed(
        {"guid": STRING, "id": {"type": "integer", "minimum": 0}, "ros-discovery-server": BOOLEAN},
        anyOf=[{"required": ["guid"]}, {"required": ["id"]}],
    ),
    "listening-addresses": array(ADDRESS, 1),
    "connection-addresses": array(ADDRESS, 1),
    "tls": TLS,
    "discovery": BOOLEAN,
    "data": BOOLEAN,
    "verbose": BOOLEAN,
    "whitelist-interfaces": array(STRING),
    "ros2-easy-mode": STRING,
    "transport": enum("builtin", "udp", "shm"),
    "ignore-participant-flags": enum(
        "no_filter",
        "filter_different_host",
        "filter_different_process",
        "filter_same_process",
        "filter_different_and_same_process",
    ),
    "qos": QOS,
    "profile": STRING,
}
NET = ["whitelist-interfaces", "ros2-easy-mode", "transport", "ignore-participant-flags", "qos"]
ECHO = ["discovery", "data", "verbose"]
PEERS = ["listening-addresses", "connection-addresses", "tls"]
FORBIDDEN = {
    ("echo",): ["domain", "discovery-server-guid", *PEERS, "repeater", *NET, "profile"],
    ("local", "simple"): ["discovery-server-guid", *PEERS, "repeater", *ECHO, "profile"],
    ("discovery-server", "ds", "local-ds", "local-discovery-server", "wan-ds", "wan-discovery-server"): [
        "domain",
        "repeater",
        *ECHO,
        "profile",
    ],
    ("wan", "router", "initial-peers"): ["discovery-server-guid", *ECHO, "profile"],
    ("xml", "XML"): ["domain", "discovery-server-guid", *PEERS, *ECHO, *NET],
}


def participant_of(kinds, forbidden):
    properties = {**PARTICIPANT, **dict.fromkeys(forbidden, NEVER), "kind": enum(*kinds)}
    shape = closed(properties, ["name", "kind"])
    if "wan" in kinds or "ds" in kinds:
        shape["anyOf"] = [{"required": ["listening-addresses"]}, {"required": ["connection-addresses"]}]
    if "xml" in kinds:
        shape["required"].append("profile")
    return shape


SCHEMA = closed(
    {
        "version": enum("v1.0", "v2.0", "v3.0", "v3.1", "v4.0", "v5.0"),
        "specs": SPECS,
        "allowlist": array(FILTER),
        "blocklist": array(FILTER),
        "builtin-topics": array(closed({"name": STRING, "type": STRING}, ["name", "type"])),
        "routes": array(ROUTE),
        "topic-routes": array(
            closed({"name": STRING, "type": STRING, "routes": array(ROUTE)}, ["name", "type"])
        ),
        "topics": array(
            closed(
                {"name": STRING, "type": STRING, "qos": QOS, "filter": STRING, "participants": array(STRING)},
                ["name"],
            )
        ),
        "participants": array({"anyOf": [participant_of(k, f) for k, f in FORBIDDEN.items()]}, 1),
        "xml": closed(
            {"raw": STRING, "files": array(STRING, 1)}, anyOf=[{"required": ["raw"]}, {"required": ["files"]}]
        ),
    },
    ["participants"],
)
