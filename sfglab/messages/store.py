"""The store of message types: those of the ROS 2 distribution in ROS_DISTRO, of sfglab, and of the user.

The types are those of ROS 2 Humble where no later distribution is given. The module depends neither on
serialisation (`cdr`) nor on middleware (`dds`).
"""

from __future__ import annotations

import difflib
import functools
import logging
import os
import re
import threading
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.errors import SfglabError
from sfglab.messages.field_types import FieldType, field_type
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from rosbags.interfaces.typing import Typesdict
    from rosbags.typesys.store import Typestore

#: Environment variable with paths for `register_interfaces`; child processes inherit it.
INTERFACES_VARIABLE = "SFGLAB_INTERFACES"
_log = logging.getLogger("sfglab.messages")
RULE = "=" * 80
# Limits of a definition, which bound the work of its readers: ROS 2's own have at most 119 values and 5,000
# characters.
_MOST_VALUES = 4096
_MOST_LINES = 1500
_MOST_CHARACTERS = 2**18
_FOLDER = re.compile("/(?:srv|action)/")
_KINDS = ("msg", "srv", "action")
_PARTS = {"srv": ("Request", "Response"), "action": ("Goal", "Result", "Feedback")}
_RULE_OF_PARTS = re.compile(r"^---[ \t]*$", re.MULTILINE)
_GOAL_ID = "unique_identifier_msgs/UUID goal_id\n"
_ACTION_WRAPPERS = {
    "SendGoal_Request": _GOAL_ID + "{name}_Goal goal\n",
    "SendGoal_Response": "bool accepted\nbuiltin_interfaces/Time stamp\n",
    "GetResult_Request": _GOAL_ID,
    "GetResult_Response": "int8 status\n{name}_Result result\n",
    "FeedbackMessage": _GOAL_ID + "{name}_Feedback feedback\n",
}
_sources: dict[str, str] = {}
_lock = threading.RLock()
_to_register = list(filter(None, os.environ.get(INTERFACES_VARIABLE, "").split(os.pathsep)))


class MessageError(SfglabError, ValueError):
    """A definition, a value or bytes from which no message can be made."""


class UnknownTypeError(SfglabError, LookupError):
    """A type that is not in the store of message types."""

    def __init__(self, name: object, known: Iterable[str] = ()) -> None:
        """Name the unknown type, and those of the known ones that are similar."""
        self.name = name  #: Unknown name.
        #: Names of similar types, the most similar first.
        self.near = difflib.get_close_matches(str(name), known, n=3, cutoff=0.7)
        own = (
            "give a name such as std_msgs/msg/String, or register types of your own (--interfaces)"
        )
        hint = f"did you mean {', '.join(self.near)}?" if self.near else own
        super().__init__(f"message type {name!r} is unknown; {hint}")


@dataclass(frozen=True, slots=True, kw_only=True)
class ServiceType:
    """A service as a pair of message types."""

    #: Name of a service, such as `std_srvs/srv/Empty`, or of an action's service, such as
    #: `pkg/action/Name_SendGoal`.
    name: str
    request: type[Any]  #: Type of requests; a dataclass with `__msgtype__`.
    response: type[Any]  #: Type of responses; a dataclass with `__msgtype__`.


def parse_definition(name: str, text: str) -> Typesdict:
    """Return the types in a `.msg` text with its dependencies by their full names, the named one first.

    Further types follow after a line of 80 equal signs and `MSG: pkg/Type`. Fields are in the form of
    rosbags.

    Raises:
        MessageError: The text cannot be read, or exceeds the size of a definition.
    """
    from rosbags.typesys import TypesysError, get_types_from_msg

    text = text.replace("\r\n", "\n")
    lines = sum(not line.lstrip().startswith("#") for line in text.splitlines() if line.strip())
    if lines > _MOST_LINES or len(text) > _MOST_CHARACTERS:
        allowed = f"allowed: up to {_MOST_LINES} lines and {_MOST_CHARACTERS} characters"
        raise MessageError(
            f"{name}: given {lines} lines of definition, {len(text)} characters, {allowed}"
        )
    # rosbags files every type under /msg/, where it looks for short names. It requires a line break at the
    # end.
    filed = _FOLDER.sub("/msg/", name)
    try:
        (_, first), *rest = get_types_from_msg(text.rstrip() + "\n", filed).items()
    # Beside its own error, rosbags passes on the errors that unexpected names and numbers raise.
    except (TypesysError, SyntaxError, ValueError, LookupError, TypeError, AssertionError) as error:
        raise MessageError(f"{name}: its definition cannot be read: {error}") from error
    return {name: first, **dict(rest)}


