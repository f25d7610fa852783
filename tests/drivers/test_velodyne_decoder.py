"""Velodyne packets to scans: ranges, times, cuts, losses, strangers, restarts."""

from __future__ import annotations

import re
import struct

import numpy as np
import pytest
from sensor_streams import DELAY_S, TURN_S, assert_same_ranges, events, feed, image_of, random_image, scans

from drivers.velodyne import VelodyneDecoder
from drivers.velodyne_packets import PRODUCTS, VLP_16_PRODUCT, beams_of
from onboard.core.lidar import VLP_16
from onboard.core.view_mask import ViewMask
from simulation.velodyne_packets import TimedPacket, velodyne_packets

BEGIN_S, AHEAD_S = 100.0, 7000.0
PACKETS = 75


def turns(count: int, begin_s: float = BEGIN_S) -> list[TimedPacket]:
    made = [velodyne_packets(random_image(VLP_16, k), begin_s + k * TURN_S) for k in range(count)]
    return [packet for turn in made for packet in turn]


def changed(packet: TimedPacket, position: int, data: bytes) -> TimedPacket:
    payload = bytearray(packet.payload)
    end = position + len(data) if position + len(data) else len(payload)
    payload[position:end] = data
    return TimedPacket(packet.device_s, bytes(payload))


def test_ranges_come_back_where_they_were_cast() -> None:
    decoder = VelodyneDecoder(VLP_16_PRODUCT)
    found = scans([*feed(decoder, turns(3), AHEAD_S), *decoder.finish()])
    assert [scan.complete for scan in found] == [True] * 3
    for k, scan in enumerate(found):
        sent = random_image(VLP_16, k)
        assert_same_ranges(scan, sent, 0.011)
        assert len(scan.points) == np.isfinite(sent.ranges).sum()
    assert decoder.counters.packets == 3 * PACKETS
    assert (decoder.counters.lost, decoder.counters.half_scans) == (0, 0)


def test_points_lie_along_the_rays_of_their_pixels() -> None:
    decoder = VelodyneDecoder(VLP_16_PRODUCT)
    scan = scans([*feed(decoder, turns(1), AHEAD_S), *decoder.finish()])[0]
    lengths = np.linalg.norm(scan.points, axis=1)
    column = (np.arctan2(scan.points[:, 1], scan.points[:, 0]) + np.pi) / (2 * np.pi) * 1800
    elevation = np.rad2deg(np.arcsin(scan.points[:, 2] / lengths))
    row = np.round((15 - elevation) / 2).astype(int)
    assert np.abs(column - np.floor(column) - 0.5).max() < 0.4
    np.testing.assert_array_equal(image_of(scan)[row, np.floor(column).astype(int)], lengths)


def test_a_scan_comes_with_the_packet_that_crosses_the_cut() -> None:
    decoder = VelodyneDecoder(VLP_16_PRODUCT)
    packets = turns(2)
    assert not feed(decoder, packets[:PACKETS], AHEAD_S)
    assert len(scans(feed(decoder, packets[PACKETS : PACKETS + 1], AHEAD_S))) == 1


@pytest.mark.parametrize("cut_deg", [0.0, 97.3, 359.99])
def test_a_packet_with_the_cut_is_shared_out_firing_by_firing(cut_deg: float) -> None:
    decoder = VelodyneDecoder(VLP_16_PRODUCT, cut_deg)
    found = scans([*feed(decoder, turns(3), AHEAD_S), *decoder.finish()])
    assert sum(len(scan.points) for scan in found) == sum(
        np.isfinite(random_image(VLP_16, k).ranges).sum() for k in range(3)
    )
    assert [scan.complete for scan in found][1:3] == [True, True]


def test_stamps_are_the_middle_of_the_sweep_on_both_clocks() -> None:
    decoder = VelodyneDecoder(VLP_16_PRODUCT)
    found = scans([*feed(decoder, turns(3), AHEAD_S), *decoder.finish()])
    for k, scan in enumerate(found):
        middle_s = BEGIN_S + k * TURN_S + 1799 * 55.296e-6 / 2
        assert scan.device_stamp_s is not None
        assert scan.device_stamp_s % 3600 == pytest.approx(middle_s, abs=2e-6)
        assert scan.stamp_s == pytest.approx(middle_s + AHEAD_S + DELAY_S, abs=1e-4)
        assert scan.offsets_s is not None
        assert scan.offsets_s.min() == pytest.approx(-scan.offsets_s.max(), abs=1e-3)
        assert np.ptp(scan.offsets_s) == pytest.approx(1800 * 55.296e-6, abs=1e-3)


def test_stamps_run_on_over_the_hour() -> None:
    decoder = VelodyneDecoder(VLP_16_PRODUCT)
    outputs = [*feed(decoder, turns(4, 3599.85), AHEAD_S), *decoder.finish()]
    assert np.diff([scan.stamp_s for scan in scans(outputs)]) == pytest.approx([TURN_S] * 3, abs=1e-4)
    assert not events(outputs)
    assert decoder.counters.lost == 0


