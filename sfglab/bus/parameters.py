"""Parameters of a node for `ros2 param list`, `get` and `describe`, over services of rcl_interfaces.

A component receives its configuration when it starts. Requests to set a parameter are refused for that reason.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.fields import to_json
from sfglab.messages import default_message, service_type

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from sfglab.bus.api import ParameterTransport
    from sfglab.bus.node import Node

READ_ONLY = "it is given when the component starts"
_SERVICES = (
    "describe_parameters",
    "get_parameters",
    "list_parameters",
    "set_parameters",
    "get_parameter_types",
    "set_parameters_atomically",
)
# For each type: field of ParameterValue, and ParameterType of one value and of an array (rcl_interfaces/msg).
_KINDS: dict[type, tuple[str, int, int]] = {
    bool: ("bool", 1, 6),
    int: ("integer", 2, 7),
    float: ("double", 3, 8),
    str: ("string", 4, 9),
}


def flat(value: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the parameters of a JSON value; parts of names are joined by dots, and None values are left out."""
    if _is_mixed(value):
        value = dict(enumerate(value))
    if isinstance(value, dict):
        for key, part in value.items():
            yield from flat(part, f"{name}.{key}" if name else str(key))
    elif value is not None:
        yield name, value


def _is_mixed(value: Any) -> bool:
    """Return whether a value is a list that is no array of one ROS 2 parameter type."""
    if not isinstance(value, list):
        return False
    kinds = {type(one) for one in value}
    return len(kinds) != 1 or not kinds <= _KINDS.keys()


def parameter_value(value: Any) -> Any:
    """Return a value, or a list of one type, as a ParameterValue; None gives a value that is not set."""
    if value is None:
        return _made("ParameterValue")
    many = isinstance(value, list)
    kind, one, array = _KINDS[type(value[0]) if many else type(value)]
    if many and kind != "string":
        value = np.array(value)
    fields = {"type": array if many else one, f"{kind}_{'array_' if many else ''}value": value}
    return _made("ParameterValue", **fields)


class Parameters:
    """Read-only parameters of a started node: the fields of a dataclass, with nested names joined by dots.

    Args:
        node: The node, which gets the services.
        config: Dataclass with the values.
        transport: Transport of the services, as in `Node.create_service`.
    """

    def __init__(self, node: Node, config: Any, transport: ParameterTransport = "dds") -> None:
        self._values: Mapping[str, Any] = dict(flat(to_json(config)))
        for service in _SERVICES:
            self._serve(node, service, transport)

    def _serve(self, node: Node, service: str, transport: ParameterTransport) -> None:
        type_ = service_type(f"rcl_interfaces/srv/{service.title().replace('_', '')}")
        answer = getattr(self, f"_{service}")

        def handle(request: Any) -> Any:
            return type_.response(**answer(request))

        node.create_service(type_.name, f"~/{service}", handle, transport=transport)

    def _values_of(self, request: Any) -> list[Any]:
        return [parameter_value(self._values.get(name)) for name in request.names]

    def _get_parameters(self, request: Any) -> dict[str, Any]:
        return {"values": self._values_of(request)}

    def _get_parameter_types(self, request: Any) -> dict[str, Any]:
        types = [value.type for value in self._values_of(request)]
        return {"types": np.array(types, np.uint8)}

    def _describe_parameters(self, request: Any) -> dict[str, Any]:
        descriptors = [
            _made("ParameterDescriptor", name=name, type=value.type, read_only=True)
            for name, value in zip(request.names, self._values_of(request), strict=True)
        ]
        return {"descriptors": descriptors}

    def _list_parameters(self, request: Any) -> dict[str, Any]:
        prefixes = request.prefixes or [""]
        names = [
            n
            for n in self._values
            if any(_is_below(n, prefix, request.depth) for prefix in prefixes)
        ]
        parents = sorted({name.rpartition(".")[0] for name in names} - {""})
        return {"result": _made("ListParametersResult", names=names, prefixes=parents)}

    def _set_parameters(self, request: Any) -> dict[str, Any]:
        return {"results": [_refusal() for _ in request.parameters]}

    def _set_parameters_atomically(self, _: Any) -> dict[str, Any]:
        return {"result": _refusal()}


def _is_below(name: str, prefix: str, depth: int) -> bool:
    """Return whether a parameter belongs to a prefix, at most `depth` parts below it; 0 for any number."""
    rest = name.removeprefix(f"{prefix}.") if prefix else name
    return (not prefix or name == prefix or rest != name) and (not depth or rest.count(".") < depth)


def _refusal() -> Any:
    return _made("SetParametersResult", successful=False, reason=READ_ONLY)


def _made(type_: str, /, **fields: Any) -> Any:
    return default_message(f"rcl_interfaces/msg/{type_}", **fields)
