"""The bracket's frames: bytes from cantools, every flipped bit, noise, and files of other protocols."""

from __future__ import annotations

import os
import random
from pathlib import Path

import cantools
import pytest
from bracket_bench import WIRE
from crccheck.crc import Crc16Ibm3740

from drivers.bracket_types import Fault, State
from drivers.bracket_wire import DBC, SIGNALS, BracketWire, CanFrame, Sender, load_wire
from onboard.core.errors import InputError, WireError

EXAMPLES = {
    "BracketLock": {},
    "BracketFire": {"Challenge": 0xBEEF},
    "BracketArm": {"Challenge": 1},
    "HostHeartbeat": {"HostOk": 1},
    "BracketHeartbeat": {"State": 2, "Energised": 1, "HostHeard": 1, "Fault": 0, "Challenge": 65535},
    "BracketSensors": {"MotorCurrent": -1.25, "MotorTemperature": 31, "LatchClosed": 1, "LatchOpen": 0},
}
IDS = {
    "BracketLock": 0x110,
    "BracketFire": 0x111,
    "BracketArm": 0x112,
    "HostHeartbeat": 0x113,
    "BracketHeartbeat": 0x120,
    "BracketSensors": 0x121,
}


def by_cantools(name: str, counter: int) -> CanFrame:
    """The frame that cantools and an independent CRC make of the DBC file."""
    message = cantools.database.load_file(DBC).get_message_by_name(name)
    data = message.encode({"Crc": 0, "Counter": counter, **EXAMPLES[name]})
    crc = Crc16Ibm3740.calc(data[2:] + message.frame_id.to_bytes(2, "little"))
    return CanFrame(message.frame_id, crc.to_bytes(2, "little") + data[2:])


@pytest.mark.parametrize("name", SIGNALS)
def test_frames_are_those_of_the_file_and_come_back(name):
    sender = Sender(WIRE)
    for _ in range(299):
        frame = sender.frame(name, **EXAMPLES[name])
    assert frame == by_cantools(name, 299 % 256)
    message = WIRE.decode(frame)
    assert (message.name, message.counter) == (name, 299 % 256)
    assert EXAMPLES[name].items() <= message.signals.items()
    assert message.from_host is (name in ("BracketLock", "BracketFire", "BracketArm", "HostHeartbeat"))


def test_the_file_fits_classic_can_keeps_clear_of_canopen_and_names_states_and_faults():
    database = cantools.database.load_file(DBC)
    assert {message.name: message.frame_id for message in database.messages} == IDS
    assert all(message.length <= 8 and 0x101 <= message.frame_id <= 0x17F for message in database.messages)
    heartbeat = database.get_message_by_name("BracketHeartbeat")
    for signal, names in (("State", State), ("Fault", Fault)):
        choices = heartbeat.get_signal_by_name(signal).choices
        assert {code: str(name) for code, name in choices.items()} == {n.value: n.name for n in names}
    cycles = {name: database.get_message_by_name(name).cycle_time for name in IDS}
    assert cycles["HostHeartbeat"] == 100
    assert cycles["BracketHeartbeat"] == cycles["BracketSensors"] == 50