def test_columns_of_lost_packets_say_nothing_and_the_scan_is_marked() -> None:
    decoder = VelodyneDecoder(VLP_16_PRODUCT)
    packets = turns(2)
    missing = packets[:20] + packets[35:]
    scan, whole = scans([*feed(decoder, missing, AHEAD_S), *decoder.finish()])
    image = image_of(scan)
    lost = np.arange(1800)[::-1].reshape(PACKETS, 24)[20:35].ravel()
    # the first and last firing beside the gap may lend their range to the pixel next to theirs
    assert not image[:, np.sort(lost)[1:-1]].any()
    kept = np.setdiff1d(np.arange(1800), lost)
    sent = random_image(VLP_16, 0).ranges[:, kept]
    np.testing.assert_array_equal(np.isinf(image[:, kept]), np.isinf(sent))
    assert scan.completeness == pytest.approx(60 / 75, abs=0.002)
    assert not scan.complete
    assert whole.complete
    assert (decoder.counters.lost, decoder.counters.half_scans) == (15, 1)


def test_more_than_a_turn_lost_does_not_join_two_sweeps() -> None:
    decoder = VelodyneDecoder(VLP_16_PRODUCT)
    packets = turns(4)
    found = scans([*feed(decoder, packets[:30] + packets[2 * PACKETS + 31 :], AHEAD_S), *decoder.finish()])
    assert [round(scan.completeness, 2) for scan in found] == [0.4, 0.59, 1.0]


def test_packets_that_come_twice_or_late_are_dropped() -> None:
    decoder = VelodyneDecoder(VLP_16_PRODUCT)
    packets = turns(1)
    disordered = packets[:10] + packets[5:11] + [packets[3]] + packets[11:]
    scan = scans([*feed(decoder, disordered, AHEAD_S), *decoder.finish()])[0]
    assert_same_ranges(scan, random_image(VLP_16, 0), 0.011)
    assert decoder.counters.late == 6


@pytest.mark.parametrize(
    ("payload", "message"),
    [
        (b"x" * 554, "554 bytes, VLP-16 data packets have 1206.*set its port, or sensor_host"),
        (b"", "0 bytes"),
        (bytes(1205) + b"\x21", r"packets of a HDL-32E \(0x21\), expected a VLP-16 \(0x22\): set the LiDAR"),
        (bytes(1205) + b"\xa1", r"0xa1 \(VLS-128\) is not supported; supported: HDL-32E, VLP-16"),
        (bytes(1205) + b"\x07", r"0x07 \(no known Velodyne\)"),
    ],
    ids=["size", "empty", "model", "known but not read", "unknown"],
)
def test_strangers_are_refused_with_what_came_and_what_to_set(payload: bytes, message: str) -> None:
    decoder = VelodyneDecoder(VLP_16_PRODUCT)
    told = events(decoder.feed(payload, 1.0))
    assert [event.kind for event in told] == ["refused"]
    assert re.search(message, told[0].text)
    assert not decoder.feed(payload, 1.1)
    assert decoder.counters.refused == 2


@pytest.mark.parametrize(
    ("position", "data"),
    [(0, b"\x00"), (1100, b"\x00"), (-2, b"\x40"), (2, b"\xff\xff"), (302, b"\x00\x00"), (1203, b"\xff")],
    ids=["first header", "last header", "mode", "no angle", "angle out of order", "no time"],
)
def test_damaged_packets_are_counted_and_left_out(position: int, data: bytes) -> None:
    decoder = VelodyneDecoder(VLP_16_PRODUCT)
    packets = turns(1)
    packets[40] = changed(packets[40], position, data)
    scan = scans([*feed(decoder, packets, AHEAD_S), *decoder.finish()])[0]
    assert decoder.counters.damaged == 1
    assert scan.completeness == pytest.approx(74 / 75, abs=0.002)


def test_one_packet_that_looks_elsewhere_or_bears_another_mode_does_not_cut_the_sweep() -> None:
    decoder = VelodyneDecoder(VLP_16_PRODUCT)
    packets = turns(1)
    elsewhere = packets[3].payload
    packets[40] = changed(packets[40], 0, elsewhere[:1200])
    packets[50] = changed(packets[50], -2, b"\x39")
    found = scans([*feed(decoder, packets, AHEAD_S), *decoder.finish()])
    assert len(found) == 1
    assert decoder.counters.damaged == 2


def test_dual_returns_give_both_points_and_the_nearer_in_the_image() -> None:
    single = turns(1)
    dual = []
    for packet in single:
        for half in range(2):
            blocks = packet.payload[half * 600 : half * 600 + 600]
            pairs = b"".join(near + far for near, far in zip(*_near_and_far(blocks), strict=True))
            micros = struct.unpack_from("<I", packet.payload, 1200)[0] + half * 664
            dual.append(
                TimedPacket(packet.device_s + half * 6.6e-4, pairs + struct.pack("<IBB", micros, 0x39, 0x22))
            )
    decoder = VelodyneDecoder(VLP_16_PRODUCT)
    scan = scans([*feed(decoder, dual, AHEAD_S), *decoder.finish()])[0]
    sent = random_image(VLP_16, 0)
    assert_same_ranges(scan, sent, 0.011)
    assert len(scan.points) == 2 * np.isfinite(sent.ranges).sum()
    assert scan.complete
    assert decoder.counters.lost == 0


