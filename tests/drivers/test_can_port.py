"""The shell around python-can: what it takes, what it drops and counts; two processes over multicast."""

from __future__ import annotations

import multiprocessing
import os
import socket
import time

import can
import pytest
from bracket_bench import WIRE, BrokenBus

from drivers.bracket import Bracket
from drivers.bracket_types import State
from drivers.bracket_wire import CanFrame
from drivers.can_port import BATCH, BracketPort, CanPort, open_port
from onboard.core.errors import InputError
from simulation.bracket import BracketNode

GROUP = f"239.74.{os.getpid() % 250}.{os.getpid() // 250 % 250}"
"""One for each run of the tests on a machine."""


def test_classic_frames_pass_and_everything_else_is_dropped():
    port = open_port("virtual", "port-1")
    with can.Bus(interface="virtual", channel="port-1") as other:
        other.send(can.Message(arbitration_id=0x120, data=b"abc", is_extended_id=False))
        other.send(can.Message(arbitration_id=0x120, data=b"abc", is_extended_id=True))
        other.send(can.Message(arbitration_id=0x121, is_remote_frame=True, is_extended_id=False))
        other.send(can.Message(arbitration_id=0x122, data=bytes(12), is_fd=True, is_extended_id=False))
        other.send(can.Message(is_error_frame=True, is_extended_id=False))
        other.send(can.Message(arbitration_id=0x7FF, is_extended_id=False))
        assert port.receive() == [CanFrame(0x120, b"abc"), CanFrame(0x7FF, b"")]
        assert port.errors == 1
        assert port.receive() == []
        port.send([CanFrame(0x110, b"12345678"), CanFrame(0x111, b"")])
        sent = [other.recv(0.0), other.recv(0.0)]
        assert [(m.arbitration_id, bytes(m.data)) for m in sent] == [(0x110, b"12345678"), (0x111, b"")]
        assert not any(m.is_extended_id or m.is_fd or m.is_remote_frame for m in sent)
    port.close()


def test_a_babbling_bus_is_taken_in_batches():
    port = open_port("virtual", "port-2")
    with can.Bus(interface="virtual", channel="port-2") as other:
        for _ in range(BATCH + 3):
            other.send(can.Message(arbitration_id=1, is_extended_id=False))
        assert [len(port.receive()) for _ in range(3)] == [BATCH, 3, 0]
    port.close()


def test_a_bus_that_is_off_is_counted_and_does_not_raise():
    port = CanPort(BrokenBus())
    assert port.receive() == []
    port.send([CanFrame(1, b""), CanFrame(2, b"")])
    assert port.errors == 3


def test_a_bracket_behind_a_bus_that_is_off_is_silent():
    bracket = BracketPort(CanPort(BrokenBus()), Bracket(WIRE), iter(range(100)).__next__)
    assert bracket.poll(permitted=True).reason == "bracket is silent"


@pytest.mark.parametrize("interface", ["socketcan", "no-such-interface"])
def test_a_bus_that_does_not_exist_is_named(interface):
    with pytest.raises(InputError, match=f"CAN bus {interface} can99: .*; is the interface up"):
        open_port(interface, "can99")


def multicast_works() -> bool:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect((GROUP, 43113))
        except OSError:
            return False
    try:
        open_port("udp_multicast", GROUP).close()
    except InputError:
        return False
    return True


def slow_clock() -> float:
    """A third of real time, so that a machine that stops for a second does not lose the other side."""
    return time.monotonic() / 3


def node_process(group: str, stop: multiprocessing.synchronize.Event) -> None:
    """The simulated bracket in a process of its own."""
    port, node = open_port("udp_multicast", group), BracketNode(WIRE)
    while not stop.is_set():
        port.send(node.step(slow_clock(), port.receive()))
        stop.wait(0.01)
    port.close()


@pytest.mark.skipif(not multicast_works(), reason="no route for multicast: ip route add 224.0.0.0/4 dev lo")
def test_a_release_between_two_processes():
    context = multiprocessing.get_context("spawn")
    stop = context.Event()
    node = context.Process(target=node_process, args=(GROUP, stop))
    node.start()
    port = open_port("udp_multicast", GROUP)
    bracket = BracketPort(port, Bracket(WIRE), slow_clock)
    pause, states = context.Event(), []
    for _ in range(3000):
        state = bracket.poll(permitted=True).state
        if not states or states[-1] != state:
            states.append(state)
        if state == State.RELEASED:
            break
        pause.wait(0.01)
    stop.set()
    node.join(10.0)
    port.close()
    assert states[-1] == State.RELEASED
    assert states.index(State.ARMED) < states.index(State.RELEASING)
    assert port.errors == 0
