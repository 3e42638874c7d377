"""The ways of agents to each other, without agents: who hears whom on this computer by links over loopback."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack

import pytest
from cfgplan_runtime.fleet import ways
from cfgplan_runtime.fleet.links import config
from cfgplan_runtime.fleet.ways import RouteWatch, alive_key, reach_key
from cfgplan_runtime.streams.zenoh_link import ZenohLink
from small_fleet import PATIENCE_S, eventually, free_port


class Hosts:
    """Hosts that listen on loopback, each of which connects to others; whom each hears, and what it tells its user."""

    def __init__(self, stack: ExitStack, **connect: str) -> None:
        self._stack = stack
        self._endpoints = {host: f"tcp/127.0.0.1:{free_port()}" for host in connect}
        self._connect = {host: [self._endpoints[one] for one in names.split()] for host, names in connect.items()}
        self.said: list[str] = []
        self.links: dict[str, ZenohLink] = {}
        for host in connect:
            self.start(host)

    def start(self, host: str) -> None:
        listen, connect = [self._endpoints[host]], self._connect[host]
        link = self.links[host] = ZenohLink(config(listen, connect))
        self._stack.callback(link.close)
        link.live(f"{alive_key(host)}/life")

        def say(text: str) -> None:
            self.said.append(f"{host}: {text}")

        way = RouteWatch(link, f"{alive_key(host)}/life", listen, connect, None, lambda error: say(str(error)), say)
        self._stack.callback(way.close)

    def heard(self, host: str) -> set[str]:
        """The hosts that a host hears."""
        return {key.split("/")[1] for key in self.links[host].alive(f"{alive_key(None)}/*")}

    def await_whole(self, *hosts: str) -> None:
        """Wait until each of these hosts, or all, hears each."""
        names = hosts or tuple(self.links)
        eventually(lambda: all(self.heard(host) >= set(names) for host in names))

    def await_said(self, *hosts: str) -> None:
        """Wait until these hosts, and no others, have told something."""
        eventually(lambda: {said.partition(":")[0] for said in self.said} == set(hosts))


@pytest.fixture
def stack(monkeypatch: pytest.MonkeyPatch) -> Iterator[ExitStack]:
    monkeypatch.setattr(ways, "LEASE_S", 0.4)
    monkeypatch.setattr(ways, "_WAY_LOOK_S", 0.1)
    with ExitStack() as made:
        yield made


def test_hosts_that_are_linked_with_one_alone_hear_each_other(stack: ExitStack) -> None:
    hosts = Hosts(stack, base="", r1="base", r2="base", r3="base")
    hosts.await_whole()
    hosts.await_said("r2", "r3")
    assert all(said.endswith(": can be reached only through base, and so are all others now") for said in hosts.said)


def test_both_ends_of_a_row_go_through_their_neighbours(stack: ExitStack) -> None:
    hosts = Hosts(stack, a="b", b="", c="b", d="c")
    hosts.await_whole()
    hosts.await_said("a", "d")


def test_an_agent_of_another_version_is_passed_over(stack: ExitStack) -> None:
    hosts = Hosts(stack, base="", r1="base", r2="base")
    hosts.links["base"].live(f"{alive_key('aged')}/life")
    hosts.links["base"].answer(reach_key("aged"), lambda: b"[]")
    hosts.await_whole()
    hosts.await_said("r2")


def test_who_connects_to_all_others_may_be_the_one_between(stack: ExitStack) -> None:
    hosts = Hosts(stack, base="r1 r2", r1="", r2="")
    hosts.await_whole()
    hosts.await_said("r2")


def test_hosts_that_are_linked_with_all_stay_so(stack: ExitStack, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ways, "LEASE_S", PATIENCE_S)  # on a busy computer links take long to be there
    hosts = Hosts(stack, base="", r1="base", r2="base r1")
    hosts.await_whole()
    monkeypatch.setattr(ways, "LEASE_S", 0.4)
    looks, look = Counter[RouteWatch](), RouteWatch._look

    def counted_look(way: RouteWatch, asked: str, others: set[str]) -> None:
        look(way, asked, others)
        looks[way] += 1

    monkeypatch.setattr(RouteWatch, "_look", counted_look)
    eventually(lambda: len(looks) == 3 and min(looks.values()) >= 10)
    assert hosts.said == []


def test_who_goes_through_one_that_is_gone_goes_directly_and_through_another_that_hears_more(stack: ExitStack) -> None:
    hosts = Hosts(stack, base="", r1="base other", r2="base other", other="base")
    hosts.await_whole()
    hosts.await_said("r2")
    between = hosts.said[0].split(" through ")[1].partition(",")[0]
    hosts.links[between].close()
    hosts.await_whole(*({"base", "r1", "r2", "other"} - {between}))
    hosts.start(between)
    hosts.await_whole()
