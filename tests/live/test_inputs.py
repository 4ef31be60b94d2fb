"""What is taken for the inputs, and the other axis."""

import numpy as np
import pytest
from live_hover import Flight, Timed, differences, offline, replay
from mavlink_streams import message

from mavdem.alignment import drive

OCTOROTOR = 14


def octo() -> Timed:
    """Eight motors, four on each of two ports, the second sent a millisecond after the first."""
    frames: Timed = []
    for time, data in Flight().frames(end=15.0):
        if data[7] == 0:
            base_mode = 128 * (time > 5.0)
            data = message("HEARTBEAT", sequence=data[4], type=OCTOROTOR, autopilot=3, base_mode=base_mode)
        frames.append((time, data))
        if data[7] == 36:
            outputs = np.rint(Flight().hover.motors(np.array([time + 0.001])))[0].astype(int).tolist()
            fields = {f"servo{motor + 1}_raw": output + 10 * motor for motor, output in enumerate(outputs)}
            stamp = round((time + 0.001) * 1e6)
            frames.append((time, message("SERVO_OUTPUT_RAW", time_usec=stamp, port=1, sequence=data[4], **fields)))
    return frames


def test_motors_on_two_ports_are_reported_together():
    frames = octo()
    made = replay(frames)
    assert made.setups[0].layout.channels == (1, 2, 3, 4, 9, 10, 11, 12)
    times, outputs, inputs = differences(made, 0, offline([data for _, data in frames]))
    assert times < 1e-6
    assert outputs == 0.0
    # Offline the second port is read off the line at the first one's stamps, live at the grid: 0.2 ms of their motion.
    assert inputs < 1.0


def with_demand(motors: float) -> Timed:
    frames: Timed = []
    for time, data in Flight(motors=motors).frames(end=15.0):
        frames.append((time, data))
        if data[7] == 30:
            roll = float(Flight().hover.roll_command(np.array(time))) / 100
            fields = {"time_usec": round(time * 1e6), "controls": [roll, 0.1 * roll, 0, 0.6, 0, 0, 0, 0]}
            frames.append((time, message("ACTUATOR_CONTROL_TARGET", sequence=data[4], **fields)))
            fields = {"time_usec": round(time * 1e6) + 1, "controls": [0.9] * 8, "group_mlx": 1}
            frames.append((time, message("ACTUATOR_CONTROL_TARGET", sequence=data[4], **fields)))
    return frames


@pytest.mark.slow
@pytest.mark.parametrize(("motors", "wanted"), [(5.0, None), (100.0, "demand")])
def test_the_demand_is_the_input_where_motors_come_too_slowly_or_it_is_asked_for(motors, wanted):
    frames = with_demand(motors)
    made = replay(frames, inputs=wanted)
    assert made.setups[0].motors == drive.DEMAND_MESSAGE
    assert made.setups[0].layout.names == ("roll demand",)
    settled = [row for row in made.rows if row.settled]
    expected = Flight().hover.roll_command(np.array([row.time for row in settled])) / 100
    np.testing.assert_allclose([row.inputs[0] for row in settled], expected, atol=1e-6)
    other = replay(frames, inputs="motors" if motors < 50 else None)
    assert [setup.motors for setup in other.setups.values()] == ["SERVO_OUTPUT_RAW"] * (motors > 50)


def test_pitch_is_read_from_pitch():
    frames = Flight().frames(end=15.0)
    made = replay(frames, axis="pitch")
    times, outputs, inputs = differences(made, 0, offline([data for _, data in frames]), "pitch")
    assert max(times, outputs, inputs) == 0.0
    np.testing.assert_allclose(made.rows[-1].outputs, [0.01, 0.1], rtol=1e-6)
