"""Ouster packets to scans and inertial samples: ranges, times, losses, strangers, restarts."""

from __future__ import annotations

import re

import numpy as np
import pytest
from made_recordings import ouster_info
from ouster.sdk import core
from sensor_streams import DELAY_S, TURN_S, assert_same_ranges, events, feed, image_of, random_image, scans

from drivers.ouster import OusterDecoder
from drivers.types import LidarScan
from onboard.core.imu import ImuSample
from onboard.core.lidar import OS0_64
from onboard.core.view_mask import ViewMask
from simulation.ouster_packets import SimulatedOuster
from simulation.velodyne_packets import TimedPacket

BEGIN_S, AHEAD_S = 500.0, 7000.0
PACKETS = 32


@pytest.fixture
def sensor() -> SimulatedOuster:
    return SimulatedOuster()


def frames(
    sensor: SimulatedOuster, count: int, begin_s: float = BEGIN_S, boot: int = 77
) -> list[TimedPacket]:
    made = [sensor.packets(random_image(OS0_64, k), begin_s + k * TURN_S, boot) for k in range(count)]
    return [packet for frame in made for packet in frame]


def changed(packet: TimedPacket, position: int, data: bytes) -> TimedPacket:
    payload = bytearray(packet.payload)
    payload[position : position + len(data)] = data
    return TimedPacket(packet.device_s, bytes(payload))


@pytest.mark.parametrize(
    ("profile", "within_m"), [("RNG15_RFL8_NIR8", 0.008), ("RNG19_RFL8_SIG16_NIR16", 0.001)]
)
def test_ranges_come_back_where_they_were_cast(profile: str, within_m: float) -> None:
    sensor = SimulatedOuster(profile)  # type: ignore[arg-type]
    decoder = OusterDecoder(sensor.info)
    found = scans(feed(decoder, frames(sensor, 3), AHEAD_S))
    assert [scan.complete for scan in found] == [True] * 3
    for k, scan in enumerate(found):
        sent = random_image(OS0_64, k)
        assert_same_ranges(scan, sent, within_m)
        assert len(scan.points) == np.isfinite(sent.ranges).sum()
    assert (decoder.counters.packets, decoder.counters.lost) == (3 * PACKETS, 0)


def test_points_lie_along_the_rays_of_their_pixels(sensor: SimulatedOuster) -> None:
    scan = scans(feed(OusterDecoder(sensor.info), frames(sensor, 1), AHEAD_S))[0]
    assert scan.image is not None
    distance = np.abs(np.sort(scan.points, axis=0) - np.sort(scan.image.points(), axis=0)).max()
    assert distance < 0.002


def test_a_scan_comes_with_the_last_packet_of_its_frame(sensor: SimulatedOuster) -> None:
    decoder = OusterDecoder(sensor.info)
    packets = frames(sensor, 1)
    assert not feed(decoder, packets[:-1], AHEAD_S)
    assert len(scans(feed(decoder, packets[-1:], AHEAD_S))) == 1


def test_stamps_are_the_middle_of_the_sweep_on_both_clocks(sensor: SimulatedOuster) -> None:
    found = scans(feed(OusterDecoder(sensor.info), frames(sensor, 3), AHEAD_S))
    for k, scan in enumerate(found):
        middle_s = BEGIN_S + k * TURN_S + TURN_S * 511 / 512 / 2
        assert scan.device_stamp_s == pytest.approx(middle_s, abs=1e-6)
        assert scan.stamp_s == pytest.approx(middle_s + AHEAD_S + DELAY_S, abs=1e-6)
        assert scan.image is not None
        assert scan.image.stamp_s == scan.stamp_s
        assert scan.offsets_s is not None
        assert np.ptp(scan.offsets_s) == pytest.approx(TURN_S * 511 / 512, abs=1e-5)


def test_columns_of_lost_packets_say_nothing_and_the_scan_is_marked(sensor: SimulatedOuster) -> None:
    decoder = OusterDecoder(sensor.info)
    packets = frames(sensor, 2)
    outputs = feed(decoder, packets[:8] + packets[16 : PACKETS + 2], AHEAD_S)
    assert not outputs
    scan = scans(feed(decoder, packets[PACKETS + 2 : PACKETS + 3], AHEAD_S))[0]
    lost = np.zeros(512, dtype=bool)
    lost[128:256] = True
    assert not image_of(scan)[:, lost[::-1]].any()
    assert (image_of(scan)[:, ~lost[::-1]] > 0).all()
    assert scan.completeness == pytest.approx(0.75)
    assert (scan.complete, decoder.counters.lost, decoder.counters.half_scans) == (False, 8, 1)