def interface_texts(name: str, text: str) -> dict[str, str]:
    """Return the message texts in an interface by their full names.

    An action has its three parts, and the wrappers of ROS 2's design (design.ros2.org, "Actions").

    Raises:
        MessageError: A service's text does not have two parts, or an action's text not three.
    """
    kind = name.split("/")[1]
    if kind == "msg":
        return {name: text}
    kinds = _PARTS[kind]
    parts = _RULE_OF_PARTS.split(text)
    if len(parts) != len(kinds):
        allowed = f"allowed: {len(kinds)}, separated by lines of `---`"
        raise MessageError(f"{name}: given {len(parts)} part(s), {allowed}")
    texts = {}
    for part_name, part in zip(kinds, parts, strict=True):
        texts[f"{name}_{part_name}"] = part.strip("\n")
    for part_name, wrapper in _ACTION_WRAPPERS.items() if kind == "action" else ():
        texts[f"{name}_{part_name}"] = wrapper.format(name=name)
    return texts


def _texts_below(path: Path) -> dict[Path, dict[str, str]]:
    """Return the message texts of each `.msg`, `.srv` and `.action` file in packages, or of one file."""
    found = [path] if path.is_file() else path.rglob("*")
    texts = {}
    for file in sorted(found):
        kind = file.suffix[1:]
        if kind in _KINDS and file.parent.name == kind:
            texts[file] = interface_texts(_name_of(file), file.read_text("utf-8"))
    return texts


def _types_of() -> str:
    """Return the distribution of ROS 2 whose types are used: that in ROS_DISTRO if it is later than Humble."""
    named = os.environ.get("ROS_DISTRO", "")
    return named if named in {"iron", "jazzy", "kilted", "lyrical"} else "humble"


@functools.cache
def _built_store() -> Typestore:
    from rosbags.serde import cdr, primitives
    from rosbags.typesys import Stores, get_typestore
    from rosbags.typesys.store import TIDMAP

    TIDMAP["char"] = TIDMAP["uint8"]  # as rosidl hashes it
    # An octet has no sign (IDL 4.2, clause 7.4.1.4.4.2.6), but rosbags gives `byte` a sign and refuses 128
    # and more.
    for packing in ("pack", "unpack"):
        for order in ("le", "be"):
            setattr(
                primitives,
                f"{packing}_byte_{order}",
                getattr(primitives, f"{packing}_char_{order}"),
            )
    # rclpy replaces bytes that are not UTF-8 by U+FFFD, and accepts an empty string without its terminating
    # zero. rosbags refuses such messages.
    compile_lines = cdr.compile_lines  # type: ignore[attr-defined]
    cdr.compile_lines = lambda lines: compile_lines([_tolerant(line) for line in lines])  # type: ignore[attr-defined]
    store = get_typestore(Stores(f"ros2_{_types_of()}"))
    parsed: Typesdict = {}
    for texts in _texts_below(Path(__file__).with_name("interfaces")).values():
        _sources.update(texts)
        for name, text in texts.items():
            parsed |= parse_definition(name, text)
    store.register(parsed)
    return store


def _tolerant(line: str) -> str:
    """Return a line of rosbags' string reader, changed so that it reads strings as rclpy does."""
    line = line.replace("check_string(", "length and check_string(")
    return line.replace(").decode()", ').decode(errors="replace")')


def type_store() -> Typestore:
    """Return the store in the form of rosbags; it is built on first use, once per process."""
    with _lock:
        paths = tuple(_to_register)
        _to_register.clear()  # before the loop, because registering calls this function
        for path in paths:
            register_interfaces(Path(path))
        return _built_store()


def register(name: str, text: str) -> type[Any]:
    """Add the type `pkg/msg/Type` of a `.msg` text without dependencies to the store, or return it.

    Raises:
        MessageError: The text cannot be read, or the name belongs to a type with other fields.
    """
    register_texts({name: text})
    return type_store().types[name]