def _near_and_far(blocks: bytes) -> tuple[list[bytes], list[bytes]]:
    """Each block as it is, and with every return 3 m farther."""
    near = [blocks[k * 100 : (k + 1) * 100] for k in range(6)]
    far = []
    for block in near:
        returns = np.frombuffer(block[4:], dtype=[("distance", "<u2"), ("intensity", "u1")]).copy()
        returns["distance"][returns["distance"] > 0] += 1500
        far.append(block[:4] + returns.tobytes())
    return near, far


def test_a_restarted_sensor_is_told_and_scanned_again() -> None:
    decoder = VelodyneDecoder(VLP_16_PRODUCT)
    feed(decoder, turns(2)[:-30], AHEAD_S)
    outputs = feed(decoder, turns(3, 2.0), AHEAD_S + BEGIN_S + 5.0)
    assert [event.kind for event in events(outputs)] == ["restart"]
    found = scans([*outputs, *decoder.finish()])
    assert [scan.complete for scan in found] == [False, True, True]
    assert found[1].stamp_s == pytest.approx(AHEAD_S + BEGIN_S + 7.0 + 0.15, abs=1e-3)


def test_a_standing_rotor_neither_fills_the_memory_nor_passes_for_a_scan() -> None:
    decoder = VelodyneDecoder(VLP_16_PRODUCT)
    first = turns(1)[0]
    still = np.frombuffer(first.payload, dtype=np.uint8).copy()
    for block in range(12):
        still[block * 100 + 2 : block * 100 + 4] = still[2:4]
    found = []
    for k in range(4000):
        still[1200:1204] = np.frombuffer(struct.pack("<I", k * 1327), dtype=np.uint8)
        found += scans(decoder.feed(still.tobytes(), AHEAD_S + k * 1327e-6))
    assert len(found) == pytest.approx(4000 * 1327e-6 / 0.35, abs=2)
    assert all(scan.completeness < 0.01 for scan in found)
    assert all("turns at 0 rpm" in scan.faults[0] for scan in found)


def test_heat_told_by_position_packets_goes_with_the_scans() -> None:
    decoder = VelodyneDecoder(VLP_16_PRODUCT)
    hot = bytearray(512)
    hot[0xCB] = 1
    assert not decoder.feed(bytes(hot), AHEAD_S)
    assert scans([*feed(decoder, turns(1), AHEAD_S), *decoder.finish()])[0].faults[0].startswith("shuts down")
    decoder.feed(bytes(512), AHEAD_S)
    assert not scans([*feed(decoder, turns(1, BEGIN_S + 1), AHEAD_S), *decoder.finish()])[0].faults


def test_masked_pixels_say_nothing_and_masked_points_are_gone() -> None:
    mask = ViewMask((((-0.6, -0.2), (0.6, -0.2), (0.6, 0.3), (-0.6, 0.3)),))
    decoder = VelodyneDecoder(VLP_16_PRODUCT, mask=mask)
    scan = scans([*feed(decoder, turns(1), AHEAD_S), *decoder.finish()])[0]
    hidden = mask.of_model(VLP_16)
    assert not image_of(scan)[hidden].any()
    assert (image_of(scan)[~hidden] > 0).all()
    assert not mask.of_points(scan.points).any()
    assert scan.offsets_s is not None
    assert len(scan.offsets_s) == len(scan.points) > 20_000


def test_returns_closer_than_the_sensor_measures_say_nothing() -> None:
    image = random_image(VLP_16, 0)
    image.ranges[:, 100:200] = 0.3
    decoder = VelodyneDecoder(VLP_16_PRODUCT)
    scan = scans([*feed(decoder, velodyne_packets(image, BEGIN_S), AHEAD_S), *decoder.finish()])[0]
    assert not image_of(scan)[:, 100:200].any()


@pytest.mark.parametrize(("product", "beams"), [(0x21, 32), (0x22, 16), (0x24, 16), (0x28, 32)], ids=hex)
def test_beams_of_every_product(product: int, beams: int) -> None:
    table = beams_of(product, False)
    assert len(table.elevations_rad) == beams
    assert (np.diff(table.elevations_rad) > 0).all()
    assert table.packet_s == pytest.approx(2 * beams_of(product, True).packet_s, rel=1e-6)
    assert product in PRODUCTS
    if product == VLP_16_PRODUCT:
        np.testing.assert_allclose(np.rad2deg(table.elevations_rad), np.arange(-15, 16, 2), atol=0.01)