def test_whole_frames_that_are_lost_count_too(sensor: SimulatedOuster) -> None:
    decoder = OusterDecoder(sensor.info)
    packets = frames(sensor, 5)
    feed(decoder, packets[:PACKETS] + packets[4 * PACKETS :], AHEAD_S)
    assert decoder.counters.lost == 3 * PACKETS


def test_packets_that_come_in_another_order_twice_or_too_late(sensor: SimulatedOuster) -> None:
    decoder = OusterDecoder(sensor.info)
    packets = frames(sensor, 2)
    last = packets[PACKETS - 1]
    order = packets[5:10] + packets[:5] + packets[10 : PACKETS - 1] + packets[PACKETS : PACKETS + 2]
    outputs = feed(decoder, [*order, last, last, packets[0], *packets[PACKETS + 2 :]], AHEAD_S)
    found = scans(outputs)
    assert [scan.complete for scan in found] == [True, True]
    assert_same_ranges(found[0], random_image(OS0_64, 0), 0.008)
    assert (decoder.counters.late, decoder.counters.lost) == (2, 0)


def test_a_damaged_frame_number_neither_cuts_the_frame_nor_holds_up_the_next(sensor: SimulatedOuster) -> None:
    legacy = OusterDecoder(without_checksum(sensor))
    packets = [unchecked(packet) for packet in frames(sensor, 3)]
    packets[10] = changed(packets[10], 2, b"\xff\x7f")
    found = scans([*feed(legacy, packets, AHEAD_S), *legacy.finish()])
    assert [round(scan.completeness, 3) for scan in found] == [round(31 / 32, 3), 1.0, 1.0]


def without_checksum(sensor: SimulatedOuster) -> core.SensorInfo:
    return core.SensorInfo(sensor.metadata())


def unchecked(packet: TimedPacket) -> TimedPacket:
    """Old firmware: the place of the checksum holds zeros."""
    return TimedPacket(packet.device_s, packet.payload[:-8] + bytes(8))


def test_a_wrong_checksum_is_damage_where_the_sensor_writes_right_ones(sensor: SimulatedOuster) -> None:
    decoder = OusterDecoder(sensor.info)
    packets = frames(sensor, 1)
    packets[7] = changed(packets[7], 1000, b"\x12\x34\x56")
    scan = scans([*feed(decoder, packets, AHEAD_S), *decoder.finish()])[0]
    assert decoder.counters.damaged == 1
    assert scan.completeness == pytest.approx(31 / 32)


def test_strangers_are_refused_with_what_came_and_what_to_set(sensor: SimulatedOuster) -> None:
    decoder = OusterDecoder(sensor.info)
    other = SimulatedOuster("RNG19_RFL8_SIG16_NIR16")
    told = events(feed(decoder, frames(other, 1)[:3], AHEAD_S))
    assert len(told) == 1
    assert re.search(
        "12544 bytes; .*RNG15_RFL8_NIR8, 64 beams.* 4352 .*48 .*fetch the metadata", told[0].text
    )
    assert decoder.counters.refused == 3


def test_packets_of_another_sensor_are_refused_by_its_serial_number(sensor: SimulatedOuster) -> None:
    info = core.SensorInfo(sensor.metadata())
    info.sn = 4711
    decoder = OusterDecoder(info)
    outputs = feed(decoder, frames(sensor, 1), AHEAD_S)
    assert not scans(outputs)
    assert re.search(r"packets of sensor 992137000142, the metadata is that of 4711", events(outputs)[0].text)


def test_a_restarted_sensor_is_told_and_scanned_again(sensor: SimulatedOuster) -> None:
    decoder = OusterDecoder(sensor.info)
    feed(decoder, frames(sensor, 2)[:-10], AHEAD_S)
    again = frames(SimulatedOuster(), 3, begin_s=4.0, boot=78)
    outputs = [*feed(decoder, again, AHEAD_S + BEGIN_S + 5.0), *decoder.finish()]
    assert [event.kind for event in events(outputs)] == ["restart"]
    found = scans(outputs)
    assert [scan.complete for scan in found] == [False, True, True]
    assert found[1].stamp_s == pytest.approx(AHEAD_S + BEGIN_S + 9.15, abs=1e-3)


def test_a_single_new_initialisation_id_is_no_restart(sensor: SimulatedOuster) -> None:
    decoder = OusterDecoder(sensor.info)
    packets = frames(sensor, 1)
    packets[5] = frames(SimulatedOuster(), 1, boot=99)[5]
    outputs = [*feed(decoder, packets, AHEAD_S), *decoder.finish()]
    assert not events(outputs)
    assert scans(outputs)[0].completeness == pytest.approx(31 / 32)