def register_interfaces(path: Path) -> tuple[str, ...]:
    """Add the types of ROS 2 packages, or of one of their files, to the store; return their names, sorted.

        register_interfaces(Path("/opt/ros/jazzy/share/example_interfaces"))

    Args:
        path: A package's folder with `msg`, `srv` and `action` folders, in a source tree or below `share`; a
            folder of such packages; or one `.msg`, `.srv` or `.action` file in such a folder. Types on which
            they depend must be among them or in the store; otherwise register those first.
            Types with `wstring`, which sfglab does not support, are left out of a folder, with a warning.

    Raises:
        MessageError: There is no such file; a definition cannot be read, uses an unknown type, or belongs to
            a type with other fields; the only file has `wstring`. Nothing was added in these cases.
    """
    parts = _texts_below(path)
    if not parts:
        raise MessageError(
            f"{path}: no .msg, .srv or .action file is there; give such a file or the folder of a package"
        )
    if path.is_dir():
        _leave_out_wstring(parts)
    texts = {name: text for part in parts.values() for name, text in part.items()}
    register_texts(texts)
    return tuple(sorted(texts))


def _name_of(file: Path) -> str:
    """Return the full name of the interface in a file; the package's manifest overrides the folder's name."""
    package = file.absolute().parents[1]
    manifest = package / "package.xml"
    name = package.name
    if manifest.is_file():
        said = re.search(r"<name>\s*(\w+)\s*</name>", manifest.read_text("utf-8"))
        name = said[1] if said else name
    return f"{name}/{file.suffix[1:]}/{file.stem}"


def _leave_out_wstring(parts: dict[Path, dict[str, str]]) -> None:
    """Take out the files with `wstring`, or with a type from such a file."""
    uses: dict[Path, set[str]] = {}
    for file, texts in parts.items():
        uses[file] = set()
        for name, text in texts.items():
            uses[file] |= {used for _, used in _used(parse_definition(name, text)[name])}
    left_out: set[str] = set()
    while wide := [file for file in parts if any(_is_wide(used, left_out) for used in uses[file])]:
        for file in wide:
            _log.warning("%s: given wstring, allowed: string; the type is left out", file)
            left_out |= parts.pop(file).keys()


def _is_wide(name: str, left_out: set[str]) -> bool:
    return name.endswith(_WSTRING) or name in left_out


def register_texts(texts: Mapping[str, str]) -> None:
    """Add the types of `.msg` texts without dependencies, by full name, to the store, and keep the texts.

    Raises:
        MessageError: A text cannot be read, or contradicts the store; nothing was added.
    """
    parsed = {name: parse_definition(name, text)[name] for name, text in texts.items()}
    with _lock:
        new = add_types(parsed)
        _sources.update({name: texts[name] for name in new})


def add_types(parsed: Typesdict) -> Typesdict:
    """Add types in rosbags' form to the store, all or none, and return those that are new.

    Types that exist already are kept.

    Raises:
        MessageError: A type contradicts the store or uses an unknown type; nothing was added.
    """
    with _lock:
        store = type_store()
        check_new(store, parsed)
        new = {name: fields for name, fields in parsed.items() if name not in store.fielddefs}
        store.register(new)
        return new


def is_known(name: str) -> bool:
    """Return whether the store holds a type."""
    return name in type_store().fielddefs


def is_known_as(name: str, text: str) -> bool:
    """Return whether a definition with its dependencies, as `definition` returns it, equals that of the store."""
    known = type_store().fielddefs
    try:
        return name in known and all(
            _agree(known.get(n), given) for n, given in parse_definition(name, text).items()
        )
    except MessageError:
        return False


def _agree(known: Any, given: Any) -> bool:
    return known == given or bool(known and not given[1] and known[1][0][0] == EMPTY)


def _fields(definition: Any) -> dict[str, FieldType]:
    """Return the types of the fields of a definition."""
    return {name: field_type(desc) for name, desc in definition[1]}


def _used(definition: Any) -> Iterator[tuple[str, str]]:
    """Yield each field of a definition that has a message type, with the type's name."""
    for name, type_ in _fields(definition).items():
        if type_.is_message:
            yield name, type_.base


