"""Commands for fleets and their components: ``fleet``, ``agent``, ``router``, ``decoder``, ``camera``."""

from __future__ import annotations

import os
from dataclasses import replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer
from typer import Argument, Option

from sfglab.cli.buses import Place, print_json, write_text
from sfglab.cli.interfaces import Interfaces
from sfglab.cli.options import Domain, Fleet, FleetFile, Interface, Json, OutputFile, domain_option
from sfglab.component import Orders, run, run_until_interrupted
from sfglab.domains import VARIABLE, usual_domain_id
from sfglab.errors import MissingExtraError
from sfglab.tables import text_table

if TYPE_CHECKING:
    from sfglab.fleet.agent.plan import AgentConfig

fleet_app = typer.Typer(
    help="""Check a fleet file, and write the configuration of a DDS Router or certificates from it.

Example:
  sfglab fleet lint data/fleets/lab.yaml"""
)
agent_app = typer.Typer(
    help="""Run the components of an agent: a robot or computer with a DDS domain of its own.

Example:
  sfglab agent up --domain 7"""
)
_OwnDomain = Annotated[
    int | None,
    domain_option(
        help="DDS domain of the agent. [default: the fleet file's, otherwise ROS_DOMAIN_ID]"
    ),
]
_GlobalDomain = Annotated[
    int | None,
    domain_option(
        help="DDS domain that all agents share. [default: the fleet file's, otherwise 0]"
    ),
]
_GlobalInterface = Annotated[
    str | None,
    Option(
        help="Network interface to the other agents. [default: the fleet file's if one is given, otherwise automatic]"
    ),
]
_Middleware = Annotated[
    Literal["dds", "zenoh"] | None,
    Option(
        "--global",
        help="Middleware between the agents. Over Zenoh they are clients of --hub, otherwise peers. "
        "[default: the fleet file's, otherwise dds]",
    ),
]
_Hub = Annotated[
    list[str] | None,
    Option(
        metavar="HOST[:PORT]",
        help="Hub of the fleet, see sfglab hub; a second one takes over when it fails (repeatable).",
    ),
]
_Peer = Annotated[
    list[str] | None,
    Option(
        metavar="[HOST][:PORT]",
        help="Without hubs: another agent to connect with; it makes further ones known (repeatable). "
        ":PORT is the port at which this agent listens. [default: 7447]",
    ),
]
_Certificates = Annotated[
    Path | None,
    Option(
        help="Folder with ca.pem, NAME.pem and NAME.key. Zenoh then uses QUIC, or TLS for a place such as "
        "tls/HOST. [default: the fleet file's, otherwise TCP without encryption]"
    ),
]
_Agent = Annotated[
    str | None, Option(help="Name of the agent. [default: SFG_AGENT_NAME, otherwise the host name]")
]


@fleet_app.command()
def lint(file: FleetFile, as_json: Json = False) -> None:
    """Check a fleet file: forwarded topics, incomplete services, frames, hosts, cost of discovery.

    The exit status is 0, or 1 if there are errors, or 2 if the file is not a fleet file.

    Example:
      sfglab fleet lint data/fleets/lab.yaml
    """
    from sfglab.fleet.fleet_file import load_fleet
    from sfglab.fleet.lint import lint as lint_fleet
    from sfglab.fleet.lint import lint_file

    text, status = lint_file(file)
    if as_json and status < 2:
        print_json(lint_fleet(load_fleet(file)))
    else:
        typer.echo(text, nl=False)
    raise typer.Exit(status)


@fleet_app.command("router")
def router_file(
    file: FleetFile,
    agent: Annotated[str, Option(help="Name of the agent that the router belongs to.")],
    output: OutputFile = None,
) -> None:
    """Write the configuration of a DDS Router (eProsima) that forwards the same topics as our router.

    Example:
      sfglab fleet router data/fleets/lab.yaml --agent go2 -o go2.yaml
    """
    from sfglab.deploy.dds_router import render_dds_router
    from sfglab.fleet.fleet_file import load_fleet

    write_text(render_dds_router(load_fleet(file), agent), output)


@fleet_app.command()
def certificates(
    file: FleetFile,
    output: Annotated[Path, Option("--output", "-o", help="Folder of the files.")],
    hub: Annotated[
        list[str] | None,
        Option(
            metavar="HOST[,HOST...]",
            help="Names and addresses under which agents connect to a hub (repeatable). [default: the fleet file's]",
        ),
    ] = None,
) -> None:
    """Write certificates and access control for a fleet over Zenoh; needs the extra zenoh.

    A new authority (ca) is valid for 10 years, a certificate for 825 days. Copy ca.pem and its own certificate
    and key to each agent and hub, and access-control.json5 to each hub and peer. Existing certificates and keys
    are kept, so the same command adds an agent. Delete an expired certificate and its key to renew it. An agent
    that you remove from the fleet file has no rights after the hubs start with the new access control.

    Examples:
      sfglab fleet certificates data/fleets/lab.yaml -o keys --hub hub.local,192.168.1.1
      sfglab fleet certificates data/fleets/lab.yaml -o keys   # after a change of the fleet file.
    """
    if find_spec("cryptography") is None:
        raise MissingExtraError("cryptography", extra="zenoh", purpose="this command")
    from sfglab.bus.zenoh.address import host
    from sfglab.fleet.certificates import write_certificates
    from sfglab.fleet.fleet_file import load_fleet

    described = load_fleet(file)
    places = described.zenoh.hubs if described.zenoh else ()
    hubs = [names.split(",") for names in hub or map(host, places)]
    rows = write_certificates(described, output, hubs)
    typer.echo(text_table([("file", "state", "valid until"), *rows]))