def test_inertial_samples_are_in_si_units_and_sensor_axes(sensor: SimulatedOuster) -> None:
    info = core.SensorInfo(sensor.metadata())
    turned = np.asarray(info.imu_to_sensor_transform).copy()
    turned[:3, :3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    info.imu_to_sensor_transform = turned
    sensor.info.imu_to_sensor_transform = turned
    decoder = OusterDecoder(info)
    feed(decoder, frames(sensor, 1), AHEAD_S)
    sent = sensor.imu_packet(BEGIN_S + 0.105, (1.5, -0.5, 9.7), (0.1, 0.2, -0.3))
    samples = feed(decoder, [sent], AHEAD_S)
    assert len(samples) == 1
    sample = samples[0]
    assert isinstance(sample, ImuSample)
    np.testing.assert_allclose(sample.acceleration_m_s2, (1.5, -0.5, 9.7), atol=1e-5)
    np.testing.assert_allclose(sample.angular_rate_rad_s, (0.1, 0.2, -0.3), atol=1e-6)
    assert sample.device_stamp_s == pytest.approx(BEGIN_S + 0.105)
    assert sample.stamp_s == pytest.approx(BEGIN_S + 0.105 + AHEAD_S + DELAY_S, abs=1e-5)


@pytest.mark.parametrize("acceleration", [(np.nan, 0, 9.8), (np.inf, 0, 9.8), (0, 1e30, 9.8)])
def test_inertial_readings_that_cannot_be_are_left_out(
    sensor: SimulatedOuster, acceleration: tuple[float, float, float]
) -> None:
    decoder = OusterDecoder(sensor.info)
    feed(decoder, frames(sensor, 1), AHEAD_S)
    assert not feed(decoder, [sensor.imu_packet(BEGIN_S + 0.105, acceleration, (0, 0, 0))], AHEAD_S)


def test_a_limited_field_of_view_is_complete_when_its_columns_are(sensor: SimulatedOuster) -> None:
    info = core.SensorInfo(sensor.metadata())
    layout = info.format
    layout.column_window = (384, 127)
    info.format = layout
    decoder = OusterDecoder(info)
    packets = frames(sensor, 1)
    scan = scans(feed(decoder, packets[:8] + packets[24:], AHEAD_S))[0]
    assert scan.complete
    assert decoder.counters.lost == 0
    assert not image_of(scan)[:, 128:384].any()


def test_faults_that_the_sensor_tells_go_with_the_scan(sensor: SimulatedOuster) -> None:
    decoder = OusterDecoder(without_checksum(sensor))
    packets = [unchecked(packet) for packet in frames(sensor, 1)]
    packets[9] = changed(packets[9], 18, b"\x01\x02")
    scan = scans(feed(decoder, packets, AHEAD_S))[0]
    assert len(scan.faults) == 2
    assert "shut down for heat" in scan.faults[0]
    assert "limits its pulses" in scan.faults[1]


def test_masked_pixels_say_nothing_and_masked_points_are_gone(sensor: SimulatedOuster) -> None:
    mask = ViewMask((((2.5, -0.8), (3.8, -0.8), (3.8, -0.3), (2.5, -0.3)),))
    scan = scans(feed(OusterDecoder(sensor.info, mask=mask), frames(sensor, 1), AHEAD_S))[0]
    hidden = mask.of_model(OS0_64)
    assert hidden.any()
    assert not image_of(scan)[hidden].any()
    assert (image_of(scan)[~hidden] > 0).all()
    assert not mask.of_points(scan.points).any()


def test_other_beams_fall_to_the_rows_that_are_nearest() -> None:
    """An OS1 sees +-17 degrees: rows beyond say nothing, the others hold a beam within half their spacing."""
    info = core.SensorInfo(ouster_info().to_json_string())
    frame = core.LidarFrame(info)
    frame.field("RANGE")[:] = 10_000
    frame.frame_id, frame.status[:], frame.measurement_id[:] = 1, 1, range(512)
    frame.timestamp[:] = (np.arange(512) * 195_312 + 10**9).astype(np.uint64)
    decoder = OusterDecoder(info)
    found: list[LidarScan] = []
    for packet in core.frame_to_packets(frame, core.PacketFormat(info), info.init_id, info.sn):
        found += scans(decoder.feed(packet.buf.tobytes(), 5.0))
    rows = image_of(found[0]) > 0
    assert (rows.all(axis=1) | ~rows.any(axis=1)).all()
    seen = np.rad2deg(OS0_64.elevations_rad[rows.any(axis=1)])
    assert 16.0 < seen.max() < 18.5
    assert -18.5 < seen.min() < -16.0
    # 16 mm: the beams start 15.8 mm off the centre, which the points and the image account for
    np.testing.assert_allclose(image_of(found[0])[rows], 10.0, atol=0.017)
    np.testing.assert_allclose(np.linalg.norm(found[0].points, axis=1), 10.0, atol=0.017)
