"""An agent as a whole: the nodes of paper A, sections 4.1 to 4.3, kept alive by one supervisor.

Bottom up: `supervision` (the table of a component's life), `plan` (which components an agent has), `process`
(a component's process), `events` and `narrator` (what programs and persons hear of it), `supervisor` (keeps
the components alive), `app` (the agent as a process).
"""

__all__: list[str] = []