@pytest.mark.parametrize("name", SIGNALS)
def test_every_flipped_bit_and_every_wrong_length_is_refused(name):
    frame = by_cantools(name, 9)
    for bit in range(8 * len(frame.data)):
        data = bytearray(frame.data)
        data[bit // 8] ^= 1 << bit % 8
        with pytest.raises(WireError, match=f"{name}: damaged frame"):
            WIRE.decode(CanFrame(frame.id, bytes(data)))
    for data in (frame.data[:-1], frame.data + b"\0", b""):
        with pytest.raises(WireError, match=f"{name}: damaged frame"):
            WIRE.decode(CanFrame(frame.id, data))


@pytest.mark.parametrize(("name", "other"), [("BracketArm", "BracketFire"), ("BracketFire", "BracketArm")])
def test_a_frame_under_another_identifier_is_refused(name, other):
    with pytest.raises(WireError):
        WIRE.decode(CanFrame(IDS[other], by_cantools(name, 9).data))


@pytest.mark.parametrize(("signal", "bits"), [("State", 24), ("Fault", 32)])
def test_states_and_faults_that_nobody_knows_are_refused(signal, bits):
    value = {"State": 5, "Fault": 7}[signal]
    data = bytearray(7)
    data[2] = 1
    data[bits // 8] = value
    crc = Crc16Ibm3740.calc(bytes(data[2:]) + (0x120).to_bytes(2, "little"))
    data[:2] = crc.to_bytes(2, "little")
    with pytest.raises(WireError, match=f"BracketHeartbeat: {signal} is {value}"):
        load_wire(DBC).decode(CanFrame(0x120, bytes(data)))


@pytest.mark.parametrize(("raw", "amperes"), [(-10_001, -100.01), (10_001, 100.01), (-32_768, -327.68)])
def test_measurements_out_of_range_are_refused(raw, amperes):
    data = bytearray(8)
    data[3:5] = raw.to_bytes(2, "little", signed=True)
    crc = Crc16Ibm3740.calc(bytes(data[2:]) + (0x121).to_bytes(2, "little"))
    data[:2] = crc.to_bytes(2, "little")
    with pytest.raises(WireError, match=f"BracketSensors: MotorCurrent is {amperes}"):
        load_wire(DBC).decode(CanFrame(0x121, bytes(data)))


def test_other_frames_on_the_bus_are_none_of_ours():
    assert all(WIRE.decode(CanFrame(n, bytes(8))) is None for n in range(0x800) if n not in IDS.values())


def test_noise_is_refused_or_decodes_and_nothing_else():
    rng = random.Random(3)
    decoded = 0
    for _ in range(100_000):
        frame = CanFrame(rng.choice([*IDS.values(), 0x7FF]), rng.randbytes(rng.randrange(9)))
        try:
            decoded += WIRE.decode(frame) is not None
        except WireError:
            continue
    assert decoded < 10  # 16 bits of CRC


@pytest.mark.parametrize(
    ("name", "signals"),
    [
        ("BracketArm", {"Challenge": 65536}),
        ("BracketArm", {"Challenge": -1}),
        ("BracketArm", {}),
        ("BracketArm", {"Challenge": 1, "Speed": 2}),
        ("BracketHeartbeat", EXAMPLES["BracketHeartbeat"] | {"State": 5}),
    ],
)
def test_what_the_file_does_not_allow_is_not_sent(name, signals):
    with pytest.raises(ValueError, match=f"^{name}: "):
        WIRE.encode(name, 0, **signals)


def test_files_that_do_not_define_the_protocol_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"gone\.dbc: No such file.*give the bracket's DBC file"):
        load_wire(tmp_path / "gone.dbc")
    with pytest.raises(InputError, match=r"bracket\.dbc: not a DBC file: DBC: ") as caught:
        BracketWire("BO_ nonsense")
    assert "KCD" not in str(caught.value)  # other formats are not even tried
    (tmp_path / "latin.dbc").write_bytes(b"BO_ \xe9")
    with pytest.raises(InputError, match=r"latin\.dbc: not a DBC file"):
        load_wire(tmp_path / "latin.dbc")
    good = DBC.read_text()
    (tmp_path / "x.dbc").write_text(good.replace("BracketFire", "BracketFyre"))
    with pytest.raises(InputError, match=r"x\.dbc: BracketFire is missing or has other signals; use config/"):
        load_wire(tmp_path / "x.dbc")
    with pytest.raises(InputError, match="HostHeartbeat is missing or has other signals"):
        BracketWire(good.replace("SG_ HostOk", "SG_ HostFine").replace("275 HostOk", "275 HostFine"))


def test_a_file_without_ranges_still_works():
    wire = BracketWire(DBC.read_text().replace("[0|4]", "[0|0]"))
    sender = Sender(wire)
    signals = EXAMPLES["BracketHeartbeat"]
    assert wire.decode(sender.frame("BracketHeartbeat", **signals)).signals["State"] == 2


def test_public_files_of_other_buses_are_refused_in_words():
    default = Path(__file__).parents[2].parent / "shared" / "data"
    folder = Path(os.environ.get("MARSUPIAL_DATA", default)) / "can" / "cantools_dbc"
    if not folder.is_dir():
        pytest.skip(f"no public DBC files at {folder}; set MARSUPIAL_DATA")
    for path in sorted(folder.glob("*.dbc")):
        with pytest.raises(InputError):
            BracketWire(path.read_text(encoding="cp1252"), path.name)
