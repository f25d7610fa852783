"""The check of the vehicle's parameters."""

from __future__ import annotations

from pathlib import Path

import pytest

from drivers.mavlink.dialect import message
from drivers.mavlink.parameter_check import Expected, ParameterCheck, load_parameters
from onboard.core.errors import ConfigError
from simulation.px4.parameters import DEFAULTS, INT32, REAL32, Parameters, to_wire

FILE = Path(__file__).parents[2] / "config/px4/aerial.params"
EXPECTED = (Expected("COM_OBL_RC_ACT", 4, INT32), Expected("MPC_XY_VEL_MAX", 2.0, REAL32))


def value(name: str, number: float, kind: int) -> object:
    return message["PARAM_VALUE"](name.encode(), to_wire(number, kind), kind, 1, 0)


def test_right_values_pass_in_both_types() -> None:
    check = ParameterCheck(EXPECTED, 1, 1)
    assert {packet.param_id for packet in check.requests(0.0)} == {"COM_OBL_RC_ACT", "MPC_XY_VEL_MAX"}
    check.note(value("COM_OBL_RC_ACT", 4, INT32))
    check.note(value("MPC_XY_VEL_MAX", 2.0, REAL32))
    assert check.done
    assert check.wrong == ()


def test_wrong_values_are_named_and_may_be_mended() -> None:
    check = ParameterCheck(EXPECTED, 1, 1)
    check.note(value("COM_OBL_RC_ACT", 0, INT32))
    check.note(value("MPC_XY_VEL_MAX", 12.0, REAL32))
    check.note(value("SOMETHING_ELSE", 1, INT32))
    assert check.wrong == ("COM_OBL_RC_ACT is 0, expected 4", "MPC_XY_VEL_MAX is 12, expected 2")
    check.note(value("COM_OBL_RC_ACT", 4, INT32))
    assert check.wrong == ("MPC_XY_VEL_MAX is 12, expected 2",)
    check.note(value("COM_OBL_RC_ACT", 2, INT32))
    assert len(check.wrong) == 2


def test_lost_answers_are_asked_for_again_and_then_given_up() -> None:
    check = ParameterCheck(EXPECTED, 1, 1)
    asked = sum(len(check.requests(tick * 0.1)) for tick in range(40))
    assert asked == 8
    assert check.done
    assert check.wrong == (
        "COM_OBL_RC_ACT is not known to the vehicle",
        "MPC_XY_VEL_MAX is not known to the vehicle",
    )


def test_only_a_few_are_asked_for_at_once() -> None:
    many = tuple(Expected(f"P{k}", 0.0, INT32) for k in range(50))
    assert len(ParameterCheck(many, 1, 1).requests(0.0)) == 8


def test_file_of_the_product_holds_what_flying_needs() -> None:
    found = {entry.name: entry for entry in load_parameters(FILE)}
    for name, number in (("COM_OBL_RC_ACT", 4), ("EKF2_NOAID_TOUT", 1e6), ("EKF2_RNG_CTRL", 0)):
        assert found[name].value == number
    assert found["EKF2_EV_CTRL"].value == 15
    assert found["EKF2_HGT_REF"].value == 3
    assert found["MAV_SIGN_CFG"].value == 2
    assert found["MPC_XY_VEL_MAX"].value <= 2.0
    assert found["MPC_TILTMAX_AIR"].value <= 20.0
    known = Parameters()
    assert all(name in DEFAULTS and known.kind(name) == entry.kind for name, entry in found.items())


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("1\t1\tA\t1", "5 fields"),
        ("1\t1\tA\tx\t6", "5 fields"),
        ("1\t1\tA\t1\t7", "type 7"),
        ("1\t1\tA\t1\t6\n1\t1\tA\t2\t6", "given twice: A"),
    ],
)
def test_bad_files_are_refused_with_file_and_line(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "p.params"
    path.write_text(text)
    with pytest.raises(ConfigError, match=words):
        load_parameters(path)
    with pytest.raises(ConfigError):
        load_parameters(tmp_path / "none")