@agent_app.command("up")
def agent_up(
    domain: _OwnDomain = None,
    interface: Interface = None,
    global_domain: _GlobalDomain = None,
    global_interface: _GlobalInterface = None,
    middleware: _Middleware = None,
    hub: _Hub = None,
    peer: _Peer = None,
    certificates: _Certificates = None,
    fleet: Fleet = None,
    agent: _Agent = None,
    without: Annotated[
        list[str] | None,
        Option(
            help="Component to leave out (repeatable): router, status, discoverer, decoder or "
            "keeper (the GOP cache)."
        ),
    ] = None,
    parameters: Annotated[
        Literal["dds", "ros"] | None,
        Option(
            help="Show the settings of router and decoder to ros2 param. dds: with rmw_cyclonedds. "
            "ros: with rmw_fastrtps; needs ROS 2 on this host. [default: do not show them]"
        ),
    ] = None,
    as_json: Json = False,
    _interfaces: Interfaces = None,
) -> None:
    """Run an agent until Ctrl-C: router, status provider, discoverer, decoder and GOP cache.

    The router connects the agent's own DDS domain with the domain that all agents share. The
    status provider and the discoverer make agents known to each other. The decoder decodes video of
    other agents, and the GOP cache sends the current group of pictures to late-joining subscribers
    (paper A, section 4). Crashed components are restarted; each restart is reported.

    Examples:
      sfglab agent up --domain 7
      sfglab agent up --domain 7 --interface lo --global-interface wlan0   # over Wi-Fi.
      sfglab agent up --fleet data/fleets/lab.yaml --agent go2
      sfglab agent up --domain 7 --global zenoh --hub 192.168.1.1   # over Zenoh, see sfglab hub.
      sfglab agent up --domain 7 --global zenoh --peer 192.168.1.7   # of a fleet of up to 20 agents.
      sfglab agent up --domain 7 --interfaces ~/ros2_ws/src/my_msgs   # your own types.
      sfglab agent up --domain 7 --without router   # with your own DDS Router.
    """
    from sfglab.fleet.agent.app import serve_agent
    from sfglab.fleet.agent.plan import without as reduced

    place = (domain, interface)
    remote = (global_domain, global_interface)
    zenoh = (middleware, hub, peer, certificates)
    config = _agent_config(agent, fleet, place, remote, zenoh)
    with_parameters = replace(config.router, parameters=parameters)
    config = replace(reduced(config, without or ()), router=with_parameters)
    run(serve_agent(config, typer.echo, as_json=as_json))


def router(
    domain: _OwnDomain = None,
    interface: Interface = None,
    global_domain: _GlobalDomain = None,
    global_interface: _GlobalInterface = None,
    middleware: _Middleware = None,
    hub: _Hub = None,
    peer: _Peer = None,
    certificates: _Certificates = None,
    fleet: Fleet = None,
    agent: _Agent = None,
    _interfaces: Interfaces = None,
) -> None:
    """Run only the router of an agent, which connects its DDS domain with the domain of all agents.

    It forwards the topics of the fleet file's policy, or without a fleet file those of paper A, Table 1:
    global topics, and no local ones.

    Examples:
      sfglab router --domain 7 --interface lo --global-interface wlan0
      sfglab router --domain 7 --global zenoh --hub 192.168.1.1
      sfglab router --fleet data/fleets/lab.yaml --agent go2
    """
    from sfglab.fleet.narration import PathNarrator, serve_terminal
    from sfglab.fleet.router.node import run_router

    place = (domain, interface)
    remote = (global_domain, global_interface)
    zenoh = (middleware, hub, peer, certificates)
    config = _agent_config(agent, fleet, place, remote, zenoh)
    body = partial(run_router, config.router)
    run(serve_terminal("router", body, PathNarrator(), typer.echo))


