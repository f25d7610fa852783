"""Ouster packets of one sensor: which are its own and sound, and what is in them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

NANOSECOND_S = 1e-9
ACCELERATION_MAX_M_S2, RATE_MAX_RAD_S = 400.0, 100.0
"""Beyond the largest range that the sensor's IMU can be set to: a damaged packet."""
LIDAR_TYPE = 1
VALID_COLUMN = 1

Bytes = NDArray[np.uint8]
ImuReading = tuple[float, NDArray[np.float64], NDArray[np.float64]]
"""Device stamp, acceleration and angular rate in the axes of the sensor frame."""


class OusterPackets:
    """Reads the packets of the sensor that `info` (ouster SensorInfo) describes.

    Everything but `refusal` wants a packet that is not refused: the SDK reads at fixed places without looking
    at the length.
    """

    def __init__(self, info: Any) -> None:
        from ouster.sdk import core  # noqa: PLC0415  # an extra: the station may do without

        self._core = core
        self._format = core.PacketFormat(info)
        self._info = info
        self._profile = str(info.format.udp_profile_lidar)
        self._legacy = info.format.udp_profile_lidar == core.UDPProfileLidar.LEGACY
        self._imu_legacy = info.format.udp_profile_imu == core.UDPProfileIMU.LEGACY
        self._imu_rotation = np.asarray(info.imu_to_sensor_transform, dtype=np.float64)[:3, :3]
        self._boot_id: int | None = None
        self._has_checksum = False
        self.per_frame = int(info.format.lidar_packets_per_frame())
        self.frame_numbers = int(self._format.max_frame_id) + 1

    def refusal(self, packet: Bytes) -> str | None:
        """Why a payload is not from the sensor of the metadata: what came, what to set."""
        sizes = self._format
        if len(packet) == sizes.imu_packet_size:
            return None
        if len(packet) != sizes.lidar_packet_size:
            return (
                f"a packet of {len(packet)} bytes; by its metadata ({self._profile}, {self._info.h} beams) "
                f"the sensor sends {sizes.lidar_packet_size} (LiDAR) or {sizes.imu_packet_size} (IMU): fetch "
                "the metadata anew, set the sensor's UDP profile back, or set sensor_host if another device "
                "sends to this port"
            )
        serial = 0 if self._legacy else int(sizes.prod_sn(packet))
        if serial and self._info.sn and serial != self._info.sn and self._checksum_right(packet):
            return (
                f"packets of sensor {serial}, the metadata is that of {self._info.sn}: its beam angles are "
                "others; set 'metadata' to the file of this sensor"
            )
        return None

    def _checksum_right(self, packet: Bytes) -> bool:
        """Old firmware writes no or another checksum: it counts from the first one that is right."""
        stored = self._format.crc(packet)
        if stored is None:
            return True
        right = bool(stored == self._format.calculate_crc(packet))
        self._has_checksum |= right
        return right or not self._has_checksum

    def is_imu(self, packet: Bytes) -> bool:
        return bool(len(packet) == self._format.imu_packet_size)

    def is_sound(self, packet: Bytes) -> bool:
        """Whether type and checksum of a packet are right, as far as its kind has them."""
        if self.is_imu(packet) or self._legacy:
            return True
        return int(self._format.packet_type(packet)) == LIDAR_TYPE and self._checksum_right(packet)

    def is_restarted(self, packet: Bytes) -> bool:
        """Whether the sensor has drawn a new initialisation id, as it does at every start and new setting."""
        boot_id = 0 if self._legacy else int(self._format.init_id(packet))
        if self._boot_id is None:
            self._boot_id = boot_id
        return boot_id != self._boot_id

    def accept_restart(self, packet: Bytes) -> None:
        self._boot_id = int(self._format.init_id(packet))

    def frame_number(self, packet: Bytes) -> int:
        return int(self._format.frame_id(packet))

    def columns(self, packet: Bytes) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.bool_]]:
        """Place in the frame, device stamp in seconds and validity of every column of a LiDAR packet."""
        header = self._core.ColHeader
        place = self._format.packet_header(header.MEASUREMENT_ID, packet).astype(np.int64)
        stamps_s = self._format.packet_header(header.TIMESTAMP, packet).astype(np.float64) * NANOSECOND_S
        status = self._format.packet_header(header.STATUS, packet)
        valid = (status.astype(np.int64) & VALID_COLUMN).astype(np.bool_) & (place < self._info.w)
        return place, stamps_s, valid

    def ranges_mm(self, packet: Bytes) -> NDArray[np.uint32]:
        """(beams, columns of the packet) ranges of the first return, 0 where nothing came back."""
        return np.asarray(self._format.packet_field("RANGE", packet))

    def faults(self, packet: Bytes) -> Iterator[str]:
        """What the sensor complains of."""
        if self._legacy:
            return
        if int(self._format.thermal_shutdown(packet)):
            yield "is about to shut down for heat: give it air"
        if int(self._format.shot_limiting(packet)):
            yield "limits its pulses for heat: ranges are shorter"

    def imu(self, packet: Bytes) -> list[ImuReading]:
        """The readings of an IMU packet; those that no sensor can give are left out."""
        reader = self._core.ImuPacket(self._format)
        reader.buf[:] = packet
        if self._imu_legacy:
            stamps_ns = np.array([reader.gyro_ts()], dtype=np.uint64)
        else:
            stamps_ns = np.asarray(reader.timestamp())
        acceleration = np.asarray(reader.accel(), dtype=np.float64)
        rate = np.asarray(reader.gyro(), dtype=np.float64)
        possible = (np.abs(acceleration) < ACCELERATION_MAX_M_S2).all(axis=1)  # false for NaN too
        possible &= (np.abs(rate) < RATE_MAX_RAD_S).all(axis=1) & (stamps_ns > 0)
        turn = self._imu_rotation
        return [
            (float(stamps_ns[i]) * NANOSECOND_S, turn @ acceleration[i], turn @ rate[i])
            for i in np.flatnonzero(possible)
        ]
