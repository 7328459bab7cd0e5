"""Commands for trajectories: the scene editor, a simulated agent, and sending agents along trajectories."""

from __future__ import annotations

import asyncio
import sys
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Option

from sfglab.cli.buses import on_node, until_interrupted
from sfglab.cli.options import Agents, Domain, Interface, SceneFile
from sfglab.component import on_stop
from sfglab.errors import InvalidValueError, SfglabError
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Sequence

    from sfglab.bus import Node
    from sfglab.spatial.execution.client import Execution
    from sfglab.spatial.execution.orders import Order
    from sfglab.spatial.execution.server import AgentSetup

app = typer.Typer(
    help="""Simulate an agent that follows trajectories, and send agents along them.

Examples:
  sfglab follow serve --agent go2 --domain 7
  sfglab follow run data/scenes/hall.yaml --agent go2 --domain 7"""
)


def plan(
    scene: SceneFile,
    port: Annotated[
        int, Option(min=0, max=65535, help="Port of the editor; 0 takes any free port.")
    ] = 8092,
    no_browser: Annotated[
        bool, Option("--no-browser", help="Print the address only, without opening a browser.")
    ] = False,
    new: Annotated[
        bool, Option("--new", help="Begin an empty scene; the first save creates the file.")
    ] = False,
    domain: Domain = 0,
    interface: Interface = None,
) -> None:
    """Edit the trajectories of several robots in a 3D scene, in the browser (paper A, section 4.5).

    All browsers that open the address edit the same scene. The panel of a trajectory sends it to
    an action server and cancels it. Ctrl-C ends without saving, and cancels trajectories on their way.

    Examples:
      sfglab plan data/scenes/hall.yaml
      sfglab plan warehouse.yaml --new
      sfglab plan data/scenes/course.yaml --port 0 --no-browser
      sfglab plan data/scenes/hall.yaml --domain 7 --interface lo
    """
    from sfglab.bus import Node
    from sfglab.spatial.scene.editor import Editor
    from sfglab.view.planner.server import Planner

    if new and scene.exists():
        raise InvalidValueError("--new", str(scene), "a file that does not exist yet")
    if not new and not scene.exists():
        raise InvalidValueError(
            "scene", str(scene), "an existing scene file, or --new to begin one"
        )
    if not scene.parent.is_dir():
        raise InvalidValueError("scene", str(scene), "a file in an existing folder")
    editor = Editor.open(scene)
    node = partial(Node, "planner", domain_id=domain, interface=interface)
    with Planner(editor, port=port, node=node) as planner, suppress(KeyboardInterrupt):
        typer.echo(f"{scene.name}: {planner.url}  (Ctrl-C ends)")
        if not no_browser:
            typer.launch(planner.url)
        planner.wait()
    if editor.dirty:
        typer.echo(f"{scene.name}: changes since the last save were not saved", err=True)


@app.command()
def serve(
    agent: Annotated[str, Option(help="Name of the agent.")],
    domain: Domain = 0,
    interface: Interface = None,
    scene: Annotated[
        Path | None,
        Option(
            help="Scene with the start and the limits of the agent. [default: at 0, without limits]"
        ),
    ] = None,
) -> None:
    """Simulate an agent that follows the trajectories of an action's goals, until Ctrl-C.

    It publishes /global/<agent>/pose, /global/<agent>/odometry and <agent>/base on /tf.

    Examples:
      sfglab follow serve --agent go2 --domain 7
      sfglab follow serve --agent go2 --scene data/scenes/hall.yaml --domain 7 --interface lo
    """
    from sfglab.names import validate_agent
    from sfglab.spatial.execution.server import TrajectoryServer

    setup = _setup(validate_agent(agent), scene)

    async def serve_agent(node: Node) -> None:
        async with TrajectoryServer(node, agent, setup=setup) as server:
            typer.echo(f"{agent}: {server.action_name} moves it; Ctrl-C ends")
            await asyncio.Event().wait()

    until_interrupted((domain, interface), serve_agent, agent)


