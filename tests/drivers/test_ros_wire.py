"""Keys, attachments and tokens, against what was seen of real systems (docs/base.md)."""

from __future__ import annotations

import pytest
import zenoh
from hypothesis import given
from hypothesis import strategies as st

from drivers.ros_messages import ODOMETRY, TRIGGER, TWIST, TWIST_STAMPED
from drivers.ros_wire import (
    Endpoint,
    RmwZenohWire,
    Ros2ddsWire,
    dds_type,
    gid_of,
    unpack_attachment,
    wire_of,
)
from onboard.core.config import BaseLink

ZID = "943f9ebc32acd3e072bfda12ce8c7ed2"
TWIST_HASH = "RIHS01_5f0fcd4f81d5d06ad9b4c4c63e3ea51b82d6ae4d0558f1d475229b1121db6f64"
TRIGGER_HASH = "RIHS01_eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f"


def test_a_bridge_takes_names_as_keys():
    wire = wire_of(BaseLink(bridge="ros2dds"))
    assert wire.key(Endpoint("cmd_vel", TWIST)) == "cmd_vel"
    assert wire.attachment(1, 2, bytes(16)) is None
    assert wire.tokens(ZID, "marsupial", [("MP", Endpoint("cmd_vel", TWIST))]) == []
    assert Ros2ddsWire("bot1").key(Endpoint("legs/sit", TRIGGER)) == "bot1/legs/sit"


def test_keys_of_rmw_zenoh():
    wire = wire_of(BaseLink(bridge="rmw_zenoh"))
    expected = f"0/cmd_vel/geometry_msgs::msg::dds_::TwistStamped_/{TWIST_HASH}"
    assert wire.key(Endpoint("cmd_vel", TWIST_STAMPED)) == expected
    expected = f"0/sit/std_srvs::srv::dds_::Trigger_/{TRIGGER_HASH}"
    assert wire.key(Endpoint("sit", TRIGGER)) == expected
    assert RmwZenohWire("bot1", 42).key(Endpoint("odom", ODOMETRY)).startswith("42/bot1/odom/nav_msgs::msg::")


def test_humble_knows_no_hashes():
    wire = wire_of(BaseLink(bridge="rmw_zenoh", type_hashes=False))
    expected = "0/cmd_vel/geometry_msgs::msg::dds_::Twist_/TypeHashNotSupported"
    assert wire.key(Endpoint("cmd_vel", TWIST)) == expected
    token = wire.tokens(ZID, "n", [("MP", Endpoint("cmd_vel", TWIST))])[1]
    assert token.endswith("/%cmd_vel/geometry_msgs::msg::dds_::Twist_/TypeHashNotSupported/::,10:,:,:,,")


def test_tokens_are_those_of_a_real_node():
    """A node and a subscription as `ros2 topic echo` declares them, but for the quality of service."""
    node, subscription = RmwZenohWire().tokens(
        ZID, "_ros2cli_31", [("MS", Endpoint("cmd_vel", TWIST_STAMPED))]
    )
    assert node == f"@ros2_lv/0/{ZID}/0/0/NN/%/%/_ros2cli_31"
    expected = f"@ros2_lv/0/{ZID}/0/1/MS/%/%/_ros2cli_31/%cmd_vel/geometry_msgs::msg::dds_::TwistStamped_/"
    assert subscription == f"{expected}{TWIST_HASH}/::,10:,:,:,,"
    zenoh.KeyExpr(subscription)
    nested = RmwZenohWire("a/b").tokens(ZID, "n", [("SS", Endpoint("c/sit", TRIGGER))])[1]
    assert f"/SS/%/%/n/%a%b%c%sit/std_srvs::srv::dds_::Trigger_/{TRIGGER_HASH}/" in nested


def test_the_attachment_is_what_zenohs_serialiser_writes():
    gid = bytes(range(16))
    attachment = RmwZenohWire().attachment(7, 1_700_000_000_123_456_789, gid)
    oracle = zenoh.ext.z_serialize((zenoh.ext.Int64(7), zenoh.ext.Int64(1_700_000_000_123_456_789), gid))
    assert attachment == oracle.to_bytes()
    assert len(attachment) == 33
    assert attachment[16] == 16


@given(st.integers(-(2**63), 2**63 - 1), st.integers(0, 2**63 - 1), st.binary(min_size=16, max_size=16))
def test_attachments_come_back(sequence, stamp_ns, gid):
    attachment = RmwZenohWire().attachment(sequence, stamp_ns, gid)
    assert unpack_attachment(attachment) == (sequence, stamp_ns, gid)
    assert unpack_attachment(attachment[:-1]) is None
    assert unpack_attachment(attachment[:16] + b"\x0f" + attachment[17:]) is None


def test_identifiers_differ():
    assert len(gid_of("a")) == 16
    assert gid_of("a") != gid_of("b")
    assert gid_of("a") == gid_of("a")


@pytest.mark.parametrize(
    ("name", "expected"),
    [(TWIST, "geometry_msgs::msg::dds_::Twist_"), (TRIGGER, "std_srvs::srv::dds_::Trigger_")],
)
def test_type_names(name, expected):
    assert dds_type(name) == expected