def check_new(store: Typestore, parsed: Typesdict) -> None:
    """Refuse definitions that contradict the store or use unknown types.

    Raises:
        MessageError: A type has other fields in the store, uses an unknown type or `wstring`, has too many
            values, or contains itself.
    """
    for name, definition_ in parsed.items():
        if name in store.fielddefs and not _agree(store.fielddefs[name], definition_):
            raise MessageError(
                f"{name} is already registered with other fields; choose another name"
            )
        for field, inner in _used(definition_):
            if inner.endswith(_WSTRING):
                raise MessageError(f"{name}.{field}: given wstring, allowed: string")
            if inner not in parsed and inner not in store.fielddefs:
                raise MessageError(
                    f"{name}.{field}: there is no type {inner}; register its package first"
                )
    values: dict[str, int] = {}
    for name in parsed:
        _check_work(name, {**store.fielddefs, **parsed}, values)


def _check_work(name: str, known: Mapping[str, Any], values: dict[str, int]) -> int:
    """Return the least number of values of a type; an array of numbers is one. `values` has the known results.

    Raises:
        MessageError: There are more values than the generated readers allow, which have a line for each; or
            the type contains itself.
    """
    if name not in values:
        # Above the limit for now: a type that contains itself is then refused.
        values[name] = _MOST_VALUES + 1
        count = 1
        for field, type_ in _fields(known[name]).items():
            if type_.is_array and not type_.length:
                allowed = "allowed: 1 or more"
                raise MessageError(f"{name}.{field}: given an array of no elements, {allowed}")
            each = _check_work(type_.base, known, values) if type_.is_message else 1
            is_unrolled = type_.is_array and not type_.is_number
            count += each * (type_.length if is_unrolled else 1)
        if count > _MOST_VALUES:
            raise MessageError(
                f"{name}: given itself inside, or {count} values, allowed: up to {_MOST_VALUES} values"
            )
        values[name] = count
    return values[name]


def message_types() -> tuple[str, ...]:
    """Return the names of all types in the store, sorted; a service has a request type and a response type."""
    return tuple(sorted(type_store().types))


def message_type(name: str) -> type[Any]:
    """Return a message type by its full name, `package/msg/Name`; there is no short form.

    It is a dataclass of numbers, strings, NumPy arrays, messages or lists of these. Constants are
    attributes.

    Raises:
        UnknownTypeError: There is no such type; the message lists similar names.
    """
    types = type_store().types
    if name not in types:
        raise UnknownTypeError(name, types)
    return types[name]


def service_type(name: str) -> ServiceType:
    """Return the types of a service's request and response by its full name, `package/srv/Name`.

    Raises:
        UnknownTypeError: There is no such service; the message lists similar names.
    """
    types = type_store().types
    if f"{name}_Request" not in types:
        raise UnknownTypeError(name, names_before("_Request", "srv"))
    return ServiceType(
        name=name, request=types[f"{name}_Request"], response=types[f"{name}_Response"]
    )


def names_before(ending: str, kind: str) -> list[str]:
    """Return the names of all interfaces of a kind, from the names of their message types, sorted."""
    names = [name for name in type_store().types if f"/{kind}/" in name]
    return [name.removesuffix(ending) for name in names if name.endswith(ending)]


@functools.cache
def fields_of(name: str) -> dict[str, FieldType]:
    """Return the types of the fields of a message type, given its full name, by the field's name."""
    return _fields(type_store().fielddefs[name])


def type_name(type_or_name: type[Any] | str) -> str:
    """Return the full name of a message type, such as `std_msgs/msg/String`; a name is checked.

    Raises:
        UnknownTypeError: The argument is neither a message type nor the name of one.
    """
    if isinstance(type_or_name, str):
        return message_type(type_or_name).__msgtype__  # type: ignore[no-any-return]  # set by rosbags
    name = getattr(type_or_name, "__msgtype__", None)
    if not isinstance(name, str):
        raise UnknownTypeError(type_or_name)
    return name


def definition(type_or_name: type[Any] | str) -> str:
    """Return a type's definition with all dependencies, in the form of MCAP's `ros2msg` encoding and rosbag2.

    Each dependency follows after 80 equal signs and `MSG: package/Name`.

    Raises:
        UnknownTypeError: There is no such type.
    """
    name = type_name(type_or_name)
    message_type(name)
    dependencies: dict[str, str] = {}
    _add_dependencies(name, dependencies)
    parts = [_text_of(name)]
    for dependency, text in dependencies.items():
        parts.append(f"{RULE}\nMSG: {dependency.replace('/msg/', '/')}\n{text}")
    return "".join([part.rstrip("\n") + "\n" for part in parts])