def _setup(agent: str, scene: Path | None) -> AgentSetup:
    from sfglab.spatial.execution.server import AgentSetup
    from sfglab.spatial.scene.files import load_scene
    from sfglab.spatial.scene.model import AgentObject

    if scene is None:
        return AgentSetup()
    loaded = load_scene(scene)
    named = {found.name: found for found in loaded.all_of(AgentObject)}
    if agent not in named:
        raise InvalidValueError(
            f"--agent, {scene}", agent, ", ".join(named) or "none, because the scene has no agent"
        )
    return AgentSetup.of_scene(loaded, named[agent])


@app.command("run")
def run_scene(
    file: SceneFile,
    agent: Agents = None,
    domain: Domain = 0,
    interface: Interface = None,
    delay: Annotated[
        float,
        Option(
            min=0.0, help="Time until all start together, s; 0: each starts once it has its goal."
        ),
    ] = 1.0,
) -> None:
    """Send the trajectories of a scene to its agents and wait for their arrival; Ctrl-C stops them.

    Without --agent, these are all agents that have a trajectory. The clocks of their hosts must be
    synchronised, so that they start together. The exit status is 0 if all agents arrived, 1 if one
    did not, and 130 after Ctrl-C, when all agents have stopped.

    Examples:
      sfglab follow run data/scenes/hall.yaml --agent go2 --domain 7
      sfglab follow run data/scenes/hall.yaml --domain 7 --interface lo
    """
    from sfglab.spatial.execution.client import scene_orders
    from sfglab.spatial.scene.files import load_scene

    orders = scene_orders(load_scene(file), agents=tuple(agent or ()))
    if not orders:
        raise SfglabError(f"{file}: no agent has a trajectory; add one with sfglab plan")
    place = (domain, interface)
    raise typer.Exit(on_node(place, lambda node: _send_all(node, orders, delay), "planner"))


async def _send_all(node: Node, orders: Sequence[Order], delay_s: float) -> int:
    from sfglab.spatial.execution.client import Execution
    from sfglab.spatial.execution.orders import Outcome, goal_message

    executions: list[Execution] = []
    for order in orders:
        # Imports at first use must not take time once the start is set.
        goal_message(order)
        execution = _execution(node, order.agent, len(executions))
        executions.append(execution)
        await execution.ready()
    if delay_s:
        start_ns = node.get_clock().now_ns() + round(delay_s * NS_PER_S)
        orders = [replace(order, start_ns=start_ns) for order in orders]
    stopping: list[asyncio.Future[None]] = []

    def stop() -> None:
        stopping.extend(asyncio.ensure_future(execution.cancel()) for execution in executions)

    on_stop(stop)
    await asyncio.gather(*map(Execution.begin, executions, orders))
    ended = await asyncio.gather(*map(Execution.result, executions))
    await asyncio.gather(*stopping)
    outcomes = set()
    for order, end in zip(orders, ended, strict=True):
        place = ""
        if end.pose is not None:
            x, y, z = end.pose.position_m
            place = f" at ({x:.2f}, {y:.2f}, {z:.2f}) m"
        typer.echo(f"{order.agent}: {end}{place}")
        outcomes.add(end.outcome)
    return 130 if stopping else int(outcomes != {Outcome.SUCCEEDED})


def _execution(node: Node, agent: str, position: int) -> Execution:
    """Return a trajectory to send, with a progress bar."""
    from tqdm import tqdm

    from sfglab.spatial.execution.client import Execution

    # The delay keeps the bar away until the agent moves.
    bar = tqdm(total=100, desc=agent, position=position, unit="%", file=sys.stderr, delay=0.01)

    def show(feedback: Any) -> None:
        bar.set_postfix_str(f"{feedback.error_m:.2f} m off")
        bar.update(round(100 * feedback.share) - bar.n)

    return Execution(node, agent, on_feedback=show)
