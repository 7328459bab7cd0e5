"""Commands of fleets: check their files, configure routers, and run an agent's components beside ROS 2."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer
from typer import Argument, Option

from sfglab.cli.buses import Domain, Json, Place, domain_option, put_text, tell, unused
from sfglab.cli.interfaces import Interfaces
from sfglab.cli.removed import refuse
from sfglab.component import run, run_until_interrupted
from sfglab.domains import VARIABLE, usual_domain_id

if TYPE_CHECKING:
    from sfglab.fleet.agent.plan import AgentConfig

fleet_app = typer.Typer(
    help="A fleet file: what crosses its borders, and routers' configurations for it.",
    no_args_is_help=True,
)
agent_app = typer.Typer(
    help="An agent of a fleet: router, status provider, discoverer, decoder.", no_args_is_help=True
)
_GlobalDomain = Annotated[
    int | None, domain_option("The domain that all agents share.", "the fleet file's, else 0")
]
_OwnDomain = Annotated[
    int | None, domain_option("The agent's own DDS domain.", f"the fleet file's, else {VARIABLE}")
]
_GlobalInterface = Annotated[str | None, Option(help="Interface towards the other agents.")]
_Offers = Annotated[
    bool | None,
    Option(
        help="Whether ROS 2's tools list what nobody has subscribed yet; yes, or the fleet file's."
    ),
]


@fleet_app.command()
def lint(
    file: Annotated[Path, Argument(help="A fleet file, e.g. data/fleets/lab.yaml")],
    as_json: Json = False,
) -> None:
    """Say who hears what, which services are half open, which frames clash, and what discovery will cost.

    Ends with 0, 1 if there are errors, 2 if the file is no fleet.

    Example:
      sfglab fleet lint data/fleets/lab.yaml
    """
    from sfglab.fleet.fleet_file import load_fleet
    from sfglab.fleet.lint import lint as lint_fleet
    from sfglab.fleet.lint import lint_file

    text, code = lint_file(file)
    if as_json and code < 2:
        tell(lint_fleet(load_fleet(file)))
        raise typer.Exit(code)
    typer.echo(text, nl=False)
    raise typer.Exit(code)


@fleet_app.command("router")
def router_configuration(
    file: Annotated[Path, Argument(help="A fleet file.")],
    agent: Annotated[str, Option(help="Agent whose router it is.")],
    target: Annotated[str, Option(hidden=True)] = "dds-router",
    output: Annotated[
        Path | None, Option("--output", "-o", help="Write here, not to the terminal.")
    ] = None,
) -> None:
    """Write the configuration of a DDS Router that forwards what our own router would.

    Example:
      sfglab fleet router data/fleets/lab.yaml --agent go2 -o go2.yaml
    """
    from sfglab.deploy.routers.dds_router import render_dds_router

    if target != "dds-router":
        refuse(
            f"fleet router --target {target}", "use a DDS Router, whose file this command writes"
        )
    from sfglab.fleet.fleet_file import load_fleet

    put_text(render_dds_router(load_fleet(file), agent), output)


@agent_app.command("up")
def agent_up(
    domain: _OwnDomain = None,
    interface: Annotated[
        str | None, Option(help="Interface of its own domain; lo keeps it inside.")
    ] = None,
    global_domain: _GlobalDomain = None,
    global_interface: _GlobalInterface = None,
    fleet: Annotated[Path | None, Option(help="A fleet file that describes the agent.")] = None,
    agent: Annotated[
        str | None, Option(help="Its name; SFG_AGENT_NAME, else the host's name, when not given.")
    ] = None,
    without: Annotated[
        list[str] | None,
        Option(
            help="Component to leave out (repeatable): router, status, discoverer, decoder, "
            "or keeper, the GOP cache."
        ),
    ] = None,
    offers: _Offers = None,
    parameters: Annotated[
        Literal["dds", "ros"] | None,
        Option(
            help="Let ros2 param read router and decoder: over dds (rmw_cyclonedds), or by a ROS 2 here."
        ),
    ] = None,
    as_json: Annotated[
        bool, Option("--json", help="Report JSON lines instead of sentences.")
    ] = False,
    _interfaces: Interfaces = None,
) -> None:
    """Run an agent until Ctrl-C: router, status provider, discoverer, decoder and GOP cache.

    This is everything that paper A puts on each robot. A component that crashes is started again,
    and the restart is reported.

    Examples:
      sfglab agent up --domain 7
      sfglab agent up --domain 7 --interface lo --global-interface wlan0
      sfglab agent up --fleet data/fleets/lab.yaml --agent go2
      sfglab agent up --domain 7 --interfaces ~/ros2_ws/src/my_msgs   # types of your own
      sfglab agent up --domain 7 --without router   # beside a DDS Router of your own
    """
    from sfglab.fleet.agent import plan
    from sfglab.fleet.agent.app import serve_agent

    config = _agent_config(
        agent, fleet, (domain, interface), (global_domain, global_interface), offers
    )
    config = replace(plan.without(config, without or ()), parameters=parameters)
    run(serve_agent(config, typer.echo, as_json=as_json))


def router(
    domain: _OwnDomain = None,
    interface: Annotated[str | None, Option(help="Interface of its own domain.")] = None,
    global_domain: _GlobalDomain = None,
    global_interface: _GlobalInterface = None,
    fleet: Annotated[Path | None, Option(help="A fleet file: domains, policy and frames.")] = None,
    agent: Annotated[str | None, Option(help="Name of the agent.")] = None,
    prefix_frames: Annotated[
        bool | None,
        Option(help="Whether TF frames get the agent's name in front on their way out; yes."),
    ] = None,
    offers: _Offers = None,
    _interfaces: Interfaces = None,
) -> None:
    """Run a router alone: what Table 1, or the fleet file's policy, names crosses, everything else stays.

    Examples:
      sfglab router --domain 7 --interface lo --global-interface wlan0
      sfglab router --fleet data/fleets/lab.yaml --agent go2
    """
    from sfglab.fleet.agent.plan import router_config
    from sfglab.fleet.router.node import serve_terminal

    if domain is None and fleet is None and VARIABLE not in os.environ:
        raise typer.BadParameter(
            "nothing is given, allowed: a domain, or a fleet file", param_hint="--domain"
        )
    sides = (domain, interface), (global_domain, global_interface)
    config = router_config(_agent_config(agent, fleet, *sides, offers))
    if prefix_frames is not None:
        config = replace(config, prefix_frames=prefix_frames)
    run(serve_terminal(config, typer.echo))


def _agent_config(
    agent: str | None, fleet: Path | None, local: Place, remote: Place, offers: bool | None
) -> AgentConfig:
    """Return an agent as the command line and the fleet file describe it; sides are domain and interface."""
    from sfglab.fleet.agent.plan import SideOptions, config_from_options
    from sfglab.fleet.fleet_file import load_fleet
    from sfglab.names import default_agent

    if local[0] is None and fleet is None and VARIABLE in os.environ:
        local = usual_domain_id(), local[1]
    sides = [
        SideOptions(domain_id=domain, interface=interface) for domain, interface in (local, remote)
    ]
    described = load_fleet(fleet) if fleet is not None else None
    config = config_from_options(
        agent or default_agent(), described, local=sides[0], remote=sides[1]
    )
    return config if offers is None else replace(config, offers=offers)


def decoder(
    streams: Annotated[
        list[str] | None,
        Argument(help="Remote streams by name, e.g. /global/go2/camera_front/color/ffmpeg"),
    ] = None,
    domain: Annotated[int | None, domain_option("DDS domain of the local subscribers.")] = None,
    interface: Annotated[str | None, Option(help="Interface of the local domain.")] = None,
    remote_domain: Annotated[
        int | None, domain_option("DDS domain of the remote streams.", "the local one")
    ] = None,
    remote_interface: Annotated[str | None, Option(help="Interface of the remote domain.")] = None,
    linger: Annotated[
        float, Option(min=0.0, help="Seconds a pipeline outlives its last subscriber.")
    ] = 1.0,
    offers: Annotated[
        bool, Option(help="Whether ROS 2's tools list what nobody decodes yet.")
    ] = True,
) -> None:
    """Decode remote streams once for all subscribers on this device, on demand.

    Examples:
      sfglab decoder --domain 7 /global/go2/camera_front/color/ffmpeg
      sfglab decoder --domain 7 --interface lo --remote-domain 0 --remote-interface eth0

    Without streams it offers what remote agents announce on /local/<agent>/agent_discovery_event.
    """
    from sfglab.bus.address import BusAddress
    from sfglab.fleet.decoder.node import DecoderConfig, serve_terminal
    from sfglab.names import Resource, RosFqnBuilder, Scope

    domain = usual_domain_id() if domain is None else domain
    local = BusAddress(domain_id=domain, interface=interface)
    remote = local
    if remote_domain is not None or remote_interface is not None:
        far_domain = domain if remote_domain is None else remote_domain
        remote = BusAddress(domain_id=far_domain, interface=remote_interface)
    discovery = RosFqnBuilder().scope(Scope.LOCAL).resource(Resource.AGENT_DISCOVERY_EVENT).build()
    config = DecoderConfig(
        remote=remote,
        local=local,
        streams=tuple(streams or ()),
        discovery_topic=str(discovery),
        linger_s=linger,
        offers=offers,
    )
    run(serve_terminal(config, typer.echo))


def camera(
    topic: Annotated[str, Argument(help="Topic, e.g. /global/go2/camera_front/color/ffmpeg")],
    source: Annotated[
        str, Option(help="photos, stereo, camera:0, a video file, log or bag, or bag:PATH#/topic.")
    ] = "photos",
    codec: Annotated[
        Literal["h264", "rvl"],
        Option(help="h264 (colour) or rvl (depth, needs a source with depth)."),
    ] = "h264",
    domain: Domain = None,
    interface: Annotated[str | None, Option(help="Network interface.")] = None,
    encoder: Annotated[str, Option(help="H.264 encoder by FFmpeg's name.")] = "auto",
) -> None:
    """Publish a camera stream at the settings of the paper's Table 2, from any source.

    Example:
      sfglab camera /global/go2/camera_front/color/ffmpeg --source drive.mp4
    """
    from sfglab.bus.address import BusAddress
    from sfglab.lab.workers.camera import CameraConfig, run_camera

    if codec != "h264":
        unused(f"with --codec {codec}, whose encoder is the only one", "encoder")
    config = CameraConfig(
        places=(
            (
                BusAddress(
                    domain_id=usual_domain_id() if domain is None else domain, interface=interface
                ),
                topic,
            ),
        ),
        codec=codec,
        source=source,
        encoder=encoder,
    )
    run(run_until_interrupted(run_camera(config, typer.echo)))
