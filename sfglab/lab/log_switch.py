"""Switch of a notebook's working copy: cells show the committed logs or the user's newest runs, or run now."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from sfglab.errors import MissingExtraError
from sfglab.lab.notebooks import NEWEST, REFERENCE
from sfglab.view.widgets import widgets

if TYPE_CHECKING:
    from collections.abc import MutableMapping

_ADVICE = "Then choose <b>Run > Run Selected Cell and All Below</b>."
_OWN = "The parameters cell names other logs."
# The values of the parameters cell at the last choice, and the choice.
_last: list[tuple[dict[str, str], str]] = []


def log_switch(namespace: MutableMapping[str, Any], expected_time: str) -> Any:
    """Return buttons that choose the logs of all experiments of a notebook.

    A run of all cells keeps the last choice, and a changed parameters cell replaces it. Without ipywidgets
    the result is a sentence that tells to edit the parameters cell.

    Args:
        namespace: Variables of the notebook.
        expected_time: Time that a run takes, e.g. "4 min".
    """
    given = {
        name: value
        for name, value in namespace.items()
        if name.partition("_")[0] == "log" and isinstance(value, str)
    }
    try:
        made = widgets()
    except MissingExtraError as error:
        return f"{error}. Without it, edit the parameters cell."
    if _last:
        parameters, choice = _last[-1]
        chosen = dict.fromkeys(parameters, choice)
        if given == parameters:
            namespace.update(chosen)
        elif given == chosen:  # the parameters cell did not run again
            given = parameters
    choices = {
        "reference": REFERENCE,
        "newest own run": NEWEST,
        f"run now ({expected_time})": "",
    }
    current = {namespace[name] for name in given}
    is_choice = len(current) == 1 and current <= {*choices.values()}
    buttons = made.ToggleButtons(
        options=[*choices.items()],
        value=current.pop() if is_choice else None,
        description="Show",
    )
    text = made.HTML("" if is_choice else _OWN)

    def choose(change: Any) -> None:
        namespace.update(dict.fromkeys(given, change["new"]))
        _last[:] = [(given, change["new"])]
        text.value = _ADVICE

    buttons.observe(choose, "value")
    return made.VBox([buttons, text])
