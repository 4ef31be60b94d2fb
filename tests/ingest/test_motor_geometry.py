"""Which output channels drive motors, by the parameters of real vehicles and by the outputs that change."""

from pytest import mark

from mavdem.ingest.motor_geometry import motor_geometry
from mavdem.ingest.motors import PositionSource, position_name


def test_a_gimbals_channels_are_no_motors():
    parameters = {"FRAME": 1.0, "RC5_FUNCTION": 7.0, "RC6_FUNCTION": 8.0, "RC7_FUNCTION": 0.0}
    geometry = motor_geometry(
        "GENERIC_MULTIROTOR", "ARDUPILOTMEGA", parameters, moving_channels=range(1, 7), bank_size=8
    )
    assert geometry.channels == (1, 2, 3, 4)
    on_servos = motor_geometry(
        "GENERIC_MULTIROTOR", "ARDUPILOTMEGA", {"SERVO2_FUNCTION": 7.0}, range(1, 6), 8
    )
    assert on_servos.channels == (1, 3, 4, 5)


TWELVE = {f"SERVO{n}_FUNCTION": n + (32.0 if n < 9 else 73.0) for n in range(1, 13)}
ON_AUX = {f"PWM_AUX_FUNC{n}": 100.0 + n for n in range(1, 5)}


@mark.parametrize(
    "vehicle, parameters, moving, channels",
    [
        ("QUADROTOR", {}, (2, 3, 4), range(1, 5)),
        ("QUADROTOR", {}, (1, 2, 4), range(1, 5)),
        ("QUADROTOR", {}, (9, 10, 11), range(9, 13)),
        ("QUADROTOR", {}, (5, 6, 7), range(5, 8)),
        ("HEXAROTOR", {}, (1, 2, 3, 5, 6), range(1, 7)),
        ("TRICOPTER", {}, (1, 2), range(1, 3)),
        ("DODECAROTOR", TWELVE, range(1, 13), range(1, 13)),
        ("QUADROTOR", ON_AUX, (18, 19, 20), range(17, 21)),
    ],
)
def test_a_motor_whose_output_never_changes_is_a_motor(vehicle, parameters, moving, channels):
    """Outputs that move show where the motors are; between or beside them are motors that stand still."""
    autopilot, bank = ("PX4", 16) if parameters is ON_AUX else ("ARDUPILOTMEGA", 8)
    geometry = motor_geometry(vehicle, autopilot, parameters, moving, bank)
    assert geometry.channels == tuple(channels)
    if not parameters:
        assert geometry.channels_assumed
    else:
        assert not geometry.channels_assumed
    assert geometry.motors == tuple(range(1, len(channels) + 1))


@mark.parametrize(
    "forward, right, name",
    [
        (1.0, 0.0, "front"),
        (0.2, 0.3, "front right"),
        (0.0, 1.0, "right"),
        (-1.0, 0.9, "rear right"),
        (-0.1, 0.0, "rear"),
        (-1.0, -1e-9, "rear"),
        (-1.0, -1.0, "rear left"),
        (0.1, -1.0, "left"),
        (1.0, -0.5, "front left"),
    ],
)
def test_a_position_is_named_by_the_nearest_of_eight_directions(forward, right, name):
    assert position_name((forward, right)) == name


def test_px4s_drivers_get_the_banks_in_which_their_outputs_change():
    parameters = {f"PWM_MAIN_FUNC{n}": 100.0 + n for n in range(1, 5)}
    geometry = motor_geometry("QUADROTOR", "PX4", parameters | ON_AUX, range(17, 21), 16)
    assert geometry.channels == (17, 18, 19, 20)
    assert {driver.name for driver in geometry.drivers} == {"PWM_MAIN"}


@mark.parametrize(
    "frame, source", [(1.0, PositionSource.PARAMETERS), (None, PositionSource.X_QUAD)]
)
def test_four_motors_of_an_old_autopilot_are_arranged_as_frame_says(frame, source):
    """Its log does not name the kind of frame, but four motors are those of a quadrotor."""
    parameters = {} if frame is None else {"FRAME": frame}
    geometry = motor_geometry("GENERIC_MULTIROTOR", "ARDUPILOTMEGA", parameters, [1, 2, 3, 4], 16)
    assert geometry.position_source is source


@mark.parametrize(
    "airframe, rotors, spins", [(6001, 0, (-1, 1, -1, 1, 1, -1)), (6001, 6, ()), (6002, 0, ())]
)
def test_a_generic_airframe_of_px4_has_known_rotors_unless_parameters_give_them(
    airframe, rotors, spins
):
    """PX4's control allocation has the rotors in parameters, which this log lacks; airframe 6002 is no generic one."""
    parameters = {"SYS_AUTOSTART": float(airframe)}
    if rotors:
        parameters["CA_ROTOR_COUNT"] = float(rotors)
    geometry = motor_geometry("HEXAROTOR", "PX4", parameters, range(1, 7), 8)
    assert geometry.spins == spins
    if spins:
        assert geometry.positions[:2] == ((0.0, 1.0), (0.0, -1.0))
