"""The graph of a running ROS 2 system over `rmw_zenoh`: what its nodes' liveliness tokens tell, asked of its router."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Iterable, Iterator

from cfgplan.errors import InputError
from cfgplan.extras import needed
from cfgplan.ros.graph import Role, RosGraph, RosNode, RosPort
from cfgplan.ros.liveliness import EndpointToken, LivelinessToken, NodeToken, all_tokens, read_token
from cfgplan.ros.types import MessageType
from cfgplan.ros.zenoh_config import first_line, ros_domain, zenoh_config

CONNECT_LIMIT_S = 3.0
"""How long it may take to reach a router."""
TOKENS_LIMIT_S = 3.0
"""How long the tokens may take to come; the router says when these are all."""
_ROLES = {"publisher": Role.PUBLISHES, "subscription": Role.SUBSCRIBES, "service": Role.SERVES, "client": Role.CALLS}
_ACTION, _GOAL = "/_action/", "_SendGoal"


def router_graph(endpoint: str | None = None) -> RosGraph:
    """The nodes that a Zenoh router knows in the domain of ROS_DOMAIN_ID. Raises InputError if no router is reached.

    The router is at `endpoint`, such as tcp/localhost:7447, or where the variables of `rmw_zenoh` say.
    """
    domain = ros_domain()
    keys, where = _keys(domain, endpoint)
    tokens, unread = [], 0
    for key in keys:
        try:
            tokens.append(read_token(key))
        except InputError:
            unread += 1
    notes = [f"what {unread} of the router's tokens mean, which are in no form that is known"] if unread else []
    return token_graph(tokens, f"the ROS 2 domain {domain} at {where}", notes)


def token_graph(tokens: Iterable[LivelinessToken], source: str, notes: Iterable[str] = ()) -> RosGraph:
    """The graph that liveliness tokens tell. Nodes of one name, which ROS 2 allows, become one; a note says so."""
    notes, tokens = list(notes), sorted(tokens, key=str)
    ports: dict[str, list[RosPort]] = defaultdict(list)
    nodes: dict[str, set[tuple[str, int]]] = defaultdict(set)
    for token in tokens:
        node = token if isinstance(token, NodeToken) else token.node
        nodes[node.full_name].add((node.session, node.number))
        if isinstance(token, EndpointToken):
            ports[node.full_name] += _ports(token)
    for name, several in sorted(nodes.items()):
        if len(several) > 1:
            notes.append(f"which of the {len(several)} nodes called {name} has which of their topics")
    return RosGraph(tuple(RosNode(name, tuple(ports[name]), runs=True) for name in nodes), (source,), tuple(notes))


def _ports(token: EndpointToken) -> Iterator[RosPort]:
    """The port that an endpoint is: one for each end of an action, which has five topics and services."""
    role, kind = _ROLES[token.kind], token.type
    if _ACTION not in token.topic:
        yield RosPort(role, token.topic, kind, definition=token.type_hash)
    elif role.is_service and kind.name.endswith(_GOAL):
        action = MessageType(kind.package, kind.name.removesuffix(_GOAL), "action")
        yield RosPort(role, token.topic.partition(_ACTION)[0], action)


def _keys(domain: int, endpoint: str | None) -> tuple[list[str], str]:
    """The keys of all tokens of a domain, and where the router is that told them."""
    needed("graphs of ROS 2", "zenoh")
    import zenoh

    config = zenoh_config([endpoint] if endpoint else [])
    told = json.loads(config.get_json("connect/endpoints"))
    where = ", ".join(told) if isinstance(told, list) else str(told)
    try:
        for key, value in {
            "mode": '"client"',  # a client has one link, and by that the router tells all that it knows
            "connect/timeout_ms": str(round(CONNECT_LIMIT_S * 1000)),
            "connect/exit_on_failure": "true",
        }.items():
            config.insert_json5(key, value)
        session = zenoh.open(config)
    except zenoh.ZError as error:
        mend = (
            "start one by `ros2 run rmw_zenoh_cpp rmw_zenohd`, or name its endpoint: `live`, that is what "
            "ZENOH_SESSION_CONFIG_URI or else tcp/localhost:7447 says, or tcp/HOST:7447. Other middlewares of ROS 2 "
            "can't be asked; record a bag there, and import that"
        )
        raise InputError.of(f"no Zenoh router answers at {where}: {first_line(error)}", mend=mend) from None
    with session:
        replies = session.liveliness().get(all_tokens(domain), timeout=TOKENS_LIMIT_S)
        return [str(reply.ok.key_expr) for reply in replies if reply.ok is not None], where