def hub(
    bind: Annotated[
        str,
        Option(
            metavar="[HOST][:PORT]",
            help="Place at which agents connect. [default: port 7447 of all interfaces]",
        ),
    ] = "",
    hub: Annotated[
        list[str] | None,
        Option(metavar="HOST[:PORT]", help="Other hub of the fleet to join (repeatable)."),
    ] = None,
    certificates: Annotated[
        Path | None,
        Option(
            help="Folder with ca.pem, NAME.pem and NAME.key. Zenoh then uses QUIC and TLS. [default: TCP "
            "without encryption]"
        ),
    ] = None,
    name: Annotated[str, Option(help="Name of the hub's certificate.")] = "hub",
) -> None:
    """Run a hub until Ctrl-C, through which the routers of agents exchange samples over Zenoh.

    Without certificates agents connect over TCP, with certificates over QUIC or TLS. A hub that joins another
    one serves the same fleet, and agents that name both continue when one of them fails.

    Examples:
      sfglab hub
      sfglab hub --bind 10.0.0.2 --hub 10.0.0.1   # the second hub of a fleet.
    """
    from sfglab.fleet.hub import hub_config, run_hub
    from sfglab.fleet.narration import PathNarrator, serve_terminal

    config = hub_config(bind, hub or (), certificates=str(certificates or ""), name=name)
    typer.echo(f"hub: starting at {', '.join(config.listen)}")
    run(serve_terminal("hub", partial(run_hub, config), PathNarrator(), typer.echo))


def _agent_config(
    agent: str | None, fleet: Path | None, local: Place, remote: Place, zenoh: tuple[Any, ...]
) -> AgentConfig:
    """Return an agent as the command line and the fleet file describe it."""
    from sfglab.fleet.agent.plan import config_of
    from sfglab.fleet.fleet_file import load_fleet
    from sfglab.names import default_agent

    domain, interface = local
    if domain is None and fleet is None and VARIABLE in os.environ:
        domain = usual_domain_id()
    middleware, hubs, peers, certificates = zenoh
    return config_of(
        agent or default_agent(),
        None if fleet is None else load_fleet(fleet),
        local=(domain, interface),
        remote=remote,
        middleware=middleware,
        hubs=tuple(hubs or ()),
        peers=tuple(peers or ()),
        certificates=str(certificates or ""),
    )


def decoder(
    streams: Annotated[
        list[str] | None,
        Argument(
            metavar="STREAM", help="Remote stream, e.g. /global/go2/camera_front/color/ffmpeg."
        ),
    ] = None,
    domain: Domain = 0,
    interface: Interface = None,
    remote_domain: Annotated[
        int | None,
        domain_option(help="DDS domain of the remote streams. [default: the local domain]"),
    ] = None,
    remote_interface: _GlobalInterface = None,
) -> None:
    """Decode remote video streams once for all subscribers on this device.

    A stream is decoded while it has a subscriber. Without STREAM, all streams are offered that
    remote agents announce on /local/<agent>/agent_discovery_event.

    Examples:
      sfglab decoder --domain 7 /global/go2/camera_front/color/ffmpeg
      sfglab decoder --domain 7 --interface lo --remote-domain 0 --remote-interface eth0
    """
    from sfglab.bus.address import BusAddress
    from sfglab.fleet.decoder.config import DecoderConfig
    from sfglab.fleet.decoder.node import serve
    from sfglab.fleet.discovery.listener import discovery_topic
    from sfglab.fleet.narration import StreamNarrator, serve_terminal
    from sfglab.names import default_agent

    local = BusAddress(domain_id=domain, interface=interface)
    remote = local
    if remote_domain is not None or remote_interface is not None:
        far = domain if remote_domain is None else remote_domain
        remote = BusAddress(domain_id=far, interface=remote_interface)
    config = DecoderConfig(
        remote=remote,
        local=local,
        streams=tuple(streams or ()),
        discovery_topic=discovery_topic(default_agent()),
    )
    body = partial(serve, config, orders=Orders())
    run(serve_terminal("decoder", body, StreamNarrator(), typer.echo))


def camera(
    topic: Annotated[
        str, Argument(metavar="TOPIC", help="Topic, e.g. /global/go2/camera_front/color/ffmpeg.")
    ],
    source: Annotated[
        str,
        Option(
            help="Source of the images: photos or stereo (included), camera:0, a video file, a log "
            "or bag, or bag:PATH#/topic."
        ),
    ] = "photos",
    codec: Annotated[
        Literal["h264", "rvl"],
        Option(help="h264: colour. rvl: depth, of a source that has it, e.g. stereo."),
    ] = "h264",
    domain: Domain = 0,
    interface: Interface = None,
) -> None:
    """Publish a compressed camera stream of a video, camera or bag (paper A, Table 2).

    Example:
      sfglab camera /global/go2/camera_front/color/ffmpeg --source drive.mp4
    """
    from sfglab.bus.address import BusAddress
    from sfglab.lab.workers.camera import CameraConfig, run_camera

    address = BusAddress(domain_id=domain, interface=interface)
    config = CameraConfig(places=((address, topic),), codec=codec, source=source)
    run(run_until_interrupted(run_camera(config, typer.echo)))