@functools.cache
def type_hash(type_or_name: type[Any] | str) -> str:
    """Return a type's hash in the form that ROS 2 uses since Iron, such as `RIHS01_df668c...` (REP 2016).

    Raises:
        UnknownTypeError: There is no such type.
    """
    return type_store().hash_rihs01(type_name(type_or_name))


def _add_dependencies(name: str, texts: dict[str, str]) -> None:
    """Add the text of each type that a type uses, directly or through others, in order of first use."""
    for _, inner in _used(type_store().fielddefs[name]):
        if inner not in texts:
            texts[inner] = _text_of(inner)
            _add_dependencies(inner, texts)


def _text_of(name: str) -> str:
    """Return the original text of a type, with its comments, which rosbags does not keep."""
    if name in _sources:
        return _sources[name]
    text, _ = type_store().gendefhash(name, {}, ros_version=2)
    return text


# A field with a default in a .msg text; the line of a constant has an equal sign.
_DEFAULT = re.compile(
    r"""^[ \t]*[\w/]+(?:<=\d+)?(?:\[[^\]]*\])?[ \t]+(\w+)[ \t]+("[^"]*"|'[^']*'|\[.*?\]|[^\s#=]+)""",
    re.MULTILINE,
)


@functools.cache
def _defaults_of(name: str) -> dict[str, str]:
    """Return the default values in the definition of a type, as text by field."""
    if name == "geometry_msgs/msg/Quaternion":
        # rosbags omits the defaults of ROS 2's own types; only these two are not zero.
        return {"w": "1"}
    if name == "sensor_msgs/msg/NavSatStatus":
        status = getattr(type_store().types[name], "STATUS_UNKNOWN", 0)  # since Iron
        return {"status": str(status)}
    return {field[1]: field[2] for field in _DEFAULT.finditer(_sources.get(name, ""))}


def _default_value(type_: FieldType, text: str | None) -> Any:
    import yaml

    given = None if text is None else yaml.safe_load(text)
    count = type_.length if type_.is_array else 0
    if type_.is_message:
        values = [_default_of(type_.base) for _ in range(count if type_.is_list else 1)]
        return values if type_.is_list else values[0]
    if type_.is_list and type_.is_number:
        return np.array([0] * count if given is None else given, type_.dtype)
    if type_.is_list:
        return [""] * count if given is None else [str(one) for one in given]
    if type_.is_number:
        return type_.dtype.type(given or 0).item()
    return "" if given is None else str(given)


def _default_of(name: str) -> Any:
    defaults = _defaults_of(name)
    values = {}
    for field, type_ in fields_of(name).items():
        try:
            values[field] = _default_value(type_, defaults.get(field))
        except (ValueError, TypeError, OverflowError) as error:
            said = f"given the default {defaults.get(field)}: {error}"
            raise MessageError(f"{name}.{field}: {said}") from error
    return type_store().types[name](**values)


def default_message(type_or_name: type[Any] | str, **fields: Any) -> Any:
    """Return a new message with these fields; the others have the defaults of the definition.

    Where a definition gives none, numbers are zero, and strings and sequences are empty.

    Raises:
        UnknownTypeError: There is no such type.
        TypeError: The type has no such field.
    """
    name = type_name(type_or_name)
    message_type(name)
    return replace(_default_of(name), **fields)


EMPTY = "structure_needs_at_least_one_member"
"""Name of the octet that rosbags adds to a message without fields when it is registered (rosidl's rule)."""
_WSTRING = "/wstring"  #: Suffix of the type that rosbags reads in place of `wstring`.


def stamp_from_ns(stamp_ns: int) -> Any:
    """Return the `builtin_interfaces/msg/Time` of nanoseconds since the epoch; negative ones have negative seconds."""
    sec, nanosec = divmod(int(stamp_ns), NS_PER_S)
    return message_type("builtin_interfaces/msg/Time")(sec=sec, nanosec=nanosec)


def ns_from_stamp(stamp: Any) -> int:
    """Return the nanoseconds since the epoch of a stamp with `sec` and `nanosec`, without rounding."""
    return int(stamp.sec) * NS_PER_S + int(stamp.nanosec)
