"""Commands of trajectories: the scene editor, a simulated agent, and sending agents along."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument, Option

from sfglab.cli.buses import Domain, Interface, on_node
from sfglab.component import on_stop
from sfglab.errors import SfglabError

if TYPE_CHECKING:
    from sfglab.bus import Node
    from sfglab.spatial.execution.client import Execution
    from sfglab.spatial.execution.orders import Order
    from sfglab.spatial.execution.server import AgentSetup


def plan(
    scene: Annotated[Path, Argument(help="A scene file, e.g. data/scenes/hall.yaml")],
    port: Annotated[
        int, Option(min=0, max=65535, help="Serve the editor here; 0 takes any port that is free.")
    ] = 8092,
    no_browser: Annotated[
        bool, Option("--no-browser", help="Open no browser; only print the address.")
    ] = False,
    new: Annotated[
        bool, Option("--new", help="Begin an empty scene; the file is made by the first save.")
    ] = False,
) -> None:
    """Plan trajectories for several robots in 3D, in the browser (paper A, section 4.5).

    Every browser that opens the address edits the same scene. Ctrl-C ends and saves nothing.

    Examples:
      sfglab plan data/scenes/hall.yaml
      sfglab plan warehouse.yaml --new
      sfglab plan data/scenes/course.yaml --port 0 --no-browser
    """
    from sfglab.spatial.scene.editor import Editor
    from sfglab.spatial.scene.objects import SceneError
    from sfglab.view.planner.server import Planner

    if new and scene.exists():
        raise SceneError("--new", str(scene), "a file that does not exist yet")
    if not new and not scene.exists():
        raise SceneError("scene", str(scene), "a scene file; --new begins one")
    if not scene.parent.is_dir():
        raise SceneError("scene", str(scene), "a file in a folder that exists")
    editor = Editor.open(scene)
    with Planner(editor, port=port) as planner:
        try:
            typer.echo(f"{scene.name}: {planner.url}  (Ctrl-C ends)")
            if not no_browser:
                typer.launch(planner.url)
            planner.wait()
        except KeyboardInterrupt:
            typer.echo("")
    if editor.dirty:
        typer.echo(
            f"{scene.name}: has changes that were not saved; the file is as it was saved last",
            err=True,
        )


app = typer.Typer(
    help="Trajectories carried out: a simulated agent, and sending an agent along its trajectory.",
    no_args_is_help=True,
)
_Action = Annotated[
    str, Option(help="Name of the action; /global/<agent>/execute_trajectory when not given.")
]


@app.command()
def serve(
    agent: Annotated[str, Option(help="Name of the agent.")],
    domain: Domain = None,
    interface: Interface = None,
    action: _Action = "",
    scene: Annotated[
        Path | None, Option(help="A scene that has the agent: its start and its limits.")
    ] = None,
    preempt: Annotated[
        bool,
        Option("--preempt", help="A second goal takes the first one's place; else it is refused."),
    ] = False,
) -> None:
    """Simulate an agent that an action moves, until Ctrl-C; without a scene it stands at 0 and has no limits.

    It publishes /global/<agent>/pose, /global/<agent>/odometry and <agent>/base on /tf.

    Examples:
      sfglab follow serve --agent go2 --domain 7
      sfglab follow serve --agent go2 --scene data/scenes/hall.yaml --domain 7 --interface lo
    """
    from sfglab.names import validate_agent
    from sfglab.spatial.execution.server import TrajectoryServer

    setup = _setup(validate_agent(agent), scene, preempt=preempt)

    async def until_told(node: Node) -> None:
        asked = asyncio.Event()
        on_stop(asked.set)
        async with TrajectoryServer(node, agent, name=action, setup=setup) as server:
            typer.echo(f"{agent}: {server.action_name} moves it; Ctrl-C ends")
            await asked.wait()

    on_node((domain, interface), until_told, agent)


@app.command("run")
def run_scene(
    file: Annotated[Path, Argument(help="A scene, e.g. data/scenes/hall.yaml")],
    agent: Annotated[
        list[str] | None, Option(help="Who is sent; all that have a trajectory when not given.")
    ] = None,
    domain: Domain = None,
    interface: Interface = None,
    action: _Action = "",
    delay: Annotated[
        float,
        Option(min=0.0, help="Seconds until all start together; 0: each when it gets its goal."),
    ] = 1.0,
) -> None:
    """Send agents along their trajectories of a scene, and wait until they are there; Ctrl-C stops them.

    Several agents start together by their clocks, which must agree. Ends with 0 if all came through, else 1,
    and 130 after Ctrl-C, when all stand.

    Examples:
      sfglab follow run data/scenes/hall.yaml --agent go2 --domain 7
      sfglab follow run data/scenes/hall.yaml --domain 7 --interface lo
    """
    from sfglab.spatial.execution.client import scene_orders
    from sfglab.spatial.scene.files import load_scene

    scene = load_scene(file)

    def orders(start_ns: int) -> tuple[Order, ...]:
        begin_ns = start_ns + round(delay * 1e9) if delay else 0
        found = scene_orders(scene, agents=tuple(agent or ()), start_ns=begin_ns)
        if action and len(found) > 1:
            raise SfglabError(f"--action: given for {len(found)} agents, allowed: with one --agent")
        return found

    if not orders(0):
        raise SfglabError(f"{file}: given no agent with a trajectory, allowed: at least one")
    raise typer.Exit(
        on_node((domain, interface), lambda node: _send_all(node, orders, action), "planner")
    )


def _setup(agent: str, scene: Path | None, *, preempt: bool) -> AgentSetup:
    from sfglab.spatial.execution.agent import Dynamics
    from sfglab.spatial.execution.server import AgentSetup
    from sfglab.spatial.scene.files import load_scene
    from sfglab.spatial.scene.objects import AgentObject

    if scene is None:
        return AgentSetup(preempt=preempt)
    loaded = load_scene(scene)
    named = {found.name: found for found in loaded.all_of(AgentObject)}
    if agent not in named:
        raise SfglabError(
            f"--agent: given {agent!r}, allowed for {scene}: {', '.join(named) or 'none'}"
        )
    return AgentSetup(
        pose=loaded.world_pose(named[agent].id),
        frame_id=loaded.frame_id,
        dynamics=Dynamics(limits=named[agent].limits),
        preempt=preempt,
    )


async def _send_all(node: Node, orders: Callable[[int], tuple[Order, ...]], action: str) -> int:
    from sfglab.spatial.execution.orders import FOLLOW_TRAJECTORY

    sent = [_execution(node, order.agent, action, place) for place, order in enumerate(orders(0))]
    for order in orders(
        0
    ):  # what is imported at first use is not to cost time once the start is set
        FOLLOW_TRAJECTORY.goal(order)
    await asyncio.gather(*(execution.ready() for execution in sent))
    wanted = orders(node.get_clock().now_ns())
    loop, stopping = asyncio.get_running_loop(), set[asyncio.Task[Any]]()

    def stop() -> None:
        stopping.update(loop.create_task(execution.cancel()) for execution in sent)

    on_stop(stop)
    await asyncio.gather(*(e.begin(order) for e, order in zip(sent, wanted, strict=True)))
    ended = await asyncio.gather(*(execution.result() for execution in sent))
    await asyncio.gather(*stopping)
    for order, end in zip(wanted, ended, strict=True):
        at = (
            ""
            if end.pose is None
            else " at ({:.2f}, {:.2f}, {:.2f}) m".format(*end.pose.position_m)
        )
        typer.echo(f"{order.agent}: {end}{at}")
    if stopping:
        return 130
    return 0 if all(end.outcome.value == "succeeded" for end in ended) else 1


def _execution(node: Node, agent: str, action: str, place: int) -> Execution:
    from tqdm import tqdm

    from sfglab.spatial.execution.client import Execution

    bar = tqdm(total=100, desc=agent, position=place, unit="%", file=sys.stderr, leave=True)

    def show(feedback: Any) -> None:
        bar.set_postfix_str(f"{feedback.error_m:.2f} m off" if feedback.error_m is not None else "")
        bar.update(round(100 * feedback.share) - bar.n)

    return Execution(node, agent, action=action, on_feedback=show)
